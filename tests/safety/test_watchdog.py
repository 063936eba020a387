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


def make_command(number, deadline, rates, enabled=True):
    return Command(number, deadline - 20 * MS, deadline, np.array(rates, dtype=float), enabled)


def generate_arrivals(stream, start=0):
    now = start
    for wait_ns, number, remaining_ns, requested, enabled in stream:
        now += wait_ns
        yield now, make_command(number, now + remaining_ns, requested, enabled)


@given(arrivals)
def test_the_drive_is_on_exactly_while_valid_commands_arrive_in_time(stream):
    watchdog = Watchdog()
    watchdog.enable(0)
    is_on, last_deadline, number, requested = True, WATCHDOG_TIMEOUT_NS, -1, np.zeros(3)
    for now, received in generate_arrivals(stream):
        is_on = is_on and now <= last_deadline
        valid = received.number > number and 0 <= received.deadline - now <= WATCHDOG_TIMEOUT_NS
        valid = valid and received.rates.shape == (3,) and bool(np.isfinite(received.rates).all())
        assert watchdog.feed(received, now) == (not received.enabled or (is_on and valid))
        is_on = is_on and received.enabled
        if is_on and valid:
            last_deadline, number, requested = received.deadline, received.number, received.rates
        assert watchdog.check(now) == is_on
        assert np.array_equal(watchdog.rates, requested if is_on else np.zeros(3))
    assert not watchdog.check(max(last_deadline, now if stream else 0) + 1)


@given(back=st.integers(1, 10_000 * MS), remaining_ns=st.integers(0, WATCHDOG_TIMEOUT_NS))
def test_a_clock_that_goes_back_switches_the_drive_off(back, remaining_ns):
    watchdog, now = Watchdog(), 20_000 * MS
    watchdog.enable(now)
    assert watchdog.feed(make_command(1, now + remaining_ns, [0.1, 0.0, 1.0]), now)
    assert watchdog.check(now) and watchdog.rates.any()
    assert not watchdog.check(now - back) and not watchdog.rates.any()
    assert not watchdog.feed(
        make_command(2, now - back + remaining_ns, [0.1, 0.0, 1.0]), now - back
    )


@given(arrivals)
def test_no_command_switches_the_drive_on(stream):
    watchdog = Watchdog()
    for now, received in generate_arrivals(stream):
        watchdog.feed(received, now)
        assert not watchdog.enabled and not watchdog.rates.any()


@given(arrivals)
def test_the_drive_stays_off_until_the_operator_enables_it(stream):
    watchdog = Watchdog()
    watchdog.enable(0)
    assert not watchdog.check(WATCHDOG_TIMEOUT_NS + 1)
    for now, received in generate_arrivals(stream, WATCHDOG_TIMEOUT_NS + 1):
        watchdog.feed(received, now)
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
        assert watchdog.feed(make_command(1000 + k, now + WATCHDOG_TIMEOUT_NS, [0.1, 0.2, k]), now)
        for _, number, remaining_ns, requested, _ in noise:
            watchdog.feed(make_command(number, now + remaining_ns, requested), now + 1)
        assert watchdog.check(now + 1) and watchdog.rates[2] == k
    last = 20 * 10 * MS + WATCHDOG_TIMEOUT_NS
    late_arrivals = sorted(
        ((last - wait_ns % WATCHDOG_TIMEOUT_NS, *rest) for wait_ns, *rest in noise),
        key=itemgetter(0),
    )
    for now, number, remaining_ns, requested, _ in late_arrivals:
        watchdog.feed(make_command(number, last + remaining_ns, requested), now)
    assert watchdog.check(last) and not watchdog.check(last + 1)


@given(st.lists(rate, min_size=3, max_size=3), st.integers(0, WATCHDOG_TIMEOUT_NS))
def test_a_repeated_command_is_rejected(requested, wait_ns):
    watchdog = Watchdog()
    watchdog.enable(0)
    received = make_command(5, WATCHDOG_TIMEOUT_NS, requested)
    assert watchdog.feed(received, 1)
    assert not watchdog.feed(received, wait_ns)
    assert not watchdog.feed(make_command(4, WATCHDOG_TIMEOUT_NS, requested), wait_ns)


def test_a_deadline_beyond_the_timeout_is_rejected():
    watchdog = Watchdog()
    watchdog.enable(0)
    assert not watchdog.feed(make_command(1, 2 * WATCHDOG_TIMEOUT_NS, [0.0, 0.0, 0.0]), 1)
    assert not watchdog.check(WATCHDOG_TIMEOUT_NS + 1)


def test_a_change_of_an_accepted_command_has_no_effect():
    watchdog = Watchdog()
    watchdog.enable(0)
    received = make_command(1, WATCHDOG_TIMEOUT_NS, [0.1, 0.2, 0.3])
    watchdog.feed(received, 1)
    received.rates[:] = math.nan
    assert watchdog.rates.tolist() == [0.1, 0.2, 0.3]


@pytest.mark.parametrize("timeout", [0, -1])
def test_a_timeout_that_is_not_positive_is_refused(timeout):
    with pytest.raises(BadInput):
        Watchdog(timeout)
