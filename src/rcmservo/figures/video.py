"""Writer of videos that every browser plays: codec VP8 in a WebM file.

OpenCV's wheel has no H.264, the usual codec of MP4 files.
"""

import os
import sys
import tempfile
from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from rcmservo.interfaces import Image

CODEC = cv2.VideoWriter.fourcc(*"VP80")
"""OpenCV's number for VP8."""

OPENCV_TAG_WARNING = b"OpenCV: FFMPEG: tag 0x30385056/'VP80' is not supported"
"""Start of the line that OpenCV prints to stderr for every WebM file, although it writes the file.
WebM names its codecs by words; OpenCV looks for a four-letter tag."""

LOGGING: Any = getattr(cv2.utils, "logging", cv2)
"""OpenCV's module with `setLogLevel`: cv2 itself before OpenCV 5."""

ERROR_LOG_LEVEL = 2
"""OpenCV's log level without warnings."""

PROBE_BYTES = 1 << 16
"""Bytes appended to an incomplete video to obtain the system's error: twice FFmpeg's buffer, which
holds all that a file can lack."""


class VideoWriter:
    """Video file that grows frame by frame until `close`.

    A failure does not stop the run: `failed` then holds the reason, and the file is removed.

    Parameters
    ----------
    path : Path
        File to write, with the suffix .webm.
    size : tuple of int
        Width and height (px). An odd size loses its last line.
    frame_rate : float
        Frames per second.
    """

    def __init__(self, path: Path, size: tuple[int, int], frame_rate: float) -> None:
        self.failed = ""
        self._path, self._partial_path = path, path.with_suffix(f".part{path.suffix}")
        self._width, self._height = (side // 2 * 2 for side in size)
        self._writer: cv2.VideoWriter | None = None
        self._frame_count = 0
        self._attempt(partial(self._open, frame_rate))

    def write(self, image: Image) -> None:
        """Add an image (height, width, 3), uint8, blue-green-red, of the size of the video."""
        if self._writer is not None:
            self._attempt(partial(self._add, self._writer, image))

    def close(self) -> None:
        """Finish the video. The file is then complete or absent."""
        if self._writer is not None:
            self._attempt(partial(self._finish, self._writer))

    def _open(self, frame_rate: float) -> None:
        self._partial_path.touch()
        size = self._width, self._height
        with _without_stderr_line(OPENCV_TAG_WARNING):
            writer = cv2.VideoWriter(
                str(self._partial_path), cv2.CAP_FFMPEG, CODEC, frame_rate, size
            )
        if not writer.isOpened():
            raise OSError("this OpenCV cannot write VP8 in WebM")
        self._writer = writer

    def _add(self, writer: cv2.VideoWriter, image: Image) -> None:
        cropped = np.ascontiguousarray(image[: self._height, : self._width])
        with _without_warnings():
            is_written: bool | None = writer.write(cropped)  # None before OpenCV 5
        if is_written is False:
            raise _find_write_error(self._partial_path)
        self._frame_count += 1

    def _finish(self, writer: cv2.VideoWriter) -> None:
        if not self._frame_count:
            raise OSError("it received no frame")
        writer.release()
        if not _is_complete(self._partial_path):
            raise _find_write_error(self._partial_path)
        self._partial_path.replace(self._path)
        self._writer = None

    def _attempt(self, action: Callable[[], None]) -> None:
        """Run an action on the video; remove the video on failure."""
        try:
            action()
        except (cv2.error, OSError) as error:
            reason = getattr(error, "strerror", None) or error
            self.failed = f"{self._path.name} could not be written and was removed: {reason}"
            if self._writer is not None:
                self._writer.release()
                self._writer = None
            self._partial_path.unlink(missing_ok=True)


def _is_complete(path: Path) -> bool:
    """Return whether the header holds the duration, which OpenCV writes last."""
    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    return video.get(cv2.CAP_PROP_FRAME_COUNT) > 0


def _find_write_error(path: Path) -> OSError:
    """Return the reason why a file is incomplete, which OpenCV does not report.

    The operating system gives it when further bytes are written, for example on a full disk.
    """
    try:
        with path.open("ab") as file:
            file.write(bytes(PROBE_BYTES))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        return error
    return OSError("OpenCV did not write all of it")


@contextmanager
def _without_warnings() -> Generator[None]:
    """Let OpenCV log errors only."""
    previous = LOGGING.setLogLevel(ERROR_LOG_LEVEL)
    try:
        yield
    finally:
        LOGGING.setLogLevel(previous)


@contextmanager
def _without_stderr_line(prefix: bytes) -> Generator[None]:
    """Drop the lines that C code prints to stderr with this prefix.

    All other lines are printed when the block ends.
    """
    sys.stderr.flush()
    with tempfile.TemporaryFile() as captured:
        stderr = os.dup(2)
        os.dup2(captured.fileno(), 2)
        try:
            yield
        finally:
            sys.stderr.flush()
            os.dup2(stderr, 2)
            os.close(stderr)
            captured.seek(0)
            for line in captured:
                if not line.startswith(prefix):
                    os.write(2, line)
