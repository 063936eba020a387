"""Aravis driver against the fake GigE Vision camera of Aravis' tools, and against the emulated one.

The emulated camera sends frames with known content.
"""

import ctypes
import itertools
import re
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numbered_camera import NumberedCamera, frames_of, numbered_image, read_number, wait_for

from conftest import ROOT
from peers import mark_peer
from rcmservo.config.rig_file import load_rig_file
from rcmservo.errors import BadInput, RcmServoError
from rcmservo.hardware.cameras.aravis import (
    BUFFER_COUNT,
    LOST_AFTER_S,
    AravisStream,
    FrameIds,
    open_aravis_camera,
)
from rcmservo.hardware.cameras.aravis_library import (
    CAN_FAIL,
    CANNOT_FAIL,
    LIBRARY,
    NOT_INSTALLED,
    Aravis,
    AravisError,
)
from rcmservo.hardware.cameras.emulated.gige_camera import GigeCamera, encode_image
from rcmservo.hardware.cameras.pixel_formats import PIXEL_FORMATS, decode_raw_image
from rcmservo.hardware.cameras.settings import AravisSettings
from rcmservo.hardware.cameras.streamed_camera import CameraLost
from rcmservo.hardware.device_kinds import CAMERA_KINDS

FAKE = "arv-fake-gv-camera-0.8"


def installed() -> bool:
    with suppress(OSError):
        return bool(ctypes.CDLL(LIBRARY))
    return False


library = mark_peer("Aravis library", installed(), "sudo apt-get install libaravis-0.8-0")
tool = mark_peer(
    "Aravis' fake GigE camera", shutil.which(FAKE) is not None, "sudo apt-get install aravis-tools"
)
LOOPBACK = "127.0.0.1"


@contextmanager
def fake_camera(lost: int = 0) -> Iterator[subprocess.Popen[bytes]]:
    """Run the camera of Aravis' tools, which loses some packets in a thousand."""
    with subprocess.Popen([FAKE, "-i", LOOPBACK, "-r", str(lost)]) as process:
        try:
            yield process
        finally:
            process.kill()


def open_camera(**others: Any) -> Any:
    """Open the camera on this computer, as soon as it is available."""
    cameras: list[Any] = []

    def is_open() -> bool:
        with suppress(CameraLost):
            cameras.append(open_aravis_camera(AravisSettings(LOOPBACK, latency=0.005, **others)))
        return bool(cameras)

    wait_for(is_open)
    return cameras[0]


@tool
@library
@pytest.mark.alone
def test_the_camera_accepts_its_settings_and_gives_frames_on_the_computers_clock() -> None:
    size = {"width": 640, "height": 480}
    with fake_camera(), closing(open_camera(**size, frame_rate=60.0, exposure=0.004)) as camera:
        frames = frames_of(camera, 90)
        assert all(frame.image.shape == (480, 640, 3) for frame in frames)
        assert all(a.number < b.number for a, b in itertools.pairwise(frames))
        assert all(frame.exposure <= frame.arrival - 5_000_000 for frame in frames)
        assert 0.0 < camera.counts().uncertainty_ms < 200.0


@tool
@library
@pytest.mark.slow
def test_a_lost_camera_is_reopened() -> None:
    with fake_camera() as first, closing(open_camera(frame_rate=60.0)) as camera:
        before = frames_of(camera, 5)[-1].number
        first.kill()
        wait_for(lambda: "no more frames come" in camera.counts().trouble)
        with fake_camera():
            wait_for(lambda: camera.counts().reconnects > 0)
            assert frames_of(camera, 5)[-1].number > before


@tool
@library
@pytest.mark.alone
def test_incomplete_frames_are_dropped_and_counted_and_keep_their_numbers() -> None:
    size = {"width": 640, "height": 480}
    with fake_camera(5), closing(open_camera(**size, frame_rate=60.0)) as camera:
        frames = frames_of(camera, 60)
        wait_for(lambda: camera.counts().incomplete > 10)
        assert any(b.number > a.number + 1 for a, b in itertools.pairwise(frames))
        assert camera.counts().frames >= 60


@library
@pytest.mark.alone
def test_emulated_frames_arrive_complete_in_order_and_with_correct_times() -> None:
    """The stamps are true exposure times, so the errors are known."""
    source_camera = NumberedCamera()
    with (
        closing(GigeCamera(source_camera, 320, 240)),
        closing(open_camera(frame_rate=60.0)) as camera,
    ):
        frames = frames_of(camera, 240)
        uncertainty = camera.counts().uncertainty_ms * 1e-3
        lost = camera.counts().lost
    numbers = [read_number(frame.image) for frame in frames]
    assert all(earlier <= later for earlier, later in itertools.pairwise(numbers))
    assert len(set(numbers)) > 200 and lost < 40
    late = [f.exposure - source_camera.exposure(n) for f, n in zip(frames, numbers, strict=True)]
    assert max(late[120:]) - min(late[120:]) < 4e9 * uncertainty


