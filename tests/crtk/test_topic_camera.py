"""Camera on a ROS topic, on a simulated clock.

test_crtk_command.py reads the images of the emulated arm over ROS 2.
"""

import contextlib
import time
from typing import Any

import cv2
import numpy as np
import pytest
from simulated_transport import EPOCH, SimulatedNetwork

from rcmservo.errors import BadInput
from rcmservo.hardware.cameras.settings import TopicSettings
from rcmservo.hardware.cameras.streamed_camera import CameraLost, StreamedCamera
from rcmservo.hardware.cameras.topic import TopicStream
from rcmservo.hardware.crtk import messages

MS = 1_000_000
TOPIC = messages.IMAGE_TOPIC.under("PSM1")
COLOUR = np.arange(6 * 8 * 3, dtype=np.uint8).reshape(6, 8, 3)


class TopicBench:
    """Topic stream with a sender and a simulated clock."""

    def __init__(self, **settings: Any) -> None:
        self.now = 1000 * MS
        network = SimulatedNetwork()
        self.sender = network.endpoint("sender")
        given = TopicSettings(**({"topic": TOPIC.name} | settings))
        self.stream = TopicStream(given, network.endpoint("camera"), self.read, self.real)
        self.reading_time = 0

    def read(self) -> int:
        """Read the clock, which takes `reading_time` ns."""
        self.now += self.reading_time
        return self.now

    def real(self) -> int:
        return EPOCH + self.now

    def send(
        self, image: Any = COLOUR, encoding: str = "bgr8", age: int = 20 * MS, **fields: Any
    ) -> None:
        height, width = image.shape[:2]
        step = image.strides[0]
        stamp = self.real() - age
        message = messages.PlainImage(stamp, height, width, encoding, 0, step, image.tobytes())
        self.sender.publish(TOPIC, messages.PlainImage(**(message.__dict__ | fields)))


def test_the_newest_image_is_returned_with_its_stamp_on_the_computers_clock() -> None:
    bench = TopicBench()
    bench.send(age=30 * MS)
    bench.send(age=12 * MS)
    snapshot = bench.stream.read()
    assert snapshot is not None and snapshot.skipped == 1
    assert snapshot.arrival == bench.now and snapshot.exposure == bench.now - 12 * MS
    assert np.array_equal(snapshot.image, COLOUR) and snapshot.uncertainty == 0.0
    assert bench.stream.read() is None


@pytest.mark.parametrize(
    ("connection", "uncertainty"),
    [({}, 3e-3), ({"ros": 1}, np.nan), ({"interface": "eth0"}, np.nan)],
)
def test_the_uncertainty_is_known_on_this_computer_only(
    connection: dict[str, Any], uncertainty: float
) -> None:
    bench = TopicBench(**connection)
    bench.reading_time = 3 * MS
    bench.send()
    snapshot = bench.stream.read()
    assert snapshot is not None and snapshot.uncertainty == pytest.approx(uncertainty, nan_ok=True)


def test_the_latency_is_subtracted_from_the_stamp() -> None:
    bench = TopicBench(latency=0.01)
    bench.send()
    snapshot = bench.stream.read()
    assert snapshot is not None and snapshot.exposure == bench.now - 30 * MS


ENCODED = {
    "rgb8": COLOUR[:, :, ::-1],
    "bgra8": np.dstack([COLOUR, COLOUR[:, :, 0]]),
    "rgba8": np.dstack([COLOUR[:, :, ::-1], COLOUR[:, :, 0]]),
    "8UC3": COLOUR,
}


@pytest.mark.parametrize("encoding", ENCODED)
def test_all_colour_encodings_become_blue_green_red(encoding: str) -> None:
    bench = TopicBench()
    bench.send(np.ascontiguousarray(ENCODED[encoding]), encoding)
    snapshot = bench.stream.read()
    assert snapshot is not None and np.array_equal(snapshot.image, COLOUR)


def test_padded_grey_rows_become_three_equal_channels() -> None:
    bench = TopicBench()
    grey = np.ascontiguousarray(COLOUR[:, :, 0])
    padded = np.pad(grey, ((0, 0), (0, 5)))
    bench.send(grey, "mono8", step=13, data=padded.tobytes())
    snapshot = bench.stream.read()
    assert snapshot is not None and snapshot.image is not None
    assert all(np.array_equal(snapshot.image[:, :, i], grey) for i in range(3))


