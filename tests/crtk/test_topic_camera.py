"""A camera on a ROS topic: what it makes of pictures, on an injected clock. Those of the emulated
arm over ROS 2 are another file's."""

import contextlib
import time
from typing import Any

import cv2
import numpy as np
import pytest
from simulated_wire import EPOCH, Wire

from rcmservo.errors import BadInput
from rcmservo.hardware.cameras.settings import TopicSettings
from rcmservo.hardware.cameras.streamed import CameraLost, StreamedCamera
from rcmservo.hardware.cameras.topic import TopicStream
from rcmservo.hardware.crtk import messages as m

MS = 1_000_000
TOPIC = m.PICTURES.under("PSM1")
COLOUR = np.arange(6 * 8 * 3, dtype=np.uint8).reshape(6, 8, 3)


class Filmed:
    """A stream, its sender, and the clock of both."""

    def __init__(self, **settings: Any) -> None:
        self.now = 1000 * MS
        wire = Wire()
        self.sender = wire.end("sender")
        given = TopicSettings(**({"topic": TOPIC.name} | settings))
        self.stream = TopicStream(given, wire.end("camera"), self.read, self.real)
        self.reading = 0

    def read(self) -> int:
        """The clock, whose reading takes its time."""
        self.now += self.reading
        return self.now

    def real(self) -> int:
        return EPOCH + self.now

    def send(
        self, image: Any = COLOUR, encoding: str = "bgr8", age: int = 20 * MS, **parts: Any
    ) -> None:
        height, width = image.shape[:2]
        step = image.strides[0]
        stamp = self.real() - age
        said = m.PlainImage(stamp, height, width, encoding, 0, step, image.tobytes())
        self.sender.publish(TOPIC, m.PlainImage(**(said.__dict__ | parts)))


def test_the_newest_wins_and_its_exposure_is_its_stamp_on_our_clock() -> None:
    filmed = Filmed()
    filmed.send(age=30 * MS)
    filmed.send(age=12 * MS)
    shot = filmed.stream.next()
    assert shot is not None and shot.passed == 1
    assert shot.arrival == filmed.now and shot.exposure == filmed.now - 12 * MS
    assert np.array_equal(shot.image, COLOUR) and shot.uncertainty == 0.0
    assert filmed.stream.next() is None


@pytest.mark.parametrize(
    ("where", "known"),
    [({}, 3e-3), ({"ros": 1}, np.nan), ({"interface": "eth0"}, np.nan)],
)
def test_how_well_its_times_are_known_is_told_of_this_computer_alone(
    where: dict[str, Any], known: float
) -> None:
    filmed = Filmed(**where)
    filmed.reading = 3 * MS
    filmed.send()
    shot = filmed.stream.next()
    assert shot is not None and shot.uncertainty == pytest.approx(known, nan_ok=True)


def test_a_latency_is_what_the_stamp_comes_after_the_exposure() -> None:
    filmed = Filmed(latency=0.01)
    filmed.send()
    shot = filmed.stream.next()
    assert shot is not None and shot.exposure == filmed.now - 30 * MS


ENCODED = {
    "rgb8": COLOUR[:, :, ::-1],
    "bgra8": np.dstack([COLOUR, COLOUR[:, :, 0]]),
    "rgba8": np.dstack([COLOUR[:, :, ::-1], COLOUR[:, :, 0]]),
    "8UC3": COLOUR,
}


@pytest.mark.parametrize("encoding", ENCODED)
def test_colours_come_blue_green_red(encoding: str) -> None:
    filmed = Filmed()
    filmed.send(np.ascontiguousarray(ENCODED[encoding]), encoding)
    shot = filmed.stream.next()
    assert shot is not None and np.array_equal(shot.image, COLOUR)


def test_rows_may_be_padded_and_grey_is_three_times_grey() -> None:
    filmed = Filmed()
    grey = np.ascontiguousarray(COLOUR[:, :, 0])
    padded = np.pad(grey, ((0, 0), (0, 5)))
    filmed.send(grey, "mono8", step=13, data=padded.tobytes())
    shot = filmed.stream.next()
    assert shot is not None and shot.image is not None
    assert all(np.array_equal(shot.image[:, :, i], grey) for i in range(3))


