"""`rcmservo emulate`, as a person runs it."""

import re
import signal
import socket
import subprocess
import sys
import time

import pytest

from conftest import HEEDING_CTRL_C, ROOT
from rcmservo.app.cli import main
from rcmservo.sim import Rig

WORDS = r"emulated Galil DMC-4040 at 127.0.0.1:(\d+), simulated arm, seed 3; Ctrl-C ends it\n"
MEASURED = (
    r"the arm stands at (\S+ \S+ \S+) \(rad, rad, mm\); by the ruler its markers are (\S+) mm "
    r"apart, and marker 1 is (\S+) mm from where the tool goes in\n"
)


def test_it_says_where_it_and_its_arm_are_moves_the_arm_and_ends_in_order() -> None:
    command = [
        sys.executable,
        "-c",
        HEEDING_CTRL_C,
        "emulate",
        "galil",
        "--port",
        "0",
        "--seed",
        "3",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as it:
        try:
            assert it.stdout is not None
            said = re.fullmatch(WORDS, it.stdout.readline())
            assert said is not None
            measured = re.fullmatch(MEASURED, it.stdout.readline())
            assert measured is not None
            q = Rig(3, pictures=False).scene.start
            assert [float(word) for word in measured[1].split()] == pytest.approx(q, abs=0.005)
            assert [float(measured[2]), float(measured[3])] == pytest.approx([30.0, q[2]], abs=0.05)
            with socket.create_connection(("127.0.0.1", int(said[1])), timeout=10.0) as wire:
                assert moved(wire) > 100
            it.send_signal(signal.SIGINT)
            assert it.communicate(timeout=30.0) == ("", "")
        finally:
            it.kill()
        assert it.returncode == 0


def moved(wire: socket.socket) -> float:
    """The counts that axis A goes in a jog that is stopped again."""

    def ask(text: bytes) -> bytes:
        wire.sendall(text)
        return wire.recv(4096)

    begin = float(ask(b"TP A\r").split(b"\r")[0])
    assert ask(b"SH ABC;JG 2000,0,0;BG ABC\r") == b":::"
    end, now = time.monotonic() + 20.0, begin
    while now - begin <= 100 and time.monotonic() < end:
        now = float(ask(b"TP A\r").split(b"\r")[0])
    assert ask(b"ST ABC\r") == b":"
    return now - begin


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--port", "70000"], "--port must be a whole number from 0 to 65535, got 70000"),
        (["--seed", "-1"], "--seed must be a whole number that is not negative, got -1"),
        (["--fault", "slwo"], "(did you mean slow?), got 'slwo'"),
        (["--rig", "nowhere.toml"], "nowhere.toml"),
        (["--ros", "1"], "--ros must be left out: emulate galil has no such thing, got 1"),
        (["--namespace", "PSM2"], "--namespace must be left out"),
        (["--domain", "3"], "--domain must be left out"),
        (["--interface", "eth0"], "--interface must be left out"),
    ],
)
def test_what_it_cannot_do_is_one_sentence(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["emulate", "galil", *arguments]) == 2
    told = capsys.readouterr()
    assert said in told.err and told.err.count("\n") == 1 and not told.out


def test_its_faults_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["emulate", "galil", "--fault", "help"]) == 0
    assert "silence" in capsys.readouterr().out


def test_its_page_shows_a_command_that_can_be_parsed() -> None:
    """The command itself is what the first test runs, on a port that is free."""
    page = (ROOT / "docs/galil.md").read_text()
    assert ".venv/bin/rcmservo emulate galil --port 2323\n" in page
