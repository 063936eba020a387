"""A video can be played, or is not there and says so."""

import resource
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from rcmservo.figures.overlay import Video

FRAMES = 60


@contextmanager
def files_of_at_most(size: int) -> Generator[None]:
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, usual[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)


def filmed(path: Path) -> Video:
    random = np.random.default_rng(0)
    video = Video(path, (320, 240), 60.0)
    for _ in range(FRAMES):
        video.write(random.integers(0, 256, (240, 320, 3), dtype=np.uint8))
    video.close()
    return video


def test_a_video_holds_every_frame(tmp_path: Path) -> None:
    assert filmed(tmp_path / "whole.mp4").failed == ""
    assert cv2.VideoCapture(str(tmp_path / "whole.mp4")).get(cv2.CAP_PROP_FRAME_COUNT) == FRAMES


def test_a_video_that_the_disk_has_no_room_for_is_removed_and_says_so_once(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with files_of_at_most(500_000):
        video = filmed(tmp_path / "cut.mp4")
    assert video.failed == "cut.mp4 could not be written so that it can be played, and was removed"
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr().err.count("\n") <= 1
