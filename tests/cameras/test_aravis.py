"""Cameras by Aravis, against the fake GigE Vision camera of its own tools, and against ours, which
carries frames whose content is known."""

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
from numbered import NumberedCamera, frames_of, number_in, picture, wait_for

from conftest import ROOT
from peers import peer
from rcmservo.config.rig_file import load_lab
from rcmservo.errors import BadInput, RcmServoError
from rcmservo.hardware.cameras.aravis import (
    BUFFERS,
    FORMATS,
    GONE,
    AravisStream,
    aravis_camera,
)
from rcmservo.hardware.cameras.aravis import picture as received
from rcmservo.hardware.cameras.aravis_library import (
    CAN_FAIL,
    CANNOT_FAIL,
    LIBRARY,
    MISSING,
    Aravis,
    AravisError,
)
from rcmservo.hardware.cameras.emulated.gige_camera import GigeCamera, sent
from rcmservo.hardware.cameras.frame_ids import FrameIds
from rcmservo.hardware.cameras.settings import AravisSettings
from rcmservo.hardware.cameras.streamed import CameraLost
from rcmservo.hardware.devices import CAMERAS

FAKE = "arv-fake-gv-camera-0.8"


def installed() -> bool:
    with suppress(OSError):
        return bool(ctypes.CDLL(LIBRARY))
    return False


library = peer("Aravis library", installed(), "sudo apt-get install libaravis-0.8-0")
tool = peer(
    "Aravis' fake GigE camera", shutil.which(FAKE) is not None, "sudo apt-get install aravis-tools"
)
HERE = "127.0.0.1"


@contextmanager
def fake_camera(lost: int = 0) -> Iterator[subprocess.Popen[bytes]]:
    """The one of Aravis' tools; of a thousand packets so many do not get through."""
    with subprocess.Popen([FAKE, "-i", HERE, "-r", str(lost)]) as process:
        try:
            yield process
        finally:
            process.kill()


def opened(**others: Any) -> Any:
    """The camera at this computer, as soon as it can be opened."""
    found: list[Any] = []

    def there() -> bool:
        with suppress(CameraLost):
            found.append(aravis_camera(AravisSettings(HERE, latency=0.005, **others)))
        return bool(found)

    wait_for(there)
    return found[0]


@tool
@library
@pytest.mark.alone
def test_it_takes_its_settings_and_gives_frames_on_our_clock() -> None:
    size = {"width": 640, "height": 480}
    with fake_camera(), closing(opened(**size, frame_rate=60.0, exposure=0.004)) as camera:
        frames = frames_of(camera, 90)
        assert all(frame.image.shape == (480, 640, 3) for frame in frames)
        assert all(a.number < b.number for a, b in itertools.pairwise(frames))
        assert all(frame.exposure <= frame.arrival - 5_000_000 for frame in frames)
        assert 0.0 < camera.account().uncertainty_ms < 200.0


@tool
@library
@pytest.mark.alone
@pytest.mark.slow
def test_one_that_was_gone_is_opened_again() -> None:
    with fake_camera() as first, closing(opened(frame_rate=60.0)) as camera:
        before = frames_of(camera, 5)[-1].number
        first.kill()
        wait_for(lambda: "no more frames come" in camera.account().trouble)
        with fake_camera():
            wait_for(lambda: camera.account().reconnects > 0)
            assert frames_of(camera, 5)[-1].number > before


@tool
@library
@pytest.mark.alone
def test_frames_that_lack_packets_are_dropped_counted_and_keep_their_numbers() -> None:
    size = {"width": 640, "height": 480}
    with fake_camera(5), closing(opened(**size, frame_rate=60.0)) as camera:
        frames = frames_of(camera, 60)
        wait_for(lambda: camera.account().incomplete > 10)
        assert any(b.number > a.number + 1 for a, b in itertools.pairwise(frames))
        assert camera.account().frames >= 60


