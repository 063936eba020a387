"""Cameras that OpenCV reads: files, image sequences, and Motion JPEG over the network."""

import itertools
import os
import socket
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numbered_camera import NumberedCamera, frames_of, numbered_image, read_number, wait_for

from rcmservo.config.rig_file import load_rig_file
from rcmservo.errors import BadInput, RcmServoError
from rcmservo.hardware.cameras import opencv
from rcmservo.hardware.cameras.emulated.mjpeg_server import MjpegServer
from rcmservo.hardware.cameras.opencv import open_opencv_camera
from rcmservo.hardware.cameras.settings import OpencvSettings
from rcmservo.hardware.device_kinds import open_camera

COUNT = 12


def write_sequence(folder: Path) -> str:
    for number in range(COUNT):
        cv2.imwrite(str(folder / f"{number:03d}.png"), numbered_image(number))
    return str(folder / "%03d.png")


def write_video(folder: Path) -> str:
    path = str(folder / "film.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"MJPG"), 100.0, (320, 240))
    for number in range(COUNT):
        writer.write(numbered_image(number))
    writer.release()
    return path


@pytest.mark.parametrize(("write", "rate"), [(write_sequence, 100.0), (write_video, None)])
def test_a_recording_plays_to_its_end(write: Any, rate: float | None, tmp_path: Path) -> None:
    settings = OpencvSettings(write(tmp_path), latency=0.02, frame_rate=rate)
    with closing(open_opencv_camera(settings)) as camera:
        wait_for(lambda: "the file has ended" in camera.counts().trouble)
        frame, account = camera.latest(), camera.counts()
        assert frame is not None and frame.number == read_number(frame.image) == COUNT - 1
        assert frame.arrival - frame.exposure == 20_000_000
        assert (account.frames, account.reconnects) == (COUNT, 0)


def test_an_image_of_another_size_is_counted_and_dropped(tmp_path: Path) -> None:
    source = write_sequence(tmp_path)
    cv2.imwrite(str(tmp_path / "005.png"), numbered_image(5, 640, 480))
    with closing(open_opencv_camera(OpencvSettings(source, frame_rate=100.0))) as camera:
        wait_for(lambda: "the file has ended" in camera.counts().trouble)
        frame, account = camera.latest(), camera.counts()
        assert frame is not None and frame.number == COUNT - 1
        assert (account.frames, account.incomplete) == (COUNT - 1, 1)


def test_the_colours_of_a_jpeg_are_interpolated_smoothly(tmp_path: Path) -> None:
    """A JPEG has one colour for four pixels. FFmpeg repeats it, and small markers look torn."""
    ball = np.zeros((240, 320, 3), np.uint8)
    cv2.circle(ball, (100, 100), 7, (200, 60, 20), -1)
    jpeg = cv2.imencode(".jpg", ball, [cv2.IMWRITE_JPEG_QUALITY, 92])[1]
    source = tmp_path / "ball.mjpeg"
    source.write_bytes(3 * jpeg.tobytes())
    with closing(open_opencv_camera(OpencvSettings(str(source), frame_rate=100.0))) as camera:
        wait_for(lambda: "the file has ended" in camera.counts().trouble)
        frame = camera.latest()
        assert frame is not None and camera.counts().frames == 3
        assert np.array_equal(frame.image, cv2.imdecode(jpeg, cv2.IMREAD_COLOR))


def test_images_from_the_network_are_recent_and_in_order() -> None:
    source_camera = NumberedCamera()
    with closing(MjpegServer(source_camera, 0)) as server:
        stalled = socket.create_connection(("127.0.0.1", server.port))
        stalled.sendall(b"GET / HTTP/1.0\r\n\r\n")  # this client never reads
        with closing(open_opencv_camera(OpencvSettings(server.address, latency=0.01))) as camera:
            frames = frames_of(camera, 60)
        stalled.close()
    numbers = [read_number(frame.image) for frame in frames]
    assert all(earlier < later for earlier, later in itertools.pairwise(numbers))
    assert all(a.number < b.number for a, b in itertools.pairwise(frames))
    assert all(f.arrival >= source_camera.exposure(n) for f, n in zip(frames, numbers, strict=True))


def test_a_restarted_server_is_found() -> None:
    source_camera = NumberedCamera()
    server = MjpegServer(source_camera, 0)
    with closing(open_opencv_camera(OpencvSettings(server.address, latency=0.01))) as camera:
        before = frames_of(camera, 5)[-1]
        server.close()
        wait_for(lambda: camera.counts().trouble != "")
        assert camera.counts().reconnects == 0
        with closing(MjpegServer(source_camera, server.port)):
            wait_for(lambda: camera.counts().reconnects == 1)
            after = frames_of(camera, 5)[-1]
        assert after.number > before.number
        assert read_number(after.image) > read_number(before.image)


def test_a_port_in_use_is_reported_in_one_sentence() -> None:
    with (
        closing(MjpegServer(NumberedCamera(), 0)) as server,
        pytest.raises(RcmServoError, match=f"port {server.port}: cannot listen on it"),
    ):
        MjpegServer(NumberedCamera(), server.port)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("/dev/video77", "camera /dev/video77: cannot be opened: there is no /dev/video77"),
        ("77", "camera 77: cannot be opened: there is no /dev/video77"),
        ("nowhere.avi", "camera nowhere.avi: cannot be opened: not a readable video or image"),
        ("http://127.0.0.1:9/", "cannot be opened: no images come from there"),
    ],
)
def test_a_source_that_cannot_be_opened_is_reported_in_one_sentence(
    source: str, message: str
) -> None:
    with pytest.raises(RcmServoError) as error:
        open_opencv_camera(OpencvSettings(source, latency=0.02))
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ('source = " "', "camera.source must be a device, a file"),
        ('source = "a.avi"\nwidth = 640', "camera.width must be left out: only a video device"),
        ('source = "http://x/"\nframe_rate = 60.0', "camera.frame_rate must be left out"),
        ('source = "0"\nlatency = -0.1', "camera.latency must be a time from 0 to 1 s"),
        ('source = "0"\nframe_rate = 0.0', "camera.frame_rate must be a rate from 1 to 1000"),
        ('source = "0"\nexposure = 2.0', "camera.exposure must be a time from 0.00001 to 1 s"),
        ('source = "0"', "camera.latency must be more than 0 s: `rcmservo rig check` measures it"),
    ],
)
def test_invalid_settings_are_reported_in_one_sentence(
    lines: str, message: str, tmp_path: Path
) -> None:
    rig = tmp_path / "lab.toml"
    rig.write_text(f'[camera]\nkind = "opencv"\n{lines}\n')
    with pytest.raises(BadInput) as error:
        open_camera(load_rig_file(rig))
    assert message in str(error.value)


