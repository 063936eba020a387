"""A command at its own terminal, and an emulated lab with a second connection to its controller."""

import os
import pty
import re
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from conftest import INTERRUPTIBLE_COMMAND, make_environment
from rcmservo.cli.lab.emulate import COUNTS_PER_UNIT
from rcmservo.config.rig_file import load_rig_file
from rcmservo.interfaces import Floats
from rcmservo.sim import Rig
from rcmservo.sim.rig_file import read_rig_settings

WAIT_TIMEOUT_S = 120.0
"""Time-out in s of every wait, long enough for a busy computer."""


EXEC_AT_TERMINAL = """
import fcntl, os, sys, termios
fcntl.ioctl(2, termios.TIOCSCTTY, 0)
os.execvp(sys.argv[1], sys.argv[1:])
"""


class UnexpectedEnd(AssertionError):
    """The command ended before it printed the expected text."""

    def __init__(self, shown: str, output: bytes | None) -> None:
        super().__init__(f"{shown}\nThe process has ended: {output}")
        self.output = output or b""


class AtTerminal:
    """Process whose terminal the test controls, as a context manager that ends it."""

    def __init__(self, command: list[str], json: bool = False, **variables: str) -> None:
        self.shown, self._read = "", 0
        self.master, slave = pty.openpty()

        self.process: subprocess.Popen[bytes] = subprocess.Popen(
            [sys.executable, "-c", EXEC_AT_TERMINAL, *command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE if json else slave,
            stderr=slave,
            start_new_session=True,
            env=make_environment(COLUMNS="500", TERM="dumb", **variables),
        )
        os.close(slave)

    def __enter__(self) -> "AtTerminal":
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        if self.master >= 0:
            os.close(self.master)

    def type(self, words: str) -> None:
        os.write(self.master, words.encode())

    def until(self, words: str) -> str:
        """Return the output up to these words, starting after the previous match."""
        end = time.monotonic() + WAIT_TIMEOUT_S
        while words not in self.shown[self._read :]:
            assert time.monotonic() < end, self.shown
            if not self._more():
                raise UnexpectedEnd(self.shown, self.process.communicate()[0])
        begin = self._read
        self._read = self.shown.index(words, begin) + len(words)
        return self.shown[begin : self._read]

    def end(self) -> int:
        """Wait for the end of the process and return its exit code."""
        end = time.monotonic() + WAIT_TIMEOUT_S
        while self._more():
            assert time.monotonic() < end, self.shown
        return self.process.wait(WAIT_TIMEOUT_S)

    def hang_up(self) -> None:
        """Close the terminal window."""
        os.close(self.master)
        self.master = -1

    def _more(self) -> bool:
        """Read available output; return False once the process has closed the terminal."""
        if not select.select([self.master], [], [], 0.5)[0]:
            return True
        try:
            data = os.read(self.master, 65536)
        except OSError:  # the other end is closed
            return False
        self.shown += data.decode(errors="replace").replace("\r\n", "\n")
        return bool(data)


class Laboratory:
    """`rcmservo emulate galil --mjpeg` and a second connection to it; `close` it at the end."""

    def __init__(self, folder: Path, seed: int = 1, rig: str = "", *options: str) -> None:
        self.folder = folder
        scene = folder / "scene.toml"
        scene.write_text(rig)
        command = [sys.executable, "-m", "rcmservo", "emulate", "galil", "--port", "0"]
        command += ["--mjpeg", "0", "--seed", str(seed), "--rig", str(scene), *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        line, self.printed = self.process.stdout.readline(), self.process.stdout.readline()
        match = re.search(r"127\.0\.0\.1:(\d+), .*its camera at (\S+),", line)
        assert match is not None, line
        self.port, self.camera = int(match[1]), match[2]
        drawn = Rig(seed, read_rig_settings(load_rig_file(scene)), pictures=False).scene
        self.start, self.target = drawn.start, drawn.target
        self.wire: Any = None
        self.reach()

    def reach(self) -> None:
        """Open the second connection."""
        self.wire = socket.create_connection(("127.0.0.1", self.port), timeout=30.0)

    def close(self) -> None:
        self.wire.close()
        os.kill(self.process.pid, signal.SIGCONT)
        self.process.terminate()
        self.process.communicate(timeout=30.0)

    def lab(self, more: str = "") -> Path:
        """Write the lab's rig file; its thresholds are tolerant because the computer is busy."""
        path = self.folder / "lab.toml"
        path.write_text(
            f'[arm]\nkind = "galil"\naddress = "127.0.0.1"\nport = {self.port}\n'
            f"counts = {list(COUNTS_PER_UNIT)}\ncommand_timeout = 0.05\nreply_timeout = 2.0\n"
            f'[camera]\nkind = "opencv"\nsource = "{self.camera}"\nlatency = 0.02\n'
            "[thresholds]\nmax_tick_delay = 1.0\nmax_latency = 1.0\n"
            "max_frame_age_slow = 50.0\nmax_frame_age_hold = 50.0\n"
            f"arm_timeout = 1.0\n{more}"
        )
        return path

    def ask(self, line: str) -> str:
        """Return the controller's answer on the second connection: one prompt per command."""
        self.wire.sendall(f"{line}\r".encode())
        answer = ""
        while answer.count(":") + answer.count("?") < line.count(";") + 1:
            answer += self.wire.recv(4096).decode("latin-1")
        return answer

    @property
    def counts(self) -> list[float]:
        """Counts of the axes."""
        return [float(part) for part in self.ask("MG _TPA,_TPB,_TPC")[:-1].split()]

    @property
    def off(self) -> bool:
        """True if all motors are off."""
        return [float(p) for p in self.ask("MG _MOA,_MOB,_MOC")[:-1].split()] == [1.0, 1.0, 1.0]

    @property
    def q(self) -> Floats:
        """Joint values from the encoder counts, which are zero at the start until defined."""
        zero = self.start if "?" in self.ask("MG rcmhome") else np.zeros(3)
        return zero + np.array(self.counts) / np.array(COUNTS_PER_UNIT)

    def forget(self) -> None:
        """Mark the joint values as unknown, as a reset does."""
        if "?" not in self.ask("MG rcmhome"):
            self.ask("rcmhome=0")

    @property
    def homed(self) -> bool:
        """True if the joint values are known."""
        answer = self.ask("MG rcmhome")
        return "?" not in answer and float(answer[:-1]) != 0.0

    @property
    def sessions(self) -> float:
        """Number of times that the driver enabled the drive since the reset."""
        answer = self.ask("MG rcmsess")
        return 0.0 if "?" in answer else float(answer[:-1])

    def bring(self, q: Floats) -> None:
        """Move the arm with its own motors as an operator would, then switch them off."""
        goal = np.round((q - self.q) * np.array(COUNTS_PER_UNIT)).astype(int).tolist()
        speeds = "SP 25000,25000,25000"  # JG changes the speeds
        for line in ("SH ABC", speeds, "PR " + ",".join(map(str, goal)), "BG ABC"):
            assert "?" not in self.ask(line), (line, self.ask("TC 1"))
        end = time.monotonic() + WAIT_TIMEOUT_S
        while any(float(p) for p in self.ask("MG _BGA,_BGB,_BGC")[:-1].split()):
            assert time.monotonic() < end, self.state
        assert "?" not in self.ask("MO ABC"), self.state

    @property
    def state(self) -> list[str]:
        """State of the controller for the message of a failed test."""
        queries = (
            "MG _BGA,_BGB,_BGC",
            "MG _JGA,_JGB,_JGC",
            "MG _PRA,_PRB,_PRC",
            "SC",
            "TV",
            "MG _XQ1",
        )
        return [self.ask(line) for line in (*queries, "MG _TPA,_TPB,_TPC", "MG _RPA,_RPB,_RPC")]


SHORT = "--teaching-frames", "30"
"""Teach for half a second."""


def live(lab: Path, *options: str) -> list[str]:
    """Return the command under test."""
    return [
        sys.executable,
        "-c",
        INTERRUPTIBLE_COMMAND,
        "live",
        "--rig",
        str(lab),
        *SHORT,
        *options,
    ]


def wait_for(reached: Any) -> None:
    """Wait until `reached` is true, and leave the processor to the processes under test."""
    end, never = time.monotonic() + WAIT_TIMEOUT_S, threading.Event()
    while not reached():
        assert time.monotonic() < end
        never.wait(0.005)


def typed_joints(q: Floats) -> str:
    """Return joint values as an operator types them."""
    return " ".join(f"{value:.6f}" for value in q)
