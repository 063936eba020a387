"""Cameras that OpenCV reads: files, sequences of pictures, and Motion JPEG over the network."""

import itertools
import os
import socket
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numbered import NumberedCamera, frames_of, number_in, picture, wait_for

from rcmservo.config.rig_file import load_lab
from rcmservo.errors import BadInput, RcmServoError
from rcmservo.hardware.cameras import opencv
from rcmservo.hardware.cameras.emulated.mjpeg_server import MjpegServer
from rcmservo.hardware.cameras.opencv import opencv_camera
from rcmservo.hardware.cameras.settings import OpencvSettings
from rcmservo.hardware.devices import open_camera

COUNT = 12


def sequence(folder: Path) -> str:
    for number in range(COUNT):
        cv2.imwrite(str(folder / f"{number:03d}.png"), picture(number))
    return str(folder / "%03d.png")


def film(folder: Path) -> str:
    path = str(folder / "film.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"MJPG"), 100.0, (320, 240))
    for number in range(COUNT):
        writer.write(picture(number))
    writer.release()
    return path


@pytest.mark.parametrize(("made", "rate"), [(sequence, 100.0), (film, None)])
def test_a_recording_plays_to_its_end(made: Any, rate: float | None, tmp_path: Path) -> None:
    settings = OpencvSettings(made(tmp_path), latency=0.02, frame_rate=rate)
    with closing(opencv_camera(settings)) as camera:
        wait_for(lambda: "the file has ended" in camera.account().trouble)
        frame, account = camera.latest(), camera.account()
        assert frame is not None and frame.number == number_in(frame.image) == COUNT - 1
        assert frame.arrival - frame.exposure == 20_000_000
        assert (account.frames, account.reconnects) == (COUNT, 0)


def test_a_picture_of_another_size_is_counted_and_left_out(tmp_path: Path) -> None:
    source = sequence(tmp_path)
    cv2.imwrite(str(tmp_path / "005.png"), picture(5, 640, 480))
    with closing(opencv_camera(OpencvSettings(source, frame_rate=100.0))) as camera:
        wait_for(lambda: "the file has ended" in camera.account().trouble)
        frame, account = camera.latest(), camera.account()
        assert frame is not None and frame.number == COUNT - 1
        assert (account.frames, account.incomplete) == (COUNT - 1, 1)


def test_the_colours_of_a_jpeg_are_spread_smoothly(tmp_path: Path) -> None:
    """Each is there once for four pixels; FFmpeg repeats it, which tears small markers apart."""
    ball = np.zeros((240, 320, 3), np.uint8)
    cv2.circle(ball, (100, 100), 7, (200, 60, 20), -1)
    jpeg = cv2.imencode(".jpg", ball, [cv2.IMWRITE_JPEG_QUALITY, 92])[1]
    source = tmp_path / "ball.mjpeg"
    source.write_bytes(3 * jpeg.tobytes())
    with closing(opencv_camera(OpencvSettings(str(source), frame_rate=100.0))) as camera:
        wait_for(lambda: "the file has ended" in camera.account().trouble)
        frame = camera.latest()
        assert frame is not None and camera.account().frames == 3
        assert np.array_equal(frame.image, cv2.imdecode(jpeg, cv2.IMREAD_COLOR))


@pytest.mark.alone
def test_pictures_from_the_network_are_new_and_in_order() -> None:
    filmed = NumberedCamera()
    with closing(MjpegServer(filmed, 0)) as server:
        stalled = socket.create_connection(("127.0.0.1", server.port))
        stalled.sendall(b"GET / HTTP/1.0\r\n\r\n")  # and it never reads
        with closing(opencv_camera(OpencvSettings(server.address, latency=0.01))) as camera:
            frames = frames_of(camera, 60)
        stalled.close()
    numbers = [number_in(frame.image) for frame in frames]
    assert all(earlier < later for earlier, later in itertools.pairwise(numbers))
    assert all(a.number < b.number for a, b in itertools.pairwise(frames))
    assert all(f.arrival >= filmed.exposure(n) for f, n in zip(frames, numbers, strict=True))


@pytest.mark.alone
def test_a_server_that_comes_back_is_found_again() -> None:
    filmed = NumberedCamera()
    server = MjpegServer(filmed, 0)
    with closing(opencv_camera(OpencvSettings(server.address, latency=0.01))) as camera:
        before = frames_of(camera, 5)[-1]
        server.close()
        wait_for(lambda: camera.account().trouble != "")
        assert camera.account().reconnects == 0
        with closing(MjpegServer(filmed, server.port)):
            wait_for(lambda: camera.account().reconnects == 1)
            after = frames_of(camera, 5)[-1]
        assert after.number > before.number
        assert number_in(after.image) > number_in(before.image)


def test_a_port_that_is_taken_is_one_sentence() -> None:
    with (
        closing(MjpegServer(NumberedCamera(), 0)) as server,
        pytest.raises(RcmServoError, match=f"port {server.port}: cannot be listened on"),
    ):
        MjpegServer(NumberedCamera(), server.port)


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("/dev/video77", "camera /dev/video77: cannot be opened: there is no /dev/video77"),
        ("77", "camera 77: cannot be opened: there is no /dev/video77"),
        ("nowhere.avi", "camera nowhere.avi: cannot be opened: no video or no picture"),
        ("http://127.0.0.1:9/", "cannot be opened: nothing sends pictures there"),
    ],
)
def test_what_cannot_be_opened_is_one_sentence(source: str, said: str) -> None:
    with pytest.raises(RcmServoError) as error:
        opencv_camera(OpencvSettings(source, latency=0.02))
    assert said in str(error.value)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ('source = " "', "camera.source must be a device, a file"),
        ('source = "a.avi"\nwidth = 640', "camera.width must be left out: it can be set of a"),
        ('source = "http://x/"\nframe_rate = 60.0', "camera.frame_rate must be left out"),
        ('source = "0"\nlatency = -0.1', "camera.latency must be a time from 0 to 1 s"),
        ('source = "0"\nframe_rate = 0.0', "camera.frame_rate must be a rate from 1 to 1000"),
        ('source = "0"\nexposure = 2.0', "camera.exposure must be a time from 0.00001 to 1 s"),
        ('source = "0"', "camera.latency must be more than 0 s: `rcmservo rig check` measures it"),
    ],
)
def test_settings_that_cannot_be_are_one_sentence(lines: str, said: str, tmp_path: Path) -> None:
    rig = tmp_path / "lab.toml"
    rig.write_text(f'[camera]\nkind = "opencv"\n{lines}\n')
    with pytest.raises(BadInput) as error:
        open_camera(load_lab(rig))
    assert said in str(error.value)


