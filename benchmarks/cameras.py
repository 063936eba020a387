"""Latency from exposure to features, by shared memory, Motion JPEG and GigE Vision on loopback.

    python benchmarks/cameras.py [SECONDS]    per transport in each of three rounds (default 20)

One process publishes a rendered image that contains its number, 60 times per second, 22 ms after
its exposure; two other processes forward it. The transports take turns. The exit code is 1 if the
99th percentile of a transport is more than one frame period above that of shared memory, or if it
loses more than 1 % of the frames.
"""

import platform
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from multiprocessing import get_context
from multiprocessing.connection import Connection

import numpy as np

from rcmservo.cli.lab.emulated_arm import send_gige, send_mjpeg
from rcmservo.config.rig_file import RigDescription
from rcmservo.hardware.cameras.aravis import open_aravis_camera
from rcmservo.hardware.cameras.opencv import open_opencv_camera
from rcmservo.hardware.cameras.settings import AravisSettings, OpencvSettings
from rcmservo.interfaces import Camera, Frame, Image
from rcmservo.live.child_process import ChildProcess
from rcmservo.live.frame_ring import FrameRing, RingCamera
from rcmservo.live.tracking_thread import TrackingThread
from rcmservo.loop.clock import WallClock, sleep_until
from rcmservo.sim import Rig
from rcmservo.tracking import ColourMarkers

RATE, ROUNDS = 60.0, 3
PERIOD = 1e9 / RATE
DELAY = 22_000_000
"""Time (ns) from the middle of an exposure to the frame, as in the simulated camera."""
BITS, LIGHT, DARK, ROWS = 16, 220, 30, 16
MAX_LOST_FRACTION = 0.01


def publish(ring: FrameRing, control: Connection) -> None:
    """Publish frames until `control` has a message or closes; frame k is exposed at k/RATE s."""
    rig = Rig(0)
    frame = rig.camera.latest()
    assert frame is not None and frame.image is not None
    image = frame.image.copy()
    control.send("ready")
    number = int(time.monotonic_ns() / PERIOD)
    while not control.poll():
        exposure = round(number * PERIOD)
        _write(image, number)
        sleep_until(exposure + DELAY)
        ring.publish(Frame(number, exposure, time.monotonic_ns(), image=image))
        number = max(number + 1, int((time.monotonic_ns() - DELAY) / PERIOD))


def _write(image: Image, number: int) -> None:
    width = image.shape[1] // BITS
    for bit in range(BITS):
        stripe = image[:ROWS, bit * width : (bit + 1) * width]
        stripe[:] = LIGHT if number >> bit & 1 else DARK


def _number(image: Image, now: int) -> int:
    """Return the number in an image, the newest one that is not later than `now` (ns)."""
    middles = ((np.arange(BITS) + 0.5) * (image.shape[1] // BITS)).astype(int)
    low = sum(int(v > (LIGHT + DARK) / 2) << b for b, v in enumerate(image[ROWS // 2, middles, 1]))
    newest = int(now / PERIOD)
    return newest - (newest - low) % (1 << BITS)


def watch(camera: Camera, seconds: float) -> tuple[list[float], int, int]:
    """Return the latency (ms) of each frame, and the numbers of lost and undetected frames."""
    ages: list[float] = []
    lost, blind, last = 0, 0, -1
    with TrackingThread(camera, ColourMarkers(RigDescription().markers), WallClock()) as thread:
        begin, frame = time.monotonic() + 2.0, None
        while time.monotonic() < begin + seconds:
            newest = thread.latest()
            if newest is frame or newest is None or newest.image is None:
                time.sleep(0.0005)
                continue
            frame = newest
            number = _number(frame.image, frame.arrival)  # arrival: when the features were ready
            if time.monotonic() >= begin:
                ages.append((frame.arrival - number * PERIOD) * 1e-6)
                lost += max(number - last - 1, 0) if last >= 0 else 0
                blind += not np.isfinite(thread.find(frame).points).all()
                last = number
    return ages, lost, blind


def main(seconds: float) -> int:
    print(f"{platform.platform()}, Python {platform.python_version()}")
    context = get_context("spawn")
    ring = FrameRing(context, 640, 480)
    with ExitStack() as stack:

        def child(work: Callable[..., None], *arguments: object) -> str:
            one = ChildProcess(context, work, *arguments)
            stack.callback(one.end)
            return one.receive()

        child(publish, ring)
        web, gige = child(send_mjpeg, ring, 0), child(send_gige, ring)
        transports: dict[str, Callable[[], Camera]] = {
            "shared memory": partial(RingCamera, ring),
            "Motion JPEG": partial(open_opencv_camera, OpencvSettings(web)),
            "GigE Vision": partial(open_aravis_camera, AravisSettings(gige, frame_rate=RATE)),
        }
        results = {way: ([], 0, 0) for way in transports}
        for _ in range(ROUNDS):
            for way, opened in transports.items():
                camera = opened()
                seen = watch(camera, seconds)
                results[way] = tuple(a + b for a, b in zip(results[way], seen, strict=True))
                getattr(camera, "close", lambda: None)()
    return _report(results)


def _report(results: dict[str, tuple[list[float], int, int]]) -> int:
    failed, least = False, 0.0
    for way, (ages, lost, blind) in results.items():
        p50, p99 = np.percentile(ages, [50, 99])
        least = least or p99
        lost_fraction = lost / (lost + len(ages))
        passed = p99 - least <= PERIOD * 1e-6 and lost_fraction <= MAX_LOST_FRACTION and not blind
        failed |= not passed
        print(
            f"{way:14} {p50:5.1f} ms (median) {p99:5.1f} (99 %) {max(ages):5.1f} (worst), "
            f"{lost} of {lost + len(ages)} lost, {blind} without markers",
            "" if passed else "FAILED",
        )
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]) if len(sys.argv) > 1 else 20.0))