@library
@pytest.mark.alone
@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"width": 7000}, "7000"),
        ({"gain": 1e7}, "10000000"),
    ],
)
def test_a_refused_setting_is_reported_in_one_sentence(settings: Any, message: str) -> None:
    with (
        closing(GigeCamera(NumberedCamera(), 320, 240)),
        pytest.raises(RcmServoError, match=message) as error,
    ):
        open_aravis_camera(AravisSettings(LOOPBACK, latency=0.005, **settings)).close()
    assert "\n" not in str(error.value)


@library
@pytest.mark.alone
def test_a_missing_camera_is_reported_in_one_sentence() -> None:
    with pytest.raises(CameraLost, match=r"^camera 127\.0\.0\.1: .*connect") as error:
        open_aravis_camera(AravisSettings(LOOPBACK, latency=0.005))
    assert "\n" not in str(error.value)


def test_a_missing_library_is_reported_with_its_install_command() -> None:
    def load(name: str) -> Any:
        raise OSError(f"{name}: cannot open shared object file")

    with pytest.raises(AravisError) as error:
        Aravis(load)
    assert str(error.value) == NOT_INSTALLED and "apt-get install libaravis-0.8-0" in NOT_INSTALLED


@pytest.mark.parametrize(
    ("ids", "steps"),
    [
        ([65534, 65535, 1, 2], [1, 1, 1, 1]),
        ([65530, 3], [1, 8]),
        ([7, 8, 10, 11], [1, 1, 2, 1]),
        ([60000, 1, 2], [1, 5536, 1]),
        ([500, 1, 2], [1, 1, 1]),
        ([0, 1, 2**40, 2**40 + 2], [1, 1, 1, 2]),
        ([5, 5, 6], [1, 1, 1]),
    ],
)
def test_wrapped_ids_continue_and_restarted_ids_count_no_loss(
    ids: list[int], steps: list[int]
) -> None:
    counted = FrameIds()
    assert [counted.step(number) for number in ids] == steps


@pytest.mark.parametrize("number", PIXEL_FORMATS)
def test_every_pixel_format_is_decoded_to_the_original_image(number: int) -> None:
    name = PIXEL_FORMATS[number][0]
    image = cv2.GaussianBlur(numbered_image(0b1010011001, 320, 240), (15, 15), 4.0)
    content = encode_image(image, 240, 320, number)
    size = content.nbytes
    decoded = decode_raw_image(number, 320, 240, content.ctypes.data, size)
    assert decoded is not None and decoded.shape == image.shape
    grey = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    expected = grey if name == "Mono8" else image
    inner = np.s_[4:-4, 4:-4]
    assert np.abs(decoded[inner].astype(int) - expected[inner]).max() <= 12 * ("Bayer" in name)
    assert decode_raw_image(number, 320, 240, content.ctypes.data, size - 1) is None
    assert decode_raw_image(0x01100003, 320, 240, content.ctypes.data, size) is None


RESULTS = {
    "camera_new": 1,
    "camera_create_stream": 2,
    "camera_get_payload": 320 * 240 * 3,
    "camera_is_gv_device": False,
    "buffer_get_image_width": 320,
    "buffer_get_image_height": 240,
    "buffer_get_image_pixel_format": 0x02180015,
}


class FakeLibrary:
    """Library whose stream has given buffers, each with id, status and stamp."""

    def __init__(self, *buffers: tuple[int, int, int]) -> None:
        self.buffers = dict(enumerate(buffers, 1))
        self.due, self.pushed = list(self.buffers), list[int]()
        self.content = numbered_image(5)

    def call(self, name: str, *arguments: Any) -> Any:
        if name in ("stream_timeout_pop_buffer", "stream_try_pop_buffer"):
            return self.due.pop(0) if self.due else None
        if name == "stream_push_buffer":
            self.pushed.append(arguments[-1])
        fields = ("buffer_get_frame_id", "buffer_get_status", "buffer_get_timestamp")
        if name in fields:
            return self.buffers[arguments[-1]][fields.index(name)]
        return RESULTS.get(name)

    def find_data(self, _: int) -> tuple[int, int]:
        return self.content.ctypes.data, self.content.nbytes

    def release(self, thing: int) -> None:
        pass