@library
@pytest.mark.alone
def test_our_frames_come_whole_in_order_and_at_their_times() -> None:
    """The stamps are true exposures, so that what is told of them can be judged."""
    filmed = NumberedCamera()
    with closing(GigeCamera(filmed, 320, 240)), closing(opened(frame_rate=60.0)) as camera:
        frames = frames_of(camera, 240)
        uncertainty = camera.account().uncertainty_ms * 1e-3
        lost = camera.account().lost
    numbers = [number_in(frame.image) for frame in frames]
    assert all(earlier <= later for earlier, later in itertools.pairwise(numbers))
    assert len(set(numbers)) > 200 and lost < 40
    late = [f.exposure - filmed.exposure(n) for f, n in zip(frames, numbers, strict=True)]
    assert max(late[120:]) - min(late[120:]) < 4e9 * uncertainty


@library
@pytest.mark.alone
@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"width": 7000}, "7000"),
        ({"gain": 1e7}, "10000000"),
    ],
)
def test_a_setting_that_it_does_not_take_is_one_sentence(settings: Any, said: str) -> None:
    with (
        closing(GigeCamera(NumberedCamera(), 320, 240)),
        pytest.raises(RcmServoError, match=said) as error,
    ):
        aravis_camera(AravisSettings(HERE, latency=0.005, **settings)).close()
    assert "\n" not in str(error.value)


@library
@pytest.mark.alone
def test_no_camera_is_one_sentence() -> None:
    with pytest.raises(CameraLost, match=r"^camera 127\.0\.0\.1: .*connect") as error:
        aravis_camera(AravisSettings(HERE, latency=0.005))
    assert "\n" not in str(error.value)


def test_without_the_library_the_command_that_installs_it_is_told() -> None:
    def load(name: str) -> Any:
        raise OSError(f"{name}: cannot open shared object file")

    with pytest.raises(AravisError) as error:
        Aravis(load)
    assert str(error.value) == MISSING and "apt-get install libaravis-0.8-0" in MISSING


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
def test_ids_that_wrap_go_on_and_ids_that_begin_anew_count_no_loss(
    ids: list[int], steps: list[int]
) -> None:
    counted = FrameIds()
    assert [counted.step(number) for number in ids] == steps


@pytest.mark.parametrize("number", FORMATS)
def test_every_pixel_format_becomes_the_picture_that_it_was(number: int) -> None:
    name = FORMATS[number][0]
    image = cv2.GaussianBlur(picture(0b1010011001, 320, 240), (15, 15), 4.0)
    content = sent(image, 240, 320, number)
    room = content.nbytes
    got = received(number, 320, 240, content.ctypes.data, room)
    assert got is not None and got.shape == image.shape
    grey = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    wanted = grey if name == "Mono8" else image
    inner = np.s_[4:-4, 4:-4]
    assert np.abs(got[inner].astype(int) - wanted[inner]).max() <= 12 * ("Bayer" in name)
    assert received(number, 320, 240, content.ctypes.data, room - 1) is None
    assert received(0x01100003, 320, 240, content.ctypes.data, room) is None


TOLD = {
    "camera_new": 1,
    "camera_create_stream": 2,
    "camera_get_payload": 320 * 240 * 3,
    "camera_is_gv_device": False,
    "buffer_get_image_width": 320,
    "buffer_get_image_height": 240,
    "buffer_get_image_pixel_format": 0x02180015,
}


class Buffers:
    """A library in whose stream are buffers that the test says: id, status, stamp."""

    def __init__(self, *buffers: tuple[int, int, int]) -> None:
        self.buffers = dict(enumerate(buffers, 1))
        self.due, self.pushed = list(self.buffers), list[int]()
        self.content = picture(5)

    def call(self, name: str, *arguments: Any) -> Any:
        if name in ("stream_timeout_pop_buffer", "stream_try_pop_buffer"):
            return self.due.pop(0) if self.due else None
        if name == "stream_push_buffer":
            self.pushed.append(arguments[-1])
        told = ("buffer_get_frame_id", "buffer_get_status", "buffer_get_timestamp")
        if name in told:
            return self.buffers[arguments[-1]][told.index(name)]
        return TOLD.get(name)

    def data(self, _: int) -> tuple[int, int]:
        return self.content.ctypes.data, self.content.nbytes

    def release(self, thing: int) -> None:
        pass


