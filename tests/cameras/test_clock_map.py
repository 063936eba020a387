"""A camera's own times on the computer's clock: what is told of them is true, to within the
uncertainty that is told with it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import random_from, seeds
from rcmservo.hardware.cameras.clock_map import ClockMap

DAYS = 86400 * 10**9
DELAY = 5_000_000
PERIOD = 1e9 / 60

delays = st.sampled_from(["steady", "exponential", "uniform", "long tail"])


def jitter(random: np.random.Generator, kind: str, count: int) -> np.ndarray:
    """ns by which frames are later than the least delayed."""
    least = 20e3 * random.random(count)
    match kind:
        case "exponential":
            return least + random.exponential(1e6, count)
        case "uniform":
            return random.uniform(0.0, 60e6, count)
        case "long tail":
            return least + 3e5 * random.pareto(1.2, count).clip(max=1e3)
        case _:
            return least


class Device:
    """A camera with a clock: stamps and arrivals of its frames, and the arrivals without jitter."""

    def __init__(self, seed: int, kind: str, count: int = 1500) -> None:
        random = random_from(seed)
        self.offset = int(random.integers(-20, 20)) * DAYS + int(random.integers(10**9))
        self.drift = random.uniform(-100e-6, 100e-6)
        taken = np.arange(count) * PERIOD + random.uniform(0.0, 1e9)
        self.stamps = [round(t) for t in taken]
        self.least = [round(t * (1.0 + self.drift)) + DELAY + self.offset for t in taken]
        late = jitter(random, kind, count)
        self.arrivals = [least + round(by) for least, by in zip(self.least, late, strict=True)]

    def errors(self, clock: ClockMap) -> list[tuple[float, float]]:
        """s, of every answer: how far off it is, and how far it says it may be."""
        frames = zip(self.stamps, self.arrivals, self.least, strict=True)
        return [(1e-9 * (clock.take(s, a) - least), clock.uncertainty) for s, a, least in frames]


@given(seeds, delays)
def test_the_error_stays_below_the_uncertainty(seed: int, kind: str) -> None:
    for error, uncertainty in Device(seed, kind).errors(ClockMap()):
        assert abs(error) <= uncertainty


@given(seeds, delays, st.data())
def test_a_clock_that_jumps_begins_anew(seed: int, kind: str, data: st.DataObject) -> None:
    """Back by more than a frame, or forth by more than frames are late."""
    device = Device(seed, kind)
    at = data.draw(st.integers(300, 1200))
    by = data.draw(st.sampled_from([-DAYS, -5 * 10**9, -20_000_000, 500_000_000, DAYS]))
    device.stamps[at:] = [stamp + by for stamp in device.stamps[at:]]
    answers = device.errors(ClockMap())
    for error, uncertainty in answers:
        assert abs(error) <= uncertainty
    assert answers[-1][1] < 0.1


@given(seeds)
def test_after_ten_seconds_the_uncertainty_is_far_below_the_jitter(seed: int) -> None:
    last = Device(seed, "exponential").errors(ClockMap())[600:]
    assert max(uncertainty for _, uncertainty in last) < 1e-3
    assert math.sqrt(np.mean([error**2 for error, _ in last])) < 1e-4


@given(seeds)
def test_frames_that_were_lost_change_nothing(seed: int) -> None:
    device = Device(seed, "exponential")
    kept = sorted(set(random_from(seed).integers(0, 1500, 400).tolist()))
    for name in ("stamps", "arrivals", "least"):
        setattr(device, name, [getattr(device, name)[i] for i in kept])
    for error, uncertainty in device.errors(ClockMap()):
        assert abs(error) <= uncertainty


def test_the_first_frame_is_taken_to_be_punctual_and_told_to_be_uncertain() -> None:
    clock = ClockMap()
    assert clock.take(7, 10**12) == 10**12
    assert clock.uncertainty == pytest.approx(0.2)


def test_no_time_is_later_than_the_arrival() -> None:
    device, clock = Device(3, "uniform"), ClockMap()
    for stamp, arrival in zip(device.stamps, device.arrivals, strict=True):
        assert clock.take(stamp, arrival) <= arrival


def test_a_frame_that_comes_again_is_as_old_as_it_was() -> None:
    clock = ClockMap()
    told = clock.take(1_000_000_000, 5_000_000_000)
    assert clock.take(1_000_000_000, 8_000_000_000) == told
    clock.take(1_016_000_000, 5_016_000_000)
    assert clock.uncertainty < 0.11
