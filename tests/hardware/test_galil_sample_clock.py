"""Joints are timed by the controller's samples, whatever became of the answer on its way."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import random_from, seeds
from rcmservo.hardware.galil.sample_clock import COUNTS, MICROSECONDS, SampleClock

PERIOD = 1000 * MICROSECONDS


class World:
    """A controller whose clock runs by `drift` too fast, and a way there and back."""

    def __init__(self, drift: float = 0.0, first: int = 0, start: float = 1000.0) -> None:
        self.clock, self.period = SampleClock(PERIOD), PERIOD / (1.0 + drift)
        self.first, self.start, self.now = first, start, start

    def exchange(self, there: float, back: float) -> tuple[float, float]:
        """How far off the time of a record is, s, and how far from the present."""
        asked, at = self.now, self.now + there
        count = int((at - self.start) / self.period)
        self.now = at + back
        told = self.clock.time_of((self.first + count) % COUNTS, asked, self.now)
        return told - (self.start + count * self.period), self.now - told


def test_a_sample_of_TM_1000_is_976_us() -> None:
    assert pytest.approx(1.0 / 1024.0) == PERIOD


@given(seeds, st.floats(-100e-6, 100e-6), st.integers(0, COUNTS - 1), st.floats(0.0, 1e6))
def test_an_answer_that_is_held_up_gives_no_wrong_time_to_its_joints(
    seed: int, drift: float, first: int, start: float
) -> None:
    """One in ten ways takes up to 0.3 s longer, and now and then nothing comes for a second."""
    random, world = random_from(seed), World(drift, first, start)
    for _ in range(20):
        world.now += 0.01
        world.exchange(*random.uniform(1e-4, 4e-4, 2))
    for _ in range(400):
        world.now += 0.01 + (random.random() < 0.01)
        ways = random.uniform(1e-4, 4e-4, 2)
        ways += random.uniform(0.0, 0.3, 2) * (random.random(2) < 0.1)
        wrong, ago = world.exchange(*ways)
        assert abs(wrong) < 3e-3
        assert ago >= 0.0


@given(st.floats(-100e-6, 100e-6), st.floats(0.5, 20.0))
def test_where_nothing_quick_comes_for_long_it_grows_wrong_slowly(
    drift: float, stall: float
) -> None:
    world = World(drift)
    for _ in range(20):
        world.now += 0.01
        world.exchange(2e-4, 2e-4)
    for _ in range(round(stall / 0.1)):
        wrong, _ = world.exchange(0.0, 0.1)
        assert abs(wrong) < 1e-3 + 400e-6 * stall


def test_the_counter_wraps_each_minute_and_a_long_silence_is_counted_by_the_clock() -> None:
    world = World(50e-6, COUNTS - 100)
    for pause in (0.01, 0.01, 1.0, 29.0, 100.0, 640.0, 0.01, 0.01):
        world.now += pause
        wrong, ago = world.exchange(2e-4, 2e-4)
        assert abs(wrong) < 2e-3 and ago >= 0.0


def test_an_answer_that_is_held_up_just_as_the_counter_wraps_gives_no_wrong_time() -> None:
    world = World(0.0, COUNTS - 100)
    for _ in range(9):
        world.now += 0.01
        world.exchange(2e-4, 2e-4)
    for _ in range(3):
        wrong, ago = world.exchange(2e-4, 0.4)
        assert abs(wrong) < 2e-3 and ago >= 0.4


def test_a_counter_that_begins_anew_is_believed_at_once() -> None:
    world = World()
    for _ in range(50):
        world.now += 0.01
        world.exchange(2e-4, 2e-4)
    world.start, world.first = world.now + 0.3, 0
    world.now += 0.5
    wrong, ago = world.exchange(2e-4, 2e-4)
    assert abs(wrong) < 2e-3 and ago >= 0.0


def test_asking_alone_would_have_been_wrong_by_half_of_what_it_took() -> None:
    """What the test above would see without the samples."""
    world = World()
    for _ in range(20):
        world.now += 0.01
        world.exchange(2e-4, 2e-4)
    asked = world.now
    wrong, _ = world.exchange(2e-4, 0.2)
    assert abs(wrong) < 1e-3 and np.mean([asked, world.now]) - asked > 0.09
