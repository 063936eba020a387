"""Pictures that bear a number, so that a test knows what it was sent."""

import threading
import time
from collections.abc import Callable

import numpy as np

from rcmservo.interfaces import Frame, Image

BITS, LIGHT, DARK = 16, 220, 30
TIME_OUT = 60.0
"""s in which whatever a test waits for has happened."""


def picture(number: int, width: int = 320, height: int = 240) -> Image:
    """The number in stripes of light and dark, from the left, over a red ground."""
    image = np.full((height, width, 3), (20, 40, 160), np.uint8)
    stripe = width // BITS
    for bit in range(BITS):
        image[: height // 2, bit * stripe : (bit + 1) * stripe] = (
            LIGHT if number >> bit & 1 else DARK
        )
    return image


def number_in(image: Image | None) -> int:
    """The number that a picture bears; its ground must be red."""
    assert image is not None
    height, width, _ = image.shape
    blue, green, red = image[3 * height // 4, width // 2].tolist()
    assert red > 120 and max(blue, green) < 80
    middles = (np.arange(BITS) + 0.5) * (width // BITS)
    row = image[height // 4, middles.astype(int), 1]
    return sum(int(value > (LIGHT + DARK) / 2) << bit for bit, value in enumerate(row))


class NumberedCamera:
    """A camera whose frame k, exposed at its k/rate s, bears the number k."""

    def __init__(self, rate: float = 60.0) -> None:
        self.rate, self.start = rate, time.monotonic_ns()
        self._frame: Frame | None = None

    def exposure(self, number: int) -> int:
        return self.start + round(number * 1e9 / self.rate)

    def latest(self) -> Frame | None:
        now = time.monotonic_ns()
        number = int((now - self.start) * self.rate / 1e9)
        if self._frame is None or number > self._frame.number:
            image = picture(number)
            self._frame = Frame(number, self.exposure(number), now, image=image)
        return self._frame


def wait_for(reached: Callable[[], bool]) -> None:
    """Wait until something has happened."""
    end, never = time.monotonic() + TIME_OUT, threading.Event()
    while not reached():
        assert time.monotonic() < end, "it has not happened"
        never.wait(0.002)


def frames_of(camera: object, count: int) -> list[Frame]:
    """So many different frames of a camera, as its user gets them."""
    seen: list[Frame] = []

    def enough() -> bool:
        frame = camera.latest()  # type: ignore[attr-defined]
        if frame is not None and (not seen or frame is not seen[-1]):
            seen.append(frame)
        return len(seen) >= count

    wait_for(enough)
    return seen