def test_image_files_are_decoded() -> None:
    bench = TopicBench(compressed=True)
    _, file = cv2.imencode(".png", COLOUR)
    topic = messages.Topic(TOPIC.name, messages.CompressedImage)
    for data in (file.tobytes(), file.tobytes()[:40], b""):
        bench.now += MS
        bench.sender.publish(topic, messages.CompressedImage(bench.real(), "png", data))
        snapshot = bench.stream.read()
        assert snapshot is not None
        assert (snapshot.image is not None) == (len(data) > 40)


def test_the_exif_orientation_is_ignored() -> None:
    """Its Exif orientation (tag 274, of type SHORT) is 6, a quarter of a turn."""
    bench = TopicBench(compressed=True)
    orientation = b"II*\x00\x08\x00\x00\x00\x01\x00\x12\x01\x03\x00\x01\x00\x00\x00\x06" + bytes(7)
    exif = b"Exif\x00\x00" + orientation
    _, file = cv2.imencode(".jpg", COLOUR)
    message = b"\xff\xd8\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif
    topic = messages.Topic(TOPIC.name, messages.CompressedImage)
    jpeg = message + file.tobytes()[2:]
    bench.sender.publish(topic, messages.CompressedImage(bench.real(), "jpeg", jpeg))
    snapshot = bench.stream.read()
    assert snapshot is not None and snapshot.image is not None
    assert snapshot.image.shape == COLOUR.shape


@pytest.mark.parametrize("progressive", [0, 1])
@pytest.mark.parametrize(("fraction", "complete"), [(1.0, True), (0.999, False), (0.6, False)])
def test_a_truncated_file_gives_no_image(
    fraction: float, complete: bool, progressive: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The replaced decoder of OpenCV decodes any bytes to an image."""
    monkeypatch.setattr("rcmservo.hardware.cameras.topic.cv2.imdecode", lambda *_: COLOUR)
    bench, image = TopicBench(compressed=True), np.kron(COLOUR, np.ones((40, 40, 1), np.uint8))
    _, file = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive])
    data = file.tobytes()
    data = data + bytes(8) if complete else data[: round(fraction * len(data))]
    topic = messages.Topic(TOPIC.name, messages.CompressedImage)
    bench.sender.publish(topic, messages.CompressedImage(bench.real(), "jpeg", data))
    snapshot = bench.stream.read()
    assert snapshot is not None and (snapshot.image is not None) == complete


@pytest.mark.parametrize(
    "fields",
    [{"data": COLOUR.tobytes()[:-1]}, {"step": 23}, {"height": 0}, {"width": 0}, {"height": 2**31}],
)
def test_an_image_of_inconsistent_size_is_dropped(fields: dict[str, Any]) -> None:
    bench = TopicBench()
    bench.send(**fields)
    snapshot = bench.stream.read()
    assert snapshot is not None and snapshot.image is None


def test_repeated_and_late_images_are_dropped() -> None:
    bench = TopicBench()
    for age, accepted in ((20, True), (20, False), (30, False), (10, True)):
        bench.send(age=age * MS)
        snapshot = bench.stream.read()
        assert snapshot is not None and (snapshot.image is not None) == accepted


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"age": 1500 * MS}, "1.500 s old"),
        ({"age": -100 * MS}, "-0.100 s old"),
        ({"stamp": 0}, "have no stamp"),
        ({"encoding": "16UC1"}, "have the encoding '16UC1'"),
    ],
)
def test_invalid_stamps_and_encodings_are_reported(change: dict[str, Any], text: str) -> None:
    bench = TopicBench()
    bench.send(**change)
    with pytest.raises(CameraLost, match=text):
        bench.stream.read()


def test_the_problem_is_in_the_account() -> None:
    bench = TopicBench()
    with contextlib.closing(StreamedCamera(lambda: bench.stream, reopen_period=60.0)) as camera:
        bench.send(age=1500 * MS)
        end = time.monotonic() + 20.0
        while not camera.counts().trouble and time.monotonic() < end:
            pass
        assert "1.500 s old" in camera.counts().trouble


@pytest.mark.parametrize("topic", ["", "/camera", "a b", "camera/"])
def test_a_topic_that_cannot_be_is_named(topic: str) -> None:
    with pytest.raises(BadInput, match=r"camera\.topic"):
        TopicSettings(topic)
