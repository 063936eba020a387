"""Camera stamps on the computer's clock: errors stay within the reported uncertainty."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import make_random, seeds
from rcmservo.hardware.cameras.clock_map import ClockMap

DAYS = 86400 * 10**9
DELAY = 5_000_000
PERIOD = 1e9 / 60

delays = st.sampled_from(["steady", "exponential", "uniform", "long tail"])


def jitter(random: np.random.Generator, kind: str, count: int) -> np.ndarray:
    """Return the delays (ns) of frames relative to the smallest possible delay."""
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
    """Stamps and arrivals of a camera's frames, and the arrivals without jitter."""

    def __init__(self, seed: int, kind: str, count: int = 1500) -> None:
        random = make_random(seed)
        self.offset = int(random.integers(-20, 20)) * DAYS + int(random.integers(10**9))
        self.drift = random.uniform(-100e-6, 100e-6)
        taken = np.arange(count) * PERIOD + random.uniform(0.0, 1e9)
        self.stamps = [round(t) for t in taken]
        self.least = [round(t * (1.0 + self.drift)) + DELAY + self.offset for t in taken]
        late = jitter(random, kind, count)
        self.arrivals = [least + round(by) for least, by in zip(self.least, late, strict=True)]

    def errors(self, clock: ClockMap) -> list[tuple[float, float]]:
        """Return error and reported uncertainty (s) for every frame."""
        frames = zip(self.stamps, self.arrivals, self.least, strict=True)
        return [
            (1e-9 * (clock.undelayed_arrival(s, a) - least), clock.uncertainty)
            for s, a, least in frames
        ]


@given(seeds, delays)
def test_the_error_stays_below_the_uncertainty(seed: int, kind: str) -> None:
    for error, uncertainty in Device(seed, kind).errors(ClockMap()):
        assert abs(error) <= uncertainty


@given(seeds, delays, st.data())
def test_a_jump_of_the_clock_restarts_the_estimate(
    seed: int, kind: str, data: st.DataObject
) -> None:
    """Back by more than a frame period, or forward by more than the largest delay."""
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
def test_lost_frames_do_not_increase_the_error_beyond_the_uncertainty(seed: int) -> None:
    device = Device(seed, "exponential")
    received = sorted(set(make_random(seed).integers(0, 1500, 400).tolist()))
    for name in ("stamps", "arrivals", "least"):
        setattr(device, name, [getattr(device, name)[i] for i in received])
    for error, uncertainty in device.errors(ClockMap()):
        assert abs(error) <= uncertainty


def test_the_first_frame_counts_as_undelayed_with_a_large_uncertainty() -> None:
    clock = ClockMap()
    assert clock.undelayed_arrival(7, 10**12) == 10**12
    assert clock.uncertainty == pytest.approx(0.2)


def test_no_time_is_later_than_the_arrival() -> None:
    device, clock = Device(3, "uniform"), ClockMap()
    for stamp, arrival in zip(device.stamps, device.arrivals, strict=True):
        assert clock.undelayed_arrival(stamp, arrival) <= arrival


def test_a_repeated_stamp_returns_the_same_time() -> None:
    clock = ClockMap()
    first = clock.undelayed_arrival(1_000_000_000, 5_000_000_000)
    assert clock.undelayed_arrival(1_000_000_000, 8_000_000_000) == first
    clock.undelayed_arrival(1_016_000_000, 5_016_000_000)
    assert clock.uncertainty < 0.11
