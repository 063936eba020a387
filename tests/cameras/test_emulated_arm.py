"""Command `rcmservo emulate galil` with its cameras, whose images show the moving arm."""

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
from numbered_camera import frames_of
from test_aravis import library

from conftest import INTERRUPTIBLE_COMMAND, ROOT
from rcmservo.cli.cli import main
from rcmservo.config.rig_file import RigDescription
from rcmservo.hardware.cameras.aravis import open_aravis_camera
from rcmservo.hardware.cameras.opencv import open_opencv_camera
from rcmservo.hardware.cameras.settings import AravisSettings, OpencvSettings
from rcmservo.interfaces import Camera, Floats
from rcmservo.tracking import ColourMarkers

WORDS = (
    r"emulated Galil DMC-4040 at 127.0.0.1:(\d+), simulated arm, its camera at "
    r"(http://127.0.0.1:(\d+)/) and GigE Vision (127.0.0.1), seed 3; Ctrl-C ends it\n"
)
MIN_MARKER_MOTION_PX = 8.0
"""Least motion of the second marker."""


def marker_positions(camera: Camera, tracker: ColourMarkers) -> Iterator[Floats]:
    """Yield the position of the second marker in successive frames."""
    end = time.monotonic() + 60.0
    while time.monotonic() < end:
        yield tracker.find(frames_of(camera, 2)[-1]).points[1]


@library
@pytest.mark.slow
@pytest.mark.alone
def test_both_cameras_show_the_arm_that_the_controller_moves() -> None:
    options = ["emulate", "galil", "--port", "0", "--mjpeg", "0", "--gige", "--seed", "3"]
    command = [sys.executable, "-c", INTERRUPTIBLE_COMMAND, *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as it:
        try:
            assert it.stdout is not None
            message = re.fullmatch(WORDS, it.stdout.readline())
            assert message is not None
            assert it.stdout.readline().startswith("the arm is at ")
            with ExitStack() as stack:
                cameras = [
                    open_opencv_camera(OpencvSettings(message[2], latency=0.03)),
                    open_aravis_camera(AravisSettings(message[4], latency=0.03)),
                ]
                for camera in cameras:
                    stack.enter_context(closing(camera))
                trackers = [ColourMarkers(RigDescription().markers) for _ in cameras]
                pairs = list(zip(cameras, trackers, strict=True))
                before = [next(marker_positions(*pair)) for pair in pairs]
                assert np.isfinite(before).all()
                assert np.abs(before[0] - before[1]).max() < 1.0
                stream = stack.enter_context(
                    socket.create_connection(("127.0.0.1", int(message[1])))
                )
                stream.sendall(b"SH ABC;PR 0,0,-5000;SP ,,5000;BG C\r")
                for pair, start in zip(pairs, before, strict=True):
                    assert any(
                        np.linalg.norm(now - start) > MIN_MARKER_MOTION_PX
                        for now in marker_positions(*pair)
                    )
            it.send_signal(signal.SIGINT)
            assert it.communicate(timeout=60.0) == ("", "")
        finally:
            it.kill()
        assert it.returncode == 0
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", int(message[3])))


def test_an_invalid_port_is_reported_in_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["emulate", "galil", "--mjpeg", "-1"]) == 2
    assert "--mjpeg must be a whole number from 0 to 65535, got -1" in capsys.readouterr().err


def test_the_document_shows_the_command() -> None:
    """The first test runs this command, on free ports."""
    page = (ROOT / "docs/cameras.md").read_text()
    assert ".venv/bin/rcmservo emulate galil --port 2323 --mjpeg 8081 --gige\n" in page