class FakeLimitedCamera(FakeLibrary):
    """Camera whose exposure, at first 50 ms, limits its frame rate.

    With `adapts` it shortens the exposure for a higher rate, otherwise it refuses the rate.
    """

    def __init__(self, adapts: bool) -> None:
        super().__init__()
        self.adapts, self.values = adapts, {"exposure_time": 50_000.0, "frame_rate": 20.0}

    def call(self, name: str, *arguments: Any) -> Any:
        verb, _, key = name.removeprefix("camera_").partition("_")
        if key not in self.values:
            return super().call(name, *arguments)
        if verb == "get":
            return self.values[key]
        self.values[key] = arguments[-1]
        longest = 1e6 / self.values["frame_rate"]
        if key == "frame_rate" and self.values["exposure_time"] > longest:
            if not self.adapts:
                raise AravisError(f"{arguments[-1]:g} is too fast")
            self.values["exposure_time"] = longest
        return None


def test_a_frame_rate_that_needs_the_new_exposure_is_accepted() -> None:
    fake: Any = FakeLimitedCamera(adapts=False)
    AravisStream(AravisSettings(LOOPBACK, frame_rate=60.0, exposure=0.004), fake)
    assert fake.values == {"exposure_time": pytest.approx(4000.0), "frame_rate": 60.0}


def test_an_exposure_shortened_by_the_frame_rate_is_refused() -> None:
    fake: Any = FakeLimitedCamera(adapts=True)
    with pytest.raises(BadInput, match=r"camera.exposure must be .*has set 0.01\d*\), got 0.03"):
        AravisStream(AravisSettings(LOOPBACK, frame_rate=60.0, exposure=0.03), fake)


def stream_of(*buffers: tuple[int, int, int]) -> tuple[AravisStream, FakeLibrary]:
    fake: Any = FakeLibrary(*buffers)
    stream = AravisStream(AravisSettings(LOOPBACK, latency=0.01), fake)
    fake.pushed.clear()
    return stream, fake


def test_the_newest_buffer_is_read_and_all_are_returned() -> None:
    stream, fake = stream_of((65534, 0, 10), (65535, 3, 20), (3, 0, 30))
    snapshot = stream.read()
    assert snapshot is not None and read_number(snapshot.image) == 5
    assert (snapshot.lost, snapshot.skipped, snapshot.incomplete) == (2, 1, 1)
    assert fake.pushed == [1, 2, 3]
    assert stream.read() is None


def test_an_incomplete_frame_has_no_image() -> None:
    stream, _ = stream_of((1, 3, 10))
    snapshot = stream.read()
    assert snapshot is not None and snapshot.image is None


def test_without_stamps_the_exposure_is_the_latency_before_the_arrival() -> None:
    stream, _ = stream_of((1, 0, 0))
    snapshot = stream.read()
    assert snapshot is not None and snapshot.exposure == snapshot.arrival - 10_000_000
    assert np.isnan(snapshot.uncertainty)


def test_the_stream_gets_all_its_buffers() -> None:
    fake: Any = FakeLibrary()
    AravisStream(AravisSettings(LOOPBACK), fake)
    assert len(fake.pushed) == BUFFER_COUNT and LOST_AFTER_S > 1.0


@library
def test_the_library_has_every_declared_function() -> None:
    loaded = ctypes.CDLL(LIBRARY)
    assert all(hasattr(loaded, f"arv_{name}") for name in (*CAN_FAIL, *CANNOT_FAIL))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"address": ""}, "camera.address must be an address or a name"),
        ({"packet_size": 100}, "camera.packet_size must be a whole number of bytes"),
        ({"latency": float("nan")}, "camera.latency must be a time from 0 to 1 s"),
    ],
)
def test_invalid_settings_are_reported_in_one_sentence(settings: Any, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        AravisSettings(**{"address": LOOPBACK, **settings})


def test_the_document_shows_a_valid_camera(tmp_path: Path) -> None:
    block = re.search(r"```toml\n(.*?)```", (ROOT / "docs/cameras.md").read_text(), re.S)
    assert block is not None
    rig = tmp_path / "lab.toml"
    rig.write_text(block[1])
    settings = load_rig_file(rig).decode_device_settings("camera", CAMERA_KINDS)
    assert settings == AravisSettings("192.168.1.20", 0.012, 640, 480, 60.0, 0.004, 6.0)


def test_large_packets_are_used_on_this_computer_only() -> None:
    sizes = [
        AravisSettings(address).effective_packet_size for address in (LOOPBACK, "10.0.0.7", "Cam-1")
    ]
    assert sizes == [9000, 1400, 1400]
    assert AravisSettings("10.0.0.7", packet_size=8192).effective_packet_size == 8192
