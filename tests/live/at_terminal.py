"""A command at a terminal of its own, and the emulated laboratory beside it, with a hand that moves
the arm and looks how it is over a connection of its own.
"""

import os
import pty
import re
import select
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from conftest import HEEDING_CTRL_C, with_tests
from rcmservo.cli.lab.emulate import COUNTS
from rcmservo.config.rig_file import load_lab
from rcmservo.interfaces import Floats
from rcmservo.sim import Rig
from rcmservo.sim.rig_file import read_rig_settings

PATIENCE = 120.0
"""s within which all that is waited for must come on a machine that is busy."""


AT_ITS_TERMINAL = """
import fcntl, os, sys, termios
fcntl.ioctl(2, termios.TIOCSCTTY, 0)
os.execvp(sys.argv[1], sys.argv[1:])
"""


class Ended(AssertionError):
    """The command ended before it showed what was waited for."""

    def __init__(self, shown: str, told: bytes | None) -> None:
        super().__init__(f"{shown}\nIt has ended: {told}")
        self.told = told or b""


class AtTerminal:
    """A process whose terminal the test holds: what it shows is text, and what is typed is the
    person's. Use it as a context: nothing of it is left at the end.
    """

    def __init__(self, command: list[str], json: bool = False, **variables: str) -> None:
        self.shown, self._read = "", 0
        self.master, slave = pty.openpty()

        self.process: subprocess.Popen[bytes] = subprocess.Popen(
            [sys.executable, "-c", AT_ITS_TERMINAL, *command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE if json else slave,
            stderr=slave,
            start_new_session=True,
            env=with_tests(COLUMNS="500", TERM="dumb", **variables),
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
        """What is shown up to these words, since those that were waited for last."""
        end = time.monotonic() + PATIENCE
        while words not in self.shown[self._read :]:
            assert time.monotonic() < end, self.shown
            if not self._more():
                raise Ended(self.shown, self.process.communicate()[0])
        begin = self._read
        self._read = self.shown.index(words, begin) + len(words)
        return self.shown[begin : self._read]

    def end(self) -> int:
        """The exit code, once it has ended by itself."""
        end = time.monotonic() + PATIENCE
        while self._more():
            assert time.monotonic() < end, self.shown
        return self.process.wait(PATIENCE)

    def hang_up(self) -> None:
        """Close the terminal's window."""
        os.close(self.master)
        self.master = -1

    def _more(self) -> bool:
        """Whether there is more to come, once some has or a moment has passed."""
        if not select.select([self.master], [], [], 0.5)[0]:
            return True
        try:
            data = os.read(self.master, 65536)
        except OSError:  # nobody holds the other end any more
            return False
        self.shown += data.decode(errors="replace").replace("\r\n", "\n")
        return bool(data)


class Laboratory:
    """`rcmservo emulate galil --mjpeg`, and a hand: `close` it at the end."""

    def __init__(self, folder: Path, seed: int = 1, rig: str = "", *options: str) -> None:
        self.folder = folder
        scene = folder / "scene.toml"
        scene.write_text(rig)
        command = [sys.executable, "-m", "rcmservo", "emulate", "galil", "--port", "0"]
        command += ["--mjpeg", "0", "--seed", str(seed), "--rig", str(scene), *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        line, self.printed = self.process.stdout.readline(), self.process.stdout.readline()
        said = re.search(r"127\.0\.0\.1:(\d+), .*its camera at (\S+),", line)
        assert said is not None, line
        self.port, self.camera = int(said[1]), said[2]
        drawn = Rig(seed, read_rig_settings(load_lab(scene)), pictures=False).scene
        self.start, self.target = drawn.start, drawn.target
        self.wire: Any = None
        self.reach()

    def reach(self) -> None:
        """Connect the hand."""
        self.wire = socket.create_connection(("127.0.0.1", self.port), timeout=30.0)

    def close(self) -> None:
        self.wire.close()
        os.kill(self.process.pid, signal.SIGCONT)
        self.process.terminate()
        self.process.communicate(timeout=30.0)

    def lab(self, more: str = "") -> Path:
        """Its rig file. The thresholds are patient: this machine has other work."""
        path = self.folder / "lab.toml"
        path.write_text(
            f'[arm]\nkind = "galil"\naddress = "127.0.0.1"\nport = {self.port}\n'
            f"counts = {list(COUNTS)}\npatience = 0.05\nanswer_within = 2.0\n"
            f'[camera]\nkind = "opencv"\nsource = "{self.camera}"\nlatency = 0.02\n'
            "[thresholds]\noverrun = 1.0\nlatency = 1.0\nstale_slow = 50.0\nstale_hold = 50.0\n"
            f"silence = 1.0\n{more}"
        )
        return path

    def ask(self, line: str) -> str:
        """What the controller answers to the hand: one prompt for every command."""
        self.wire.sendall(f"{line}\r".encode())
        told = ""
        while told.count(":") + told.count("?") < line.count(";") + 1:
            told += self.wire.recv(4096).decode("latin-1")
        return told

    @property
    def counts(self) -> list[float]:
        """Where the axes are."""
        return [float(part) for part in self.ask("MG _TPA,_TPB,_TPC")[:-1].split()]

    @property
    def off(self) -> bool:
        """Whether all motors are off."""
        return [float(p) for p in self.ask("MG _MOA,_MOB,_MOC")[:-1].split()] == [1.0, 1.0, 1.0]

    @property
    def q(self) -> Floats:
        """The joints by its counters, which begin at the start and tell them once they were
        defined.
        """
        zero = self.start if "?" in self.ask("MG rcmhome") else np.zeros(3)
        return zero + np.array(self.counts) / np.array(COUNTS)

    def forget(self) -> None:
        """Have it forget where it stands, as a reset does."""
        if "?" not in self.ask("MG rcmhome"):
            self.ask("rcmhome=0")

    @property
    def homed(self) -> bool:
        """Whether it knows where it stands."""
        told = self.ask("MG rcmhome")
        return "?" not in told and float(told[:-1]) != 0.0

    @property
    def sessions(self) -> float:
        """How often the drive was switched on by the driver since the reset."""
        told = self.ask("MG rcmsess")
        return 0.0 if "?" in told else float(told[:-1])

    def bring(self, q: Floats) -> None:
        """A person brings the arm there by hand: these motors do it, and are off then."""
        goal = np.round((q - self.q) * np.array(COUNTS)).astype(int).tolist()
        speeds = "SP 25000,25000,25000"  # JG has set them too
        for line in ("SH ABC", speeds, "PR " + ",".join(map(str, goal)), "BG ABC"):
            assert "?" not in self.ask(line), (line, self.ask("TC 1"))
        end = time.monotonic() + PATIENCE
        while any(float(p) for p in self.ask("MG _BGA,_BGB,_BGC")[:-1].split()):
            assert time.monotonic() < end, self.state
        assert "?" not in self.ask("MO ABC"), self.state

    @property
    def state(self) -> list[str]:
        """What a test shows that waits for it in vain."""
        asked = "MG _BGA,_BGB,_BGC", "MG _JGA,_JGB,_JGC", "MG _PRA,_PRB,_PRC", "SC", "TV", "MG _XQ1"
        return [self.ask(line) for line in (*asked, "MG _TPA,_TPB,_TPC", "MG _RPA,_RPB,_RPC")]


SHORT = "--teaching-frames", "30"
"""Half a second of teaching."""


def live(lab: Path, *options: str) -> list[str]:
    """The command that is tested."""
    return [sys.executable, "-c", HEEDING_CTRL_C, "live", "--rig", str(lab), *SHORT, *options]


def wait_for(reached: Any) -> None:
    end = time.monotonic() + PATIENCE
    while not reached():
        assert time.monotonic() < end


def words_of(q: Floats) -> str:
    """Joints as a person types them."""
    return " ".join(f"{value:.6f}" for value in q)
