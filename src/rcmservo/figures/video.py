"""A film that every browser plays: VP8 in a WebM file, written by OpenCV, which has no H.264."""

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

UNWANTED = b"OpenCV: FFMPEG: tag 0x30385056/'VP80' is not supported"
"""Beginning of the line that OpenCV prints to stderr for every WebM file, although it writes it:
WebM names its codecs by words, and OpenCV looks for a four-letter tag."""

LOGGING: Any = getattr(cv2.utils, "logging", cv2)
"""Module of OpenCV that holds `setLogLevel`; it is cv2 itself before OpenCV 5."""

ONLY_ERRORS = 2
"""OpenCV's log level that leaves out warnings."""

PROBE_BYTES = 1 << 16
"""Appended to an incomplete film, to hear the system's reason. Twice FFmpeg's buffer, which is what
a file can lack."""


class Video:
    """A film that grows picture by picture; `close` ends it.

    It never stops a run. On failure ``failed``, which is empty otherwise, holds the reason, and no
    file is left.
    """

    def __init__(self, path: Path, size: tuple[int, int], frame_rate: float) -> None:
        self.failed = ""
        self._path, self._part = path, path.with_suffix(f".part{path.suffix}")
        self._width, self._height = (side // 2 * 2 for side in size)
        self._writer: cv2.VideoWriter | None = None
        self._count = 0
        self._try(partial(self._open, frame_rate))

    def write(self, image: Image) -> None:
        """Add a picture (height, width, 3), blue-green-red, at most as large as the film."""
        if self._writer is not None:
            self._try(partial(self._add, self._writer, image))

    def close(self) -> None:
        """End the film: from now on the file is complete, or absent."""
        if self._writer is not None:
            self._try(partial(self._end, self._writer))

    def _open(self, frame_rate: float) -> None:
        self._part.touch()
        size = self._width, self._height
        with _without_line(UNWANTED):
            writer = cv2.VideoWriter(str(self._part), cv2.CAP_FFMPEG, CODEC, frame_rate, size)
        if not writer.isOpened():
            raise OSError("this OpenCV cannot write VP8 in WebM")
        self._writer = writer

    def _add(self, writer: cv2.VideoWriter, image: Image) -> None:
        even = np.ascontiguousarray(image[: self._height, : self._width])
        with _without_warnings():
            is_written: bool | None = writer.write(even)  # None before OpenCV 5
        if is_written is False:
            raise _reason_of_incomplete(self._part)
        self._count += 1

    def _end(self, writer: cv2.VideoWriter) -> None:
        if not self._count:
            raise OSError("no picture came")
        writer.release()
        if not _is_complete(self._part):
            raise _reason_of_incomplete(self._part)
        self._part.replace(self._path)
        self._writer = None

    def _try(self, act: Callable[[], None]) -> None:
        """Do something with the film; on failure give the film up."""
        try:
            act()
        except (cv2.error, OSError) as error:
            why = getattr(error, "strerror", None) or error
            self.failed = f"{self._path.name} could not be written and was removed: {why}"
            if self._writer is not None:
                self._writer.release()
                self._writer = None
            self._part.unlink(missing_ok=True)


def _is_complete(path: Path) -> bool:
    """Return whether the header holds the film's duration: it is written after all the rest, and
    not at all after a failure."""
    film = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    return film.get(cv2.CAP_PROP_FRAME_COUNT) > 0


def _reason_of_incomplete(path: Path) -> OSError:
    """Return the system's reason to refuse more bytes of this file; OpenCV reports none."""
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
    before = LOGGING.setLogLevel(ONLY_ERRORS)
    try:
        yield
    finally:
        LOGGING.setLogLevel(before)


@contextmanager
def _without_line(unwanted: bytes) -> Generator[None]:
    """Drop the lines on stderr that begin like this, which C code prints; pass on all others when
    the block ends."""
    sys.stderr.flush()
    with tempfile.TemporaryFile() as caught:
        stderr = os.dup(2)
        os.dup2(caught.fileno(), 2)
        try:
            yield
        finally:
            sys.stderr.flush()
            os.dup2(stderr, 2)
            os.close(stderr)
            caught.seek(0)
            for line in caught:
                if not line.startswith(unwanted):
                    os.write(2, line)
