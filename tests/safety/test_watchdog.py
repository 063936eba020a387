"""Watchdog of a device: only a steady stream of valid commands keeps the drive on."""

import math
from operator import itemgetter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcmservo.errors import BadInput
from rcmservo.interfaces import Command
from rcmservo.safety.watchdog import WATCHDOG_TIMEOUT_NS, Watchdog

MS = 1_000_000

not_finite = st.sampled_from([math.nan, math.inf, -math.inf])
rate = st.floats(-2.0, 2.0)
rates = st.one_of(
    st.lists(rate, min_size=3, max_size=3),
    st.lists(st.one_of(rate, not_finite), min_size=3, max_size=3),
    st.lists(rate, max_size=5),
)
arrivals = st.lists(
    st.tuples(
        st.integers(0, 80 * MS),  # time since the command before
        st.integers(-2, 60),  # number of the command
        st.integers(-60 * MS, 120 * MS),  # deadline, relative to its arrival
        rates,
        st.sampled_from([True] * 9 + [False]),
    ),
    max_size=40,
)


def command(number, deadline, rates, enabled=True):
    return Command(number, deadline - 20 * MS, deadline, np.array(rates, dtype=float), enabled)


def arriving(stream, start=0):
    now = start
    for wait, number, ahead, requested, enabled in stream:
        now += wait
        yield now, command(number, now + ahead, requested, enabled)


@given(arrivals)
def test_the_drive_is_on_exactly_while_valid_commands_arrive_in_time(stream):
    watchdog = Watchdog()
    watchdog.enable(0)
    on, until, number, requested = True, WATCHDOG_TIMEOUT_NS, -1, np.zeros(3)
    for now, sent in arriving(stream):
        on = on and now <= until
        valid = sent.number > number and 0 <= sent.deadline - now <= WATCHDOG_TIMEOUT_NS
        valid = valid and sent.rates.shape == (3,) and bool(np.isfinite(sent.rates).all())
        assert watchdog.feed(sent, now) == (not sent.enabled or (on and valid))
        on = on and sent.enabled
        if on and valid:
            until, number, requested = sent.deadline, sent.number, sent.rates
        assert watchdog.check(now) == on
        assert np.array_equal(watchdog.rates, requested if on else np.zeros(3))
    assert not watchdog.check(max(until, now if stream else 0) + 1)


@given(back=st.integers(1, 10_000 * MS), ahead=st.integers(0, WATCHDOG_TIMEOUT_NS))
def test_a_clock_that_goes_back_switches_the_drive_off(back, ahead):
    watchdog, now = Watchdog(), 20_000 * MS
    watchdog.enable(now)
    assert watchdog.feed(command(1, now + ahead, [0.1, 0.0, 1.0]), now)
    assert watchdog.check(now) and watchdog.rates.any()
    assert not watchdog.check(now - back) and not watchdog.rates.any()
    assert not watchdog.feed(command(2, now - back + ahead, [0.1, 0.0, 1.0]), now - back)


@given(arrivals)
def test_no_command_switches_the_drive_on(stream):
    watchdog = Watchdog()
    for now, sent in arriving(stream):
        watchdog.feed(sent, now)
        assert not watchdog.enabled and not watchdog.rates.any()


@given(arrivals)
def test_the_drive_stays_off_until_the_operator_enables_it(stream):
    watchdog = Watchdog()
    watchdog.enable(0)
    assert not watchdog.check(WATCHDOG_TIMEOUT_NS + 1)
    for now, sent in arriving(stream, WATCHDOG_TIMEOUT_NS + 1):
        watchdog.feed(sent, now)
        assert not watchdog.check(now) and not watchdog.rates.any()
    watchdog.enable(now := WATCHDOG_TIMEOUT_NS * 100)
    assert watchdog.check(now) and not watchdog.rates.any()


@given(arrivals)
def test_invalid_commands_neither_feed_nor_block_the_watchdog(stream):
    noise = [entry for entry in stream if entry[4]]
    watchdog = Watchdog()
    watchdog.enable(0)
    for k in range(20):
        now = (k + 1) * 10 * MS
        assert watchdog.feed(command(1000 + k, now + WATCHDOG_TIMEOUT_NS, [0.1, 0.2, k]), now)
        for _, number, ahead, requested, _ in noise:
            watchdog.feed(command(number, now + ahead, requested), now + 1)
        assert watchdog.check(now + 1) and watchdog.rates[2] == k
    last = 20 * 10 * MS + WATCHDOG_TIMEOUT_NS
    later = sorted(
        ((last - wait % WATCHDOG_TIMEOUT_NS, *rest) for wait, *rest in noise), key=itemgetter(0)
    )
    for now, number, ahead, requested, _ in later:
        watchdog.feed(command(number, last + ahead, requested), now)
    assert watchdog.check(last) and not watchdog.check(last + 1)


@given(st.lists(rate, min_size=3, max_size=3), st.integers(0, WATCHDOG_TIMEOUT_NS))
def test_a_repeated_command_is_rejected(requested, wait):
    watchdog = Watchdog()
    watchdog.enable(0)
    sent = command(5, WATCHDOG_TIMEOUT_NS, requested)
    assert watchdog.feed(sent, 1)
    assert not watchdog.feed(sent, wait)
    assert not watchdog.feed(command(4, WATCHDOG_TIMEOUT_NS, requested), wait)


def test_a_deadline_beyond_the_timeout_is_rejected():
    watchdog = Watchdog()
    watchdog.enable(0)
    assert not watchdog.feed(command(1, 2 * WATCHDOG_TIMEOUT_NS, [0.0, 0.0, 0.0]), 1)
    assert not watchdog.check(WATCHDOG_TIMEOUT_NS + 1)


def test_a_change_of_an_accepted_command_has_no_effect():
    watchdog = Watchdog()
    watchdog.enable(0)
    sent = command(1, WATCHDOG_TIMEOUT_NS, [0.1, 0.2, 0.3])
    watchdog.feed(sent, 1)
    sent.rates[:] = math.nan
    assert watchdog.rates.tolist() == [0.1, 0.2, 0.3]


@pytest.mark.parametrize("patience", [0, -1])
def test_a_timeout_that_is_not_positive_is_refused(patience):
    with pytest.raises(BadInput):
        Watchdog(patience)
