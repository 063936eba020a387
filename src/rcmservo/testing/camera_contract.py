"""Contract of a camera: its frames, their numbers and times, and the memory of their images."""

from itertools import pairwise

import numpy as np

from rcmservo.interfaces import Camera, Clock, Floats, Frame, Image
from rcmservo.loop.clock import ticks
from rcmservo.loop.plant import MAX_FRAME_AGE_NS, get_image_shape
from rcmservo.testing.clock_contract import check_clock
from rcmservo.testing.violations import WatchedPart, describe_time_defect

TRIAL_FRAMES = 8
"""Number of frames with which a camera is checked."""

FRAME_TIMEOUT_S = 5.0
"""Time in s within which they must arrive."""

POLL_RATE_HZ = 200.0
"""Rate at which the check reads the newest frame, in Hz."""

Content = tuple[Image | None, Floats | None]
"""Copies of the image and of the markers of a frame."""


def check_camera(camera: Camera, clock: Clock) -> None:
    """Check a camera against its contract with its next 8 frames.

    Parameters
    ----------
    camera : Camera
        Camera that delivers frames by itself, or as the time of `clock` passes.
    clock : Clock
        Clock of the plant that the camera will be used with.

    Raises
    ------
    ContractViolation
        With the first violation in one sentence: too few frames in 5 s, a blocking `latest`, a new
        object for the same frame, numbers or exposures that do not rise, times that are missing or
        not on the clock, images of another form, or an image that is overwritten later.

    Notes
    -----
    Calls are timed with `clock`. A camera in simulated time may thus render as long as it needs.
    """
    check_clock(clock)
    part = WatchedPart(camera, clock)
    frames: list[Frame] = []
    contents: list[Content] = []
    repeated: list[bool] = []
    for _ in ticks(clock, POLL_RATE_HZ, FRAME_TIMEOUT_S):
        for _ in range(2):
            frame = _read_frame(part)
            if frame is None:
                continue
            is_same = bool(frames) and frame is frames[-1]
            repeated.append(is_same)
            if not is_same:
                _check_frame(part, frame, clock)
                frames.append(frame)
                contents.append(_copy_content(frame))
        if len(frames) >= TRIAL_FRAMES and len(repeated) >= 2 * TRIAL_FRAMES:
            break
    part.require(len(frames) > 0, "latest", "returned None for 5 s, expected a frame")
    part.require_short("latest")
    _check_sequence(part, frames, repeated)
    for frame, content in zip(frames, contents, strict=True):
        is_unchanged = _have_same_content(_copy_content(frame), content)
        finding = "overwrote the image of an earlier frame, expected a new array for each frame"
        part.require(is_unchanged, "latest", finding)


def _read_frame(part: WatchedPart) -> Frame | None:
    """Return the newest frame, of the type that the contract states; None before the first."""
    frame: Frame | None = part.call("latest")
    if frame is not None:
        part.require_type("latest", frame)
    return frame


def _check_frame(part: WatchedPart, frame: Frame, clock: Clock) -> None:
    """Check the times and the content of one frame."""
    arrival_defect = describe_time_defect(frame.arrival, clock.now(), MAX_FRAME_AGE_NS)
    part.require(not arrival_defect, "latest", f"returned the arrival {arrival_defect}")
    finding = f"returned a frame without exposure time: exposure = {frame.exposure}"
    is_set = frame.exposure != 0 or frame.arrival <= MAX_FRAME_AGE_NS
    part.require(is_set, "latest", f"{finding}, arrival = {frame.arrival} ns")
    delay_ns = frame.arrival - frame.exposure
    finding = f"returned a frame that was exposed {-delay_ns * 1e-6:g} ms after its arrival"
    part.require(delay_ns >= 0, "latest", finding)
    exposure_defect = describe_time_defect(frame.exposure, clock.now(), 2 * MAX_FRAME_AGE_NS)
    part.require(not exposure_defect, "latest", f"returned the exposure {exposure_defect}")
    _check_content(part, frame)


def _check_content(part: WatchedPart, frame: Frame) -> None:
    image, points = frame.image, frame.points
    finding = "returned a frame with neither image nor points"
    part.require(image is not None or points is not None, "latest", finding)
    if image is not None:
        shape, dtype = getattr(image, "shape", ()), getattr(image, "dtype", type(image).__name__)
        is_valid = len(shape) == 3 and shape[2] == 3 and dtype == np.uint8
        finding = f"returned an image of shape {shape} and type {dtype}"
        part.require(is_valid, "latest", f"{finding}, expected (height, width, 3) of uint8")
    if points is not None:
        is_valid = np.shape(points) == (2, 2) and np.asarray(points).dtype == np.float64
        finding = f"returned points of shape {np.shape(points)}, expected (2, 2) of float64"
        part.require(is_valid, "latest", finding)


def _check_sequence(part: WatchedPart, frames: list[Frame], repeated: list[bool]) -> None:
    """Check that each frame is one object, and that numbers and exposures rise."""
    finding = "returned a new Frame at every call, expected the same object until the next frame"
    part.require(any(repeated), "latest", finding)
    for before, after in pairwise(frames):
        pair = f"frames {before.number} and {after.number}"
        is_same = after.number == before.number and after.exposure == before.exposure
        finding = f"returned two objects for frame {after.number}, expected the same object again"
        part.require(not is_same, "latest", finding)
        finding = f"returned {pair} in this order, expected numbers that rise"
        part.require(after.number > before.number, "latest", finding)
        finding = f"returned the exposure {after.exposure} ns for {pair}, expected that of each"
        part.require(after.exposure != before.exposure, "latest", finding)
        finding = f"returned {pair} with exposures that go back"
        part.require(after.exposure > before.exposure, "latest", finding)
        finding = f"returned {pair} with images of different shapes"
        is_alike = get_image_shape(before) == get_image_shape(after)
        part.require(is_alike, "latest", finding)
    finding = f"returned {len(frames)} frames in 5 s, expected {TRIAL_FRAMES}"
    part.require(len(frames) >= TRIAL_FRAMES, "latest", finding)


def _copy_content(frame: Frame) -> Content:
    return (
        None if frame.image is None else frame.image.copy(),
        None if frame.points is None else frame.points.copy(),
    )


def _have_same_content(a: Content, b: Content) -> bool:
    arrays = [(x, y) for x, y in zip(a, b, strict=True) if x is not None and y is not None]
    return all(x.tobytes() == y.tobytes() for x, y in arrays)
