"""A film can be played by every browser, or is not there and says why."""

import resource
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import av
import numpy as np
import pytest

from rcmservo.figures.video import MISSING, Video

FRAMES = 60


@contextmanager
def files_of_at_most(size: int) -> Generator[None]:
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, usual[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)


def filmed(path: Path, count: int = FRAMES, size: tuple[int, int] = (320, 240)) -> Video:
    random = np.random.default_rng(0)
    video = Video(path, size, 60.0)
    for _ in range(count):
        video.write(random.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8))
    video.close()
    return video


def boxes(path: Path) -> list[bytes]:
    """The names of an MP4 file's outermost boxes, in order."""
    data, place, names = path.read_bytes(), 0, []
    while place < len(data):
        names.append(data[place + 4 : place + 8])
        place += int.from_bytes(data[place : place + 4])
    return names


def test_a_browser_can_play_the_film_from_its_first_bytes_on(tmp_path: Path) -> None:
    assert filmed(tmp_path / "whole.mp4").failed == ""
    with av.open(str(tmp_path / "whole.mp4")) as file:
        stream = file.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.codec_context.pix_fmt == "yuv420p"
        assert stream.average_rate == 60
    names = boxes(tmp_path / "whole.mp4")
    assert names.index(b"moov") < names.index(b"mdat")


def test_a_film_holds_every_frame_in_its_order_and_colours(tmp_path: Path) -> None:
    video = Video(tmp_path / "whole.mp4", (64, 48), 60.0)
    colours = [(4 * i, 255 - 4 * i, 2 * i) for i in range(FRAMES)]
    for colour in colours:
        video.write(np.full((48, 64, 3), colour, dtype=np.uint8))
    video.close()
    with av.open(str(tmp_path / "whole.mp4")) as file:
        pictures = [frame.to_ndarray(format="bgr24") for frame in file.decode(video=0)]
    seen = [picture.mean(axis=(0, 1)) for picture in pictures]
    np.testing.assert_allclose(seen, colours, atol=4.0)


def test_of_an_odd_size_the_last_line_is_left_out(tmp_path: Path) -> None:
    assert filmed(tmp_path / "odd.mp4", 3, (321, 241)).failed == ""
    with av.open(str(tmp_path / "odd.mp4")) as file:
        context = file.streams.video[0].codec_context
        assert (context.width, context.height) == (320, 240)


@pytest.mark.parametrize("short_of", [2_000_000, 1_500_000, 1])
def test_a_film_that_the_disk_has_no_room_for_is_removed_and_says_so(
    short_of: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    filmed(tmp_path / "whole.mp4")
    size = (tmp_path / "whole.mp4").stat().st_size
    (tmp_path / "whole.mp4").unlink()
    with files_of_at_most(size - short_of):
        video = filmed(tmp_path / "cut.mp4")
    assert video.failed == "cut.mp4 could not be written and was removed: File too large"
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr().err == ""


def test_a_film_without_a_picture_or_in_no_folder_is_not_there_and_says_so(tmp_path: Path) -> None:
    assert filmed(tmp_path / "none.mp4", 0).failed.endswith("no picture came")
    assert filmed(tmp_path / "nowhere" / "x.mp4", 3).failed.endswith("No such file or directory")
    assert not list(tmp_path.iterdir())


def test_until_it_is_closed_a_film_bears_another_name(tmp_path: Path) -> None:
    video = Video(tmp_path / "film.mp4", (64, 48), 60.0)
    for _ in range(100):
        video.write(np.zeros((48, 64, 3), dtype=np.uint8))
    assert not (tmp_path / "film.mp4").exists()
    video.close()
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]


def test_without_pyav_one_sentence_names_the_command_that_installs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("av", "av.error"):
        monkeypatch.setitem(sys.modules, name, None)
    video = filmed(tmp_path / "film.mp4", 3)
    assert video.failed == MISSING and "pip install 'rcmservo[video]'" in MISSING
    assert not list(tmp_path.iterdir())
