"""Command `rcmservo emulate galil`, run as a user runs it."""

import re
import signal
import socket
import subprocess
import sys
import time

import pytest

from conftest import INTERRUPTIBLE_COMMAND, ROOT
from rcmservo.cli.cli import main
from rcmservo.sim import Rig

ADDRESS_LINE = (
    r"emulated Galil DMC-4040 at 127.0.0.1:(\d+), simulated arm, seed 3; Ctrl-C ends it\n"
)
MEASUREMENT_LINE = (
    r"the arm is at (\S+ \S+ \S+) \(rad, rad, mm\). By ruler, its markers are (\S+) mm "
    r"apart, and marker 1 is (\S+) mm from the RCM\n"
)


def test_the_command_prints_its_address_and_the_arms_position_moves_the_arm_and_ends_cleanly() -> (
    None
):
    command = [
        sys.executable,
        "-c",
        INTERRUPTIBLE_COMMAND,
        "emulate",
        "galil",
        "--port",
        "0",
        "--seed",
        "3",
    ]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            address_match = re.fullmatch(ADDRESS_LINE, process.stdout.readline())
            assert address_match is not None
            measurement_match = re.fullmatch(MEASUREMENT_LINE, process.stdout.readline())
            assert measurement_match is not None
            q = Rig(3, pictures=False).scene.start
            assert [float(number) for number in measurement_match[1].split()] == pytest.approx(
                q, abs=0.005
            )
            assert [float(measurement_match[2]), float(measurement_match[3])] == pytest.approx(
                [30.0, q[2]], abs=0.05
            )
            with socket.create_connection(
                ("127.0.0.1", int(address_match[1])), timeout=10.0
            ) as stream:
                assert jog_distance(stream) > 100
            process.send_signal(signal.SIGINT)
            assert process.communicate(timeout=30.0) == ("", "")
        finally:
            process.kill()
        assert process.returncode == 0


def jog_distance(stream: socket.socket) -> float:
    """Jog axis A, stop it, and return the distance in counts."""

    def send(text: bytes) -> bytes:
        stream.sendall(text)
        return stream.recv(4096)

    start = position = float(send(b"TP A\r").split(b"\r")[0])
    assert send(b"SH ABC;JG 2000,0,0;BG ABC\r") == b":::"
    deadline = time.monotonic() + 20.0
    while position - start <= 100 and time.monotonic() < deadline:
        position = float(send(b"TP A\r").split(b"\r")[0])
    assert send(b"ST ABC\r") == b":"
    return position - start


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--port", "70000"], "--port must be a whole number from 0 to 65535, got 70000"),
        (["--seed", "-1"], "--seed must be a whole number that is not negative, got -1"),
        (["--fault", "slwo"], "(did you mean slow?), got 'slwo'"),
        (["--rig", "nowhere.toml"], "nowhere.toml"),
        (["--ros", "1"], "--ros must be left out, because emulate galil has no such option, got 1"),
        (["--namespace", "PSM2"], "--namespace must be left out"),
        (["--domain", "3"], "--domain must be left out"),
        (["--interface", "eth0"], "--interface must be left out"),
    ],
)
def test_invalid_options_are_reported_in_one_sentence(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["emulate", "galil", *arguments]) == 2
    output = capsys.readouterr()
    assert message in output.err and output.err.count("\n") == 1 and not output.out


def test_the_kinds_of_fault_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["emulate", "galil", "--fault", "help"]) == 0
    assert "silence" in capsys.readouterr().out


def test_the_document_shows_the_command() -> None:
    """The first test runs the command, on a free port."""
    page = (ROOT / "docs/galil.md").read_text()
    assert ".venv/bin/rcmservo emulate galil --port 2323\n" in page
