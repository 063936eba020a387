"""A video plays in every browser, or is absent with a reason."""

import os
import resource
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from rcmservo.figures import video
from rcmservo.figures.video import VideoWriter
from rcmservo.interfaces import Image

FRAMES = 60


@contextmanager
def file_size_limit(size: int) -> Generator[None]:
    previous = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, previous[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, previous)


def write_video(path: Path, count: int = FRAMES, size: tuple[int, int] = (160, 120)) -> VideoWriter:
    random = np.random.default_rng(0)
    video = VideoWriter(path, size, 60.0)
    for _ in range(count):
        video.write(random.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8))
    video.close()
    return video


def read_frames(path: Path) -> list[Image]:
    video, frames = cv2.VideoCapture(str(path)), []
    while (read := video.read())[0]:
        frames.append(read[1])
    return frames


def test_a_browser_can_play_the_video(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "whole.webm"
    assert write_video(path).failed == ""
    data = path.read_bytes()[:1000]
    assert data.startswith(b"\x1aE\xdf\xa3") and b"webm" in data and b"V_VP8" in data
    video = cv2.VideoCapture(str(path))
    assert (video.get(cv2.CAP_PROP_FPS), video.get(cv2.CAP_PROP_FRAME_COUNT)) == (60.0, FRAMES)
    assert capfd.readouterr() == ("", "")


def test_a_video_holds_every_frame_in_order_with_its_colours(tmp_path: Path) -> None:
    video = VideoWriter(tmp_path / "whole.webm", (64, 48), 60.0)
    colours = [(4 * i, 255 - 4 * i, 2 * i) for i in range(FRAMES)]
    for colour in colours:
        video.write(np.full((48, 64, 3), colour, dtype=np.uint8))
    video.close()
    means = [frame.mean(axis=(0, 1)) for frame in read_frames(tmp_path / "whole.webm")]
    np.testing.assert_allclose(means, colours, atol=6.0)


def test_an_odd_size_loses_its_last_line(tmp_path: Path) -> None:
    assert write_video(tmp_path / "odd.webm", 3, (65, 49)).failed == ""
    frames = read_frames(tmp_path / "odd.webm")
    assert [frame.shape for frame in frames] == [(48, 64, 3)] * 3


def test_only_the_opencv_warning_is_removed_from_stderr(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def open_writer(*words: object) -> cv2.VideoWriter:
        os.write(2, b"of C code\n")
        return VideoWriter(*words)

    VideoWriter = cv2.VideoWriter
    monkeypatch.setattr(cv2, "VideoWriter", open_writer)
    assert write_video(tmp_path / "film.webm", 3).failed == ""
    assert capfd.readouterr().err == "of C code\n"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "whole.webm"
    assert write_video(path).failed == ""
    return path


@pytest.mark.parametrize("missing_fraction", [0.6, 0.9, 0.0])
def test_a_video_without_disk_space_is_removed_with_the_reason(
    missing_fraction: float, whole: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The space for all but one byte is missing for the index alone."""
    size = whole.stat().st_size
    with file_size_limit(size - max(1, int(size * missing_fraction))):
        video = write_video(tmp_path / "cut.webm")
    assert video.failed == "cut.webm could not be written and was removed: File too large"
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr().err == ""


def test_a_video_without_frames_or_folder_is_absent_with_the_reason(tmp_path: Path) -> None:
    assert write_video(tmp_path / "none.webm", 0).failed.endswith("it received no frame")
    assert write_video(tmp_path / "nowhere" / "x.webm", 3).failed.endswith(
        "No such file or directory"
    )
    assert not list(tmp_path.iterdir())


def test_an_open_video_has_another_name(tmp_path: Path) -> None:
    video = VideoWriter(tmp_path / "film.webm", (64, 48), 60.0)
    for _ in range(100):
        video.write(np.zeros((48, 64, 3), dtype=np.uint8))
    assert not (tmp_path / "film.webm").exists()
    video.close()
    assert [path.name for path in tmp_path.iterdir()] == ["film.webm"]


def test_a_missing_vp8_encoder_is_reported_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(video, "CODEC", cv2.VideoWriter.fourcc(*"none"))
    failed = write_video(tmp_path / "film.webm", 3).failed
    assert failed.endswith("this OpenCV cannot write VP8 in WebM")
    assert not list(tmp_path.iterdir())


def test_a_frame_that_opencv_refuses_ends_the_video_and_not_the_run(tmp_path: Path) -> None:
    video = VideoWriter(tmp_path / "film.webm", (64, 48), 60.0)
    video.write(np.zeros((48, 64, 3)))
    video.write(np.zeros((48, 64, 3), dtype=np.uint8))
    video.close()
    assert "film.webm could not be written and was removed" in video.failed
    assert not list(tmp_path.iterdir())
