"""Times of the controller's samples, independent of delays of the replies."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import make_random, seeds
from rcmservo.hardware.galil.sample_clock import COUNTER_MODULUS, SAMPLE_TIME_PER_TM_S, SampleClock

PERIOD = 1000 * SAMPLE_TIME_PER_TM_S


class SimulatedController:
    """Controller whose clock runs too fast by a relative `drift`, at the end of a slow network."""

    def __init__(self, drift: float = 0.0, first: int = 0, start: float = 1000.0) -> None:
        self.clock, self.period = SampleClock(PERIOD), PERIOD / (1.0 + drift)
        self.first, self.start, self.now = first, start, start

    def exchange(self, request_delay: float, reply_delay: float) -> tuple[float, float]:
        """Return error and age (s) of the time of a record, with the delays (s) of two messages."""
        requested, sampled = self.now, self.now + request_delay
        count = int((sampled - self.start) / self.period)
        self.now = sampled + reply_delay
        estimate = self.clock.time_of((self.first + count) % COUNTER_MODULUS, requested, self.now)
        return estimate - (self.start + count * self.period), self.now - estimate


def test_a_sample_of_TM_1000_is_976_us() -> None:
    assert pytest.approx(1.0 / 1024.0) == PERIOD


@given(seeds, st.floats(-100e-6, 100e-6), st.integers(0, COUNTER_MODULUS - 1), st.floats(0.0, 1e6))
def test_a_delayed_reply_does_not_shift_the_time_of_its_joints(
    seed: int, drift: float, first: int, start: float
) -> None:
    """One message in ten takes up to 0.3 s longer, and some exchanges pause for a second."""
    random, controller = make_random(seed), SimulatedController(drift, first, start)
    for _ in range(20):
        controller.now += 0.01
        controller.exchange(*random.uniform(1e-4, 4e-4, 2))
    for _ in range(400):
        controller.now += 0.01 + (random.random() < 0.01)
        delays = random.uniform(1e-4, 4e-4, 2)
        delays += random.uniform(0.0, 0.3, 2) * (random.random(2) < 0.1)
        error, age = controller.exchange(*delays)
        assert abs(error) < 3e-3
        assert age >= 0.0


@given(st.floats(-100e-6, 100e-6), st.floats(0.5, 20.0))
def test_the_error_grows_slowly_while_all_replies_are_slow(drift: float, stall: float) -> None:
    controller = SimulatedController(drift)
    for _ in range(20):
        controller.now += 0.01
        controller.exchange(2e-4, 2e-4)
    for _ in range(round(stall / 0.1)):
        error, _ = controller.exchange(0.0, 0.1)
        assert abs(error) < 1e-3 + 400e-6 * stall


def test_the_clock_counts_the_wraps_of_the_counter_in_long_pauses() -> None:
    controller = SimulatedController(50e-6, COUNTER_MODULUS - 100)
    for pause in (0.01, 0.01, 1.0, 29.0, 100.0, 640.0, 0.01, 0.01):
        controller.now += pause
        error, age = controller.exchange(2e-4, 2e-4)
        assert abs(error) < 2e-3 and age >= 0.0


def test_a_delayed_reply_at_the_wrap_of_the_counter_gives_a_correct_time() -> None:
    controller = SimulatedController(0.0, COUNTER_MODULUS - 100)
    for _ in range(9):
        controller.now += 0.01
        controller.exchange(2e-4, 2e-4)
    for _ in range(3):
        error, age = controller.exchange(2e-4, 0.4)
        assert abs(error) < 2e-3 and age >= 0.4


def test_a_restarted_counter_is_accepted_at_once() -> None:
    controller = SimulatedController()
    for _ in range(50):
        controller.now += 0.01
        controller.exchange(2e-4, 2e-4)
    controller.start, controller.first = controller.now + 0.3, 0
    controller.now += 0.5
    error, age = controller.exchange(2e-4, 2e-4)
    assert abs(error) < 2e-3 and age >= 0.0


def test_the_middle_of_request_and_reply_would_be_wrong_by_half_the_delay() -> None:
    """The error of the tests above without the sample counter."""
    controller = SimulatedController()
    for _ in range(20):
        controller.now += 0.01
        controller.exchange(2e-4, 2e-4)
    requested = controller.now
    error, _ = controller.exchange(2e-4, 0.2)
    assert abs(error) < 1e-3 and np.mean([requested, controller.now]) - requested > 0.09