def test_a_camera_without_a_latency_opens_for_its_measurement(tmp_path: Path) -> None:
    rig = tmp_path / "lab.toml"
    rig.write_text(f'[camera]\nkind = "opencv"\nsource = "{write_video(tmp_path)}"\n')
    with closing(open_camera(load_rig_file(rig), accepts_unmeasured_latency=True)) as camera:
        frame = frames_of(camera, 1)[0]
        assert frame.exposure == frame.arrival


class FakeDevice:
    """Video device that keeps its image size."""

    def __init__(self, *_: Any) -> None:
        self.values = {cv2.CAP_PROP_FRAME_WIDTH: 640.0, cv2.CAP_PROP_FRAME_HEIGHT: 480.0}

    def isOpened(self) -> bool:
        return True

    def set(self, key: int, value: float) -> bool:
        if key not in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT):
            self.values[key] = value
        return True

    def get(self, key: int) -> float:
        return self.values[key]

    def grab(self) -> bool:
        return False

    def release(self) -> None:
        pass


def test_the_settings_of_a_device_are_read_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a fake device, because no real one was available."""
    devices: list[FakeDevice] = []

    def open_device(*arguments: Any) -> FakeDevice:
        devices.append(FakeDevice(*arguments))
        return devices[-1]

    monkeypatch.setattr(opencv.cv2, "VideoCapture", open_device)
    settings = OpencvSettings("0", latency=0.02, width=640, exposure=0.004, gain=3.0)
    open_opencv_camera(settings).close()
    values = devices[0].values
    assert (values[cv2.CAP_PROP_AUTO_EXPOSURE], values[cv2.CAP_PROP_EXPOSURE]) == (1, 40.0)
    with pytest.raises(BadInput, match=r"camera.width must be .*\(it has set 640\), got 800"):
        open_opencv_camera(OpencvSettings("0", latency=0.02, width=800))


@pytest.mark.parametrize(("given", "seconds"), [(None, "2"), ("5", "5")])
def test_the_time_limit_of_a_device_is_2_s_unless_the_environment_sets_it(
    given: str | None, seconds: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The variable is set before OpenCV opens its first device; the device is a fake."""
    name, observed = "OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", list[str | None]()
    monkeypatch.setenv(name, given or "")
    if given is None:
        monkeypatch.delenv(name)

    def open_device(*arguments: Any) -> FakeDevice:
        observed.append(os.environ.get(name))
        return FakeDevice(*arguments)

    monkeypatch.setattr(opencv.cv2, "VideoCapture", open_device)
    open_opencv_camera(OpencvSettings("0", latency=0.02)).close()
    assert observed[0] == seconds
