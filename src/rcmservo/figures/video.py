"""A film that every browser plays: H.264 in an MP4 file with its index in front.

It takes PyAV, an extra: OpenCV's wheel knows no H.264.
"""

from collections.abc import Callable
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.interfaces import Image

ENCODER = "libx264"
PIXELS = "yuv420p"
"""The one pixel format that every browser decodes. Four pixels share a colour, so widths and
heights must be even."""

QUALITY = {"preset": "superfast", "crf": "20"}
"""5 ms of work for a picture of 640 x 480 px, and the words in it stay sharp."""

INDEX_FIRST = {"movflags": "faststart"}
"""A browser begins to play before the whole file has come."""

MISSING = "a video takes PyAV, which is not installed: pip install 'rcmservo[video]'"


class Video:
    """A film that grows picture by picture; `close` ends it.

    It never stops a run. What went wrong stands in ``failed``, which is empty otherwise; then no
    file is left.
    """

    def __init__(self, path: Path, size: tuple[int, int], frame_rate: float) -> None:
        self.failed = ""
        self._path, self._part = path, path.with_name(f"{path.name}.part")
        self._film: _Film | None = None
        self._try(partial(self._open, size, frame_rate))

    def write(self, image: Image) -> None:
        """Add a picture (height, width, 3), blue-green-red, at most as large as the film."""
        if self._film is not None:
            self._try(partial(self._film.add, image))

    def close(self) -> None:
        """End the film: from now on it is there whole, or not at all."""
        if self._film is not None:
            self._try(self._end)

    def _open(self, size: tuple[int, int], frame_rate: float) -> None:
        self._film = _Film(self._part, size, frame_rate)

    def _end(self) -> None:
        assert self._film is not None
        self._film.end()
        self._part.replace(self._path)
        self._film = None

    def _try(self, act: Callable[[], None]) -> None:
        """Do something with the film; if that fails it is given up."""
        try:
            from av.error import FFmpegError
        except ModuleNotFoundError:
            self.failed = MISSING
            return
        try:
            act()
        except (FFmpegError, OSError) as error:
            why = getattr(error, "strerror", None) or error
            self.failed = f"{self._path.name} could not be written and was removed: {why}"
            self._film = None
            self._part.unlink(missing_ok=True)


class _Film:
    """A file that is being written, with its one stream of pictures."""

    def __init__(self, path: Path, size: tuple[int, int], frame_rate: float) -> None:
        import av

        self._file = av.open(str(path), "w", format="mp4", options=INDEX_FIRST)
        rate = Fraction(frame_rate).limit_denominator(1000)
        self._stream = self._file.add_stream(ENCODER, rate=rate, options=QUALITY)
        self._stream.width, self._stream.height = (side // 2 * 2 for side in size)
        self._stream.pix_fmt = PIXELS
        self._count = 0

    def add(self, image: Image) -> None:
        import av

        even = np.ascontiguousarray(image[: self._stream.height, : self._stream.width])
        self._file.mux(self._stream.encode(av.VideoFrame.from_ndarray(even, format="bgr24")))
        self._count += 1

    def end(self) -> None:
        if not self._count:
            raise OSError("no picture came")
        self._file.mux(self._stream.encode())
        self._file.close()
