"""`rcmservo emulate galil` with its camera, as a person runs it: the pictures show the arm that the
controller moves."""

import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing

import numpy as np
import pytest
from numbered import frames_of
from test_aravis import library

from conftest import HEEDING_CTRL_C, ROOT
from rcmservo.app.cli import main
from rcmservo.config.rig_file import Lab
from rcmservo.hardware.cameras.aravis import aravis_camera
from rcmservo.hardware.cameras.opencv import opencv_camera
from rcmservo.hardware.cameras.settings import AravisSettings, OpencvSettings
from rcmservo.interfaces import Camera, Floats
from rcmservo.tracking import ColourMarkers

WORDS = (
    r"emulated Galil DMC-4040 at 127.0.0.1:(\d+), simulated arm, its camera at "
    r"(http://127.0.0.1:(\d+)/) and GigE Vision (127.0.0.1), seed 3; Ctrl-C ends it\n"
)
FAR = 8.0
"""px that the second marker goes at least."""


def marker(camera: Camera, tracker: ColourMarkers) -> Iterator[Floats]:
    """Where the second marker is, in frame after frame."""
    end = time.monotonic() + 60.0
    while time.monotonic() < end:
        yield tracker.find(frames_of(camera, 2)[-1]).points[1]


@library
@pytest.mark.slow
@pytest.mark.alone
def test_both_cameras_show_the_arm_that_the_controller_moves() -> None:
    options = ["emulate", "galil", "--port", "0", "--mjpeg", "0", "--gige", "--seed", "3"]
    command = [sys.executable, "-c", HEEDING_CTRL_C, *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as it:
        try:
            assert it.stdout is not None
            said = re.fullmatch(WORDS, it.stdout.readline())
            assert said is not None
            assert it.stdout.readline().startswith("the arm stands at ")
            with ExitStack() as stack:
                cameras = [
                    opencv_camera(OpencvSettings(said[2], latency=0.03)),
                    aravis_camera(AravisSettings(said[4], latency=0.03)),
                ]
                for camera in cameras:
                    stack.enter_context(closing(camera))
                trackers = [ColourMarkers(Lab().markers) for _ in cameras]
                pairs = list(zip(cameras, trackers, strict=True))
                before = [next(marker(*pair)) for pair in pairs]
                assert np.isfinite(before).all()
                assert np.abs(before[0] - before[1]).max() < 1.0
                wire = stack.enter_context(socket.create_connection(("127.0.0.1", int(said[1]))))
                wire.sendall(b"SH ABC;PR 0,0,-5000;SP ,,5000;BG C\r")
                for pair, start in zip(pairs, before, strict=True):
                    assert any(np.linalg.norm(now - start) > FAR for now in marker(*pair))
            it.send_signal(signal.SIGINT)
            assert it.communicate(timeout=60.0) == ("", "")
        finally:
            it.kill()
        assert it.returncode == 0
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", int(said[3])))


def test_a_port_that_is_none_is_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["emulate", "galil", "--mjpeg", "-1"]) == 2
    assert "--mjpeg must be a whole number from 0 to 65535, got -1" in capsys.readouterr().err


def test_its_page_shows_commands_that_can_be_parsed() -> None:
    """They are what the first test runs, on ports that are free."""
    page = (ROOT / "docs/cameras.md").read_text()
    assert ".venv/bin/rcmservo emulate galil --port 2323 --mjpeg 8081 --gige\n" in page
