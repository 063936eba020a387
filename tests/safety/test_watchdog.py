"""The device's watchdog: only valid commands that keep coming hold the drive on, whatever else
arrives.
"""

import math
from operator import itemgetter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcmservo.errors import BadInput
from rcmservo.interfaces import Command
from rcmservo.safety.watchdog import PATIENCE, Watchdog

MS = 1_000_000

spoilt = st.sampled_from([math.nan, math.inf, -math.inf])
rate = st.floats(-2.0, 2.0)
rates = st.one_of(
    st.lists(rate, min_size=3, max_size=3),
    st.lists(st.one_of(rate, spoilt), min_size=3, max_size=3),
    st.lists(rate, max_size=5),
)
arrivals = st.lists(
    st.tuples(
        st.integers(0, 80 * MS),  # time since the one before
        st.integers(-2, 60),  # its number
        st.integers(-60 * MS, 120 * MS),  # its deadline, from its arrival
        rates,
        st.sampled_from([True] * 9 + [False]),
    ),
    max_size=40,
)


def command(number, deadline, rates, enabled=True):
    return Command(number, deadline - 20 * MS, deadline, np.array(rates, dtype=float), enabled)


def arriving(stream, start=0):
    now = start
    for wait, number, ahead, asked, enabled in stream:
        now += wait
        yield now, command(number, now + ahead, asked, enabled)


@given(arrivals)
def test_the_drive_is_on_exactly_as_long_as_a_valid_command_came_in_time(stream):
    dog = Watchdog()
    dog.enable(0)
    on, until, number, asked = True, PATIENCE, -1, np.zeros(3)
    for now, sent in arriving(stream):
        on = on and now <= until
        valid = sent.number > number and 0 <= sent.deadline - now <= PATIENCE
        valid = valid and sent.rates.shape == (3,) and bool(np.isfinite(sent.rates).all())
        assert dog.feed(sent, now) == (not sent.enabled or (on and valid))
        on = on and sent.enabled
        if on and valid:
            until, number, asked = sent.deadline, sent.number, sent.rates
        assert dog.check(now) == on
        assert np.array_equal(dog.rates, asked if on else np.zeros(3))
    assert not dog.check(max(until, now if stream else 0) + 1)


@given(back=st.integers(1, 10_000 * MS), ahead=st.integers(0, PATIENCE))
def test_a_clock_that_goes_back_switches_the_drive_off_whatever_was_commanded(back, ahead):
    dog, now = Watchdog(), 20_000 * MS
    dog.enable(now)
    assert dog.feed(command(1, now + ahead, [0.1, 0.0, 1.0]), now)
    assert dog.check(now) and dog.rates.any()
    assert not dog.check(now - back) and not dog.rates.any()
    assert not dog.feed(command(2, now - back + ahead, [0.1, 0.0, 1.0]), now - back)


@given(arrivals)
def test_nothing_that_arrives_switches_the_drive_on(stream):
    dog = Watchdog()
    for now, sent in arriving(stream):
        dog.feed(sent, now)
        assert not dog.enabled and not dog.rates.any()


@given(arrivals)
def test_once_off_it_stays_off_until_a_person_enables_it(stream):
    dog = Watchdog()
    dog.enable(0)
    assert not dog.check(PATIENCE + 1)
    for now, sent in arriving(stream, PATIENCE + 1):
        dog.feed(sent, now)
        assert not dog.check(now) and not dog.rates.any()
    dog.enable(now := PATIENCE * 100)
    assert dog.check(now) and not dog.rates.any()


@given(arrivals)
def test_noise_between_valid_commands_neither_feeds_nor_starves_it(stream):
    noise = [entry for entry in stream if entry[4]]
    dog = Watchdog()
    dog.enable(0)
    for k in range(20):
        now = (k + 1) * 10 * MS
        assert dog.feed(command(1000 + k, now + PATIENCE, [0.1, 0.2, k]), now)
        for _, number, ahead, asked, _ in noise:
            dog.feed(command(number, now + ahead, asked), now + 1)
        assert dog.check(now + 1) and dog.rates[2] == k
    last = 20 * 10 * MS + PATIENCE
    later = sorted(((last - wait % PATIENCE, *rest) for wait, *rest in noise), key=itemgetter(0))
    for now, number, ahead, asked, _ in later:
        dog.feed(command(number, last + ahead, asked), now)
    assert dog.check(last) and not dog.check(last + 1)


@given(st.lists(rate, min_size=3, max_size=3), st.integers(0, PATIENCE))
def test_a_command_sent_again_is_no_command(asked, wait):
    dog = Watchdog()
    dog.enable(0)
    sent = command(5, PATIENCE, asked)
    assert dog.feed(sent, 1)
    assert not dog.feed(sent, wait)
    assert not dog.feed(command(4, PATIENCE, asked), wait)


def test_no_sender_can_ask_for_more_patience_than_the_device_has():
    dog = Watchdog()
    dog.enable(0)
    assert not dog.feed(command(1, 2 * PATIENCE, [0.0, 0.0, 0.0]), 1)
    assert not dog.check(PATIENCE + 1)


def test_what_it_was_fed_cannot_be_changed_afterwards():
    dog = Watchdog()
    dog.enable(0)
    sent = command(1, PATIENCE, [0.1, 0.2, 0.3])
    dog.feed(sent, 1)
    sent.rates[:] = math.nan
    assert dog.rates.tolist() == [0.1, 0.2, 0.3]


@pytest.mark.parametrize("patience", [0, -1])
def test_a_watchdog_without_patience_is_refused(patience):
    with pytest.raises(BadInput):
        Watchdog(patience)