class Bounded(Buffers):
    """A camera whose frame rate is bounded by its exposure, which is 50 ms when it starts. One that
    gives way exposes for less where frames are to come faster."""

    def __init__(self, gives_way: bool) -> None:
        super().__init__()
        self.gives_way, self.kept = gives_way, {"exposure_time": 50_000.0, "frame_rate": 20.0}

    def call(self, name: str, *arguments: Any) -> Any:
        verb, _, what = name.removeprefix("camera_").partition("_")
        if what not in self.kept:
            return super().call(name, *arguments)
        if verb == "get":
            return self.kept[what]
        self.kept[what] = arguments[-1]
        longest = 1e6 / self.kept["frame_rate"]
        if what == "frame_rate" and self.kept["exposure_time"] > longest:
            if not self.gives_way:
                raise AravisError(f"{arguments[-1]:g} is too fast")
            self.kept["exposure_time"] = longest
        return None


def test_a_frame_rate_that_only_the_new_exposure_allows_is_taken() -> None:
    fake: Any = Bounded(gives_way=False)
    AravisStream(AravisSettings(HERE, frame_rate=60.0, exposure=0.004), fake)
    assert fake.kept == {"exposure_time": pytest.approx(4000.0), "frame_rate": 60.0}


def test_an_exposure_that_the_frame_rate_cut_is_refused() -> None:
    fake: Any = Bounded(gives_way=True)
    with pytest.raises(
        BadInput, match=r"camera.exposure must be .*makes 0.01\d* of it\), got 0.03"
    ):
        AravisStream(AravisSettings(HERE, frame_rate=60.0, exposure=0.03), fake)


def stream_of(*buffers: tuple[int, int, int]) -> tuple[AravisStream, Buffers]:
    fake: Any = Buffers(*buffers)
    stream = AravisStream(AravisSettings(HERE, latency=0.01), fake)
    fake.pushed.clear()
    return stream, fake


def test_of_what_has_come_the_newest_is_taken_and_all_are_given_back() -> None:
    stream, fake = stream_of((65534, 0, 10), (65535, 3, 20), (3, 0, 30))
    shot = stream.next()
    assert shot is not None and number_in(shot.image) == 5
    assert (shot.missed, shot.passed, shot.spoilt) == (2, 1, 1)
    assert fake.pushed == [1, 2, 3]
    assert stream.next() is None


def test_an_incomplete_frame_is_no_picture() -> None:
    stream, _ = stream_of((1, 3, 10))
    shot = stream.next()
    assert shot is not None and shot.image is None


def test_without_stamps_the_exposure_is_the_latency_before_the_arrival() -> None:
    stream, _ = stream_of((1, 0, 0))
    shot = stream.next()
    assert shot is not None and shot.exposure == shot.arrival - 10_000_000
    assert np.isnan(shot.uncertainty)


def test_a_buffer_is_there_for_every_frame_on_its_way() -> None:
    fake: Any = Buffers()
    AravisStream(AravisSettings(HERE), fake)
    assert len(fake.pushed) == BUFFERS and GONE > 1.0


@library
def test_every_function_that_is_named_is_in_the_library() -> None:
    loaded = ctypes.CDLL(LIBRARY)
    assert all(hasattr(loaded, f"arv_{name}") for name in (*CAN_FAIL, *CANNOT_FAIL))


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"address": ""}, "camera.address must be an address or a name"),
        ({"packet_size": 100}, "camera.packet_size must be a whole number of bytes"),
        ({"latency": float("nan")}, "camera.latency must be a time from 0 to 1 s"),
    ],
)
def test_settings_that_cannot_be_are_one_sentence(settings: Any, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        AravisSettings(**{"address": HERE, **settings})


def test_the_page_shows_a_camera_that_can_be(tmp_path: Path) -> None:
    block = re.search(r"```toml\n(.*?)```", (ROOT / "docs/cameras.md").read_text(), re.S)
    assert block is not None
    rig = tmp_path / "lab.toml"
    rig.write_text(block[1])
    settings = load_lab(rig).device("camera", CAMERAS)
    assert settings == AravisSettings("192.168.1.20", 0.012, 640, 480, 60.0, 0.004, 6.0)


def test_large_packets_are_for_this_computer_only() -> None:
    sizes = [AravisSettings(address).bytes_of_packet for address in (HERE, "10.0.0.7", "Cam-1")]
    assert sizes == [9000, 1400, 1400]
    assert AravisSettings("10.0.0.7", packet_size=8192).bytes_of_packet == 8192
