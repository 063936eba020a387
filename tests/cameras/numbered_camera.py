"""Images with a number, so that a test can identify each frame."""

import threading
import time
from collections.abc import Callable

import numpy as np

from rcmservo.interfaces import Frame, Image

BITS, LIGHT, DARK = 16, 220, 30
TIMEOUT_S = 60.0
"""Time limit of all waits."""


def numbered_image(number: int, width: int = 320, height: int = 240) -> Image:
    """Return an image with the bits of a number as light and dark stripes above a red ground."""
    image = np.full((height, width, 3), (20, 40, 160), np.uint8)
    stripe = width // BITS
    for bit in range(BITS):
        image[: height // 2, bit * stripe : (bit + 1) * stripe] = (
            LIGHT if number >> bit & 1 else DARK
        )
    return image


def read_number(image: Image | None) -> int:
    """Return the number in an image; its ground must be red."""
    assert image is not None
    height, width, _ = image.shape
    blue, green, red = image[3 * height // 4, width // 2].tolist()
    assert red > 120 and max(blue, green) < 80
    middles = (np.arange(BITS) + 0.5) * (width // BITS)
    row = image[height // 4, middles.astype(int), 1]
    return sum(int(value > (LIGHT + DARK) / 2) << bit for bit, value in enumerate(row))


class NumberedCamera:
    """Camera whose frame k, exposed at k/rate s, contains the number k."""

    def __init__(self, rate: float = 60.0) -> None:
        self.rate, self.start = rate, time.monotonic_ns()
        self._frame: Frame | None = None

    def exposure(self, number: int) -> int:
        return self.start + round(number * 1e9 / self.rate)

    def latest(self) -> Frame | None:
        now = time.monotonic_ns()
        number = int((now - self.start) * self.rate / 1e9)
        if self._frame is None or number > self._frame.number:
            image = numbered_image(number)
            self._frame = Frame(number, self.exposure(number), now, image=image)
        return self._frame


def wait_for(condition: Callable[[], bool]) -> None:
    """Wait for a condition."""
    end, never = time.monotonic() + TIMEOUT_S, threading.Event()
    while not condition():
        assert time.monotonic() < end, "the condition did not become true"
        never.wait(0.002)


def frames_of(camera: object, count: int) -> list[Frame]:
    """Return a number of different frames of a camera."""
    frames: list[Frame] = []

    def enough() -> bool:
        frame = camera.latest()  # type: ignore[attr-defined]
        if frame is not None and (not frames or frame is not frames[-1]):
            frames.append(frame)
        return len(frames) >= count

    wait_for(enough)
    return frames