def test_a_camera_that_nobody_has_measured_opens_for_who_measures_it(tmp_path: Path) -> None:
    rig = tmp_path / "lab.toml"
    rig.write_text(f'[camera]\nkind = "opencv"\nsource = "{film(tmp_path)}"\n')
    with closing(open_camera(load_lab(rig), unmeasured=True)) as camera:
        frame = frames_of(camera, 1)[0]
        assert frame.exposure == frame.arrival


class Device:
    """A video device that takes what it likes."""

    def __init__(self, *_: Any) -> None:
        self.kept = {cv2.CAP_PROP_FRAME_WIDTH: 640.0, cv2.CAP_PROP_FRAME_HEIGHT: 480.0}

    def isOpened(self) -> bool:
        return True

    def set(self, key: int, value: float) -> bool:
        if key not in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT):
            self.kept[key] = value
        return True

    def get(self, key: int) -> float:
        return self.kept[key]

    def grab(self) -> bool:
        return False

    def release(self) -> None:
        pass


def test_what_a_device_makes_of_its_settings_is_read_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a device that is not there: none was at hand."""
    devices: list[Device] = []

    def made(*arguments: Any) -> Device:
        devices.append(Device(*arguments))
        return devices[-1]

    monkeypatch.setattr(opencv.cv2, "VideoCapture", made)
    settings = OpencvSettings("0", latency=0.02, width=640, exposure=0.004, gain=3.0)
    opencv_camera(settings).close()
    kept = devices[0].kept
    assert (kept[cv2.CAP_PROP_AUTO_EXPOSURE], kept[cv2.CAP_PROP_EXPOSURE]) == (1, 40.0)
    with pytest.raises(BadInput, match=r"camera.width must be .*\(it makes 640 of it\), got 800"):
        opencv_camera(OpencvSettings("0", latency=0.02, width=800))


@pytest.mark.parametrize(("given", "seconds"), [(None, "2"), ("5", "5")])
def test_a_device_that_falls_silent_is_given_up_after_2_s_unless_somebody_says_otherwise(
    given: str | None, seconds: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What OpenCV is told before it opens the first device: none was at hand."""
    name, told = "OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", list[str | None]()
    monkeypatch.setenv(name, given or "")
    if given is None:
        monkeypatch.delenv(name)

    def made(*arguments: Any) -> Device:
        told.append(os.environ.get(name))
        return Device(*arguments)

    monkeypatch.setattr(opencv.cv2, "VideoCapture", made)
    opencv_camera(OpencvSettings("0", latency=0.02)).close()
    assert told[0] == seconds