def test_files_are_unpacked() -> None:
    filmed = Filmed(compressed=True)
    _, file = cv2.imencode(".png", COLOUR)
    topic = m.Topic(TOPIC.name, m.CompressedImage)
    for data in (file.tobytes(), file.tobytes()[:40], b""):
        filmed.now += MS
        filmed.sender.publish(topic, m.CompressedImage(filmed.real(), "png", data))
        shot = filmed.stream.next()
        assert shot is not None
        assert (shot.image is not None) == (len(data) > 40)


def test_a_picture_that_says_it_was_taken_lying_is_not_turned() -> None:
    """Its Exif orientation (tag 274, of type SHORT) is 6, a quarter of a turn."""
    filmed = Filmed(compressed=True)
    lying = b"II*\x00\x08\x00\x00\x00\x01\x00\x12\x01\x03\x00\x01\x00\x00\x00\x06" + bytes(7)
    exif = b"Exif\x00\x00" + lying
    _, file = cv2.imencode(".jpg", COLOUR)
    said = b"\xff\xd8\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif
    topic = m.Topic(TOPIC.name, m.CompressedImage)
    jpeg = said + file.tobytes()[2:]
    filmed.sender.publish(topic, m.CompressedImage(filmed.real(), "jpeg", jpeg))
    shot = filmed.stream.next()
    assert shot is not None and shot.image is not None
    assert shot.image.shape == COLOUR.shape


@pytest.mark.parametrize("progressive", [0, 1])
@pytest.mark.parametrize(("share", "whole"), [(1.0, True), (0.999, False), (0.6, False)])
def test_of_half_a_file_no_picture_is_made(
    share: float, whole: bool, progressive: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also by an OpenCV that makes a picture of whatever it is given."""
    monkeypatch.setattr("rcmservo.hardware.cameras.topic.cv2.imdecode", lambda *_: COLOUR)
    filmed, image = Filmed(compressed=True), np.kron(COLOUR, np.ones((40, 40, 1), np.uint8))
    _, file = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive])
    data = file.tobytes()
    data = data + bytes(8) if whole else data[: round(share * len(data))]
    topic = m.Topic(TOPIC.name, m.CompressedImage)
    filmed.sender.publish(topic, m.CompressedImage(filmed.real(), "jpeg", data))
    shot = filmed.stream.next()
    assert shot is not None and (shot.image is not None) == whole


@pytest.mark.parametrize(
    "parts",
    [{"data": COLOUR.tobytes()[:-1]}, {"step": 23}, {"height": 0}, {"width": 0}, {"height": 2**31}],
)
def test_a_picture_that_does_not_fit_is_no_picture(parts: dict[str, Any]) -> None:
    filmed = Filmed()
    filmed.send(**parts)
    shot = filmed.stream.next()
    assert shot is not None and shot.image is None


def test_a_picture_that_comes_again_or_late_is_no_picture() -> None:
    filmed = Filmed()
    for age, good in ((20, True), (20, False), (30, False), (10, True)):
        filmed.send(age=age * MS)
        shot = filmed.stream.next()
        assert shot is not None and (shot.image is not None) == good


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"age": 1500 * MS}, "1.500 s old"),
        ({"age": -100 * MS}, "-0.100 s old"),
        ({"stamp": 0}, "bear no stamp"),
        ({"encoding": "16UC1"}, "come as '16UC1'"),
    ],
)
def test_what_can_be_no_camera_s_time_or_picture_is_told(
    change: dict[str, Any], words: str
) -> None:
    filmed = Filmed()
    filmed.send(**change)
    with pytest.raises(CameraLost, match=words):
        filmed.stream.next()


def test_its_trouble_is_in_the_account() -> None:
    filmed = Filmed()
    with contextlib.closing(StreamedCamera(lambda: filmed.stream, again=60.0)) as camera:
        filmed.send(age=1500 * MS)
        end = time.monotonic() + 20.0
        while not camera.account().trouble and time.monotonic() < end:
            pass
        assert "1.500 s old" in camera.account().trouble


@pytest.mark.parametrize("topic", ["", "/camera", "a b", "camera/"])
def test_a_topic_that_cannot_be_is_named(topic: str) -> None:
    with pytest.raises(BadInput, match=r"camera\.topic"):
        TopicSettings(topic)
