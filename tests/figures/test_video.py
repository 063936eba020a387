"""A film can be played by every browser, or is not there and says why."""

import os
import resource
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from conftest import first_quick
from rcmservo.figures import video
from rcmservo.figures.video import Video
from rcmservo.interfaces import Image

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
    film = Video(path, size, 60.0)
    for _ in range(count):
        film.write(random.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8))
    film.close()
    return film


def pictures(path: Path) -> list[Image]:
    film, found = cv2.VideoCapture(str(path)), []
    while (read := film.read())[0]:
        found.append(read[1])
    return found


def test_a_browser_can_play_the_film(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert filmed(tmp_path / "whole.webm").failed == ""
    data = (tmp_path / "whole.webm").read_bytes()[:1000]
    assert data.startswith(b"\x1aE\xdf\xa3") and b"webm" in data and b"V_VP8" in data
    film = cv2.VideoCapture(str(tmp_path / "whole.webm"))
    assert (film.get(cv2.CAP_PROP_FPS), film.get(cv2.CAP_PROP_FRAME_COUNT)) == (60.0, FRAMES)
    assert capfd.readouterr() == ("", "")


def test_a_film_holds_every_frame_in_its_order_and_colours(tmp_path: Path) -> None:
    film = Video(tmp_path / "whole.webm", (64, 48), 60.0)
    colours = [(4 * i, 255 - 4 * i, 2 * i) for i in range(FRAMES)]
    for colour in colours:
        film.write(np.full((48, 64, 3), colour, dtype=np.uint8))
    film.close()
    seen = [picture.mean(axis=(0, 1)) for picture in pictures(tmp_path / "whole.webm")]
    np.testing.assert_allclose(seen, colours, atol=6.0)


def test_of_an_odd_size_the_last_line_is_left_out(tmp_path: Path) -> None:
    assert filmed(tmp_path / "odd.webm", 3, (321, 241)).failed == ""
    found = pictures(tmp_path / "odd.webm")
    assert [picture.shape for picture in found] == [(240, 320, 3)] * 3


def test_only_the_warning_of_opencv_is_left_out_of_stderr(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def opened(*words: object) -> cv2.VideoWriter:
        os.write(2, b"of C code\n")
        return VideoWriter(*words)

    VideoWriter = cv2.VideoWriter
    monkeypatch.setattr(cv2, "VideoWriter", opened)
    assert filmed(tmp_path / "film.webm", 3).failed == ""
    assert capfd.readouterr().err == "of C code\n"


@pytest.mark.parametrize("short_of", first_quick([1_500_000, 2_000_000, 1]))
def test_a_film_that_the_disk_has_no_room_for_is_removed_and_says_so(
    short_of: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    filmed(tmp_path / "whole.webm")
    size = (tmp_path / "whole.webm").stat().st_size
    (tmp_path / "whole.webm").unlink()
    with files_of_at_most(size - short_of):
        film = filmed(tmp_path / "cut.webm")
    assert film.failed == "cut.webm could not be written and was removed: File too large"
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr().err == ""


def test_a_film_without_a_picture_or_in_no_folder_is_not_there_and_says_so(tmp_path: Path) -> None:
    assert filmed(tmp_path / "none.webm", 0).failed.endswith("no picture came")
    assert filmed(tmp_path / "nowhere" / "x.webm", 3).failed.endswith("No such file or directory")
    assert not list(tmp_path.iterdir())


def test_until_it_is_closed_a_film_bears_another_name(tmp_path: Path) -> None:
    film = Video(tmp_path / "film.webm", (64, 48), 60.0)
    for _ in range(100):
        film.write(np.zeros((48, 64, 3), dtype=np.uint8))
    assert not (tmp_path / "film.webm").exists()
    film.close()
    assert [path.name for path in tmp_path.iterdir()] == ["film.webm"]


def test_without_an_encoder_of_vp8_one_sentence_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(video, "CODEC", cv2.VideoWriter.fourcc(*"none"))
    failed = filmed(tmp_path / "film.webm", 3).failed
    assert failed.endswith("this OpenCV cannot write VP8 in WebM")
    assert not list(tmp_path.iterdir())


def test_a_picture_that_opencv_refuses_ends_the_film_and_not_the_run(tmp_path: Path) -> None:
    film = Video(tmp_path / "film.webm", (64, 48), 60.0)
    film.write(np.zeros((48, 64, 3)))
    film.write(np.zeros((48, 64, 3), dtype=np.uint8))
    film.close()
    assert "film.webm could not be written and was removed" in film.failed
    assert not list(tmp_path.iterdir())
