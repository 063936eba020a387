"""Safety gate: every command is finite and within the limits of speed, slew and joint range."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from conftest import make_random
from rcmservo.errors import BadInput
from rcmservo.geometry.kinematics import JointLimits, PitchYawRcm
from rcmservo.interfaces import Command
from rcmservo.safety.gate import Gate

GATE = Gate()
LIMITS = JointLimits((-1.0, -0.5, 40.0), (1.0, 0.8, 240.0))
RCM = PitchYawRcm(LIMITS).to_struct()
LOWER, UPPER, SPEED, SLEW = (
    np.array(x) for x in (LIMITS.lower, LIMITS.upper, GATE.speed, GATE.slew)
)
TICK_NS = 10_000_000

anything = st.floats(allow_nan=True, allow_infinity=True)
any_three = st.tuples(anything, anything, anything).map(np.array)
fractions = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array)
within_range = st.tuples(*[st.one_of(st.floats(0, 1), st.sampled_from([0.0, 1.0]))] * 3).map(
    np.array
)


def make_command(number, time, rates):
    return Command(number, time, time + 50_000_000, rates, True)


def make_last_command(last_rates, milliseconds=10):
    return make_command(7, 1_000_000_000 - milliseconds * 1_000_000, last_rates)


def admit(rates, last, q, gate=GATE, now=1_000_000_000):
    return gate.admit(rates, last, q, RCM, now)


@given(any_three, fractions, any_three, st.integers(-50, 5000))
@example(np.full(3, 1e308), np.zeros(3), np.array([0.0, 0.0, 100.0]), 10)
@example(np.full(3, 1.0), np.zeros(3), np.full(3, -1.7e308), 10)
@example(np.array([np.nan, 0.0, 0.0]), np.ones(3), np.array([0.0, 0.0, 100.0]), 10)
def test_any_input_gives_a_finite_command_within_speed_and_slew(rates, fraction, q, milliseconds):
    last = fraction * SPEED
    result = admit(rates, make_last_command(last, milliseconds), q)
    allowed = result.command.rates
    assert np.isfinite(allowed).all()
    assert np.all(np.abs(allowed) <= SPEED * (1 + 1e-12))
    assert result.command.number == 8 and result.command.time == 1_000_000_000
    if result.finite:
        dt = min(milliseconds * 1e-3, GATE.max_period)
        assert np.all(np.abs(allowed - last) <= SLEW * dt * (1 + 1e-9))


@given(any_three, any_three, fractions)
def test_input_that_is_not_finite_stops_at_once_and_is_reported(rates, q, fraction):
    result = admit(rates, make_last_command(fraction * SPEED), q)
    finite = np.isfinite(rates).all() and np.isfinite(q).all()
    assert result.finite == finite
    if not finite:
        assert not result.command.rates.any()


@pytest.mark.parametrize("milliseconds", [0, -10])
def test_a_tick_without_elapsed_time_gives_zero_rates(milliseconds):
    result = admit(
        np.ones(3), make_last_command(np.zeros(3), milliseconds), np.array([0.0, 0.0, 100.0])
    )
    assert not result.command.rates.any() and not result.finite


@given(any_three.filter(lambda x: np.isfinite(x).all()), within_range, st.floats(0, 1e6))
def test_at_or_beyond_a_limit_a_joint_at_rest_never_starts_outwards(rates, position, beyond):
    """At the ends of their ranges, or beyond, the joints move inwards or not at all."""
    q = (
        LOWER
        + position * (UPPER - LOWER)
        + np.where(position == 1.0, beyond, 0.0)
        - np.where(position == 0.0, beyond, 0.0)
    )
    allowed = admit(rates, make_last_command(np.zeros(3)), q).command.rates
    assert np.all(allowed[q >= UPPER] <= 0.0) and np.all(allowed[q <= LOWER] >= 0.0)


@given(fractions, fractions, st.sampled_from([-1.0, 1.0]))
def test_a_joint_still_moving_outwards_at_its_limit_brakes_as_hard_as_the_slew_allows(
    requested, fraction, side
):
    q = UPPER.copy() if side > 0 else LOWER.copy()
    last = side * np.abs(fraction) * SPEED
    allowed = admit(requested * SPEED, make_last_command(last), q).command.rates
    assert np.all(side * allowed <= np.maximum(np.abs(last) - SLEW * 0.01, 0.0) + 1e-12)


def follow_requests(seed, delay, ticks=300):
    """Return the joints and rates, (ticks, 3), of an arm that follows the gate `delay` ticks late.

    It starts at rest in a random pose. The requested rates are extreme for 0.6 s, then random.
    """
    random = make_random(seed)
    q, command = random.uniform(LOWER, UPPER), make_command(0, 0, np.zeros(3))
    delayed_rates, requested = [np.zeros(3)] * delay, random.choice([-1e9, 1e9], 3)
    path, commanded_rates = [], []
    for k in range(1, ticks + 1):
        if k % 60 == 0:
            requested = random.uniform(-2, 2, 3) * SPEED
        command = GATE.admit(requested, command, q, RCM, k * TICK_NS).command
        delayed_rates.append(command.rates)
        q = q + delayed_rates.pop(0) * 0.01
        path.append(q)
        commanded_rates.append(command.rates)
    return np.array(path), np.array(commanded_rates)


def beyond_limits(path):
    return np.max(np.maximum(path - UPPER, LOWER - path), axis=0)


@pytest.mark.parametrize("delay,factor", [(0, 0.25), (3, 2.0), (5, 8.0)])
def test_no_request_moves_a_joint_far_beyond_its_limit(delay, factor):
    """The bound is a multiple of slew limit times squared tick, for a delay of 0, 30 and 50 ms."""
    for seed in range(40):
        q, _ = follow_requests(seed, delay)
        assert np.all(beyond_limits(q) <= factor * SLEW * 0.01**2 + 1e-9)


@pytest.mark.parametrize("delay", [0, 3, 5])
def test_no_request_moves_a_joint_beyond_its_limit_within_the_latency(delay):
    """The gate's latency is 50 ms: an arm that follows up to 5 ticks late must stop in time."""
    assert all(np.all(beyond_limits(follow_requests(seed, delay)[0]) <= 1e-6) for seed in range(40))


def test_a_joint_driven_to_its_limit_comes_to_rest_without_chattering():
    q, command, commanded_rates = np.array([0.0, 0.0, 200.0]), make_command(0, 0, np.zeros(3)), []
    for k in range(1, 301):
        command = GATE.admit(SPEED, command, q, RCM, k * TICK_NS).command
        q = q + command.rates * 0.01
        commanded_rates.append(command.rates)
    change = np.diff(np.array(commanded_rates)[30:], axis=0)  # without the acceleration
    assert np.all(change <= 1e-9)


def test_a_joint_can_come_close_to_its_limit():
    """After 3 s towards its limit, a joint is within 1 % of its range from the limit."""
    q, command = np.array([0.0, 0.0, 200.0]), make_command(0, 0, np.zeros(3))
    for k in range(1, 301):
        command = GATE.admit(SPEED, command, q, RCM, k * TICK_NS).command
        q = q + command.rates * 0.01
    assert np.all(UPPER - q < 0.01 * (UPPER - LOWER))


@given(fractions.filter(lambda fraction: np.abs(fraction).max() > 1e-3), st.floats(1, 1e6))
def test_a_request_that_is_too_fast_keeps_its_direction(fraction, factor):
    requested, q = fraction * SPEED, np.array([0.0, 0.0, 140.0])
    requested = requested / np.max(np.abs(requested) / SPEED)
    allowed = admit(factor * requested, make_last_command(requested), q).command.rates
    assert np.allclose(allowed, requested)


@given(fractions)
def test_a_request_within_all_bounds_is_unchanged(fraction):
    last = 0.3 * fraction * SPEED
    requested = last + 0.5 * fraction * SLEW * 0.01
    result = admit(requested, make_last_command(last), np.array([0.0, 0.0, 140.0]))
    assert result.finite and np.allclose(result.command.rates, requested, rtol=1e-12)


def test_a_late_tick_causes_no_jump():
    last = make_last_command(np.zeros(3), milliseconds=5000)
    allowed = admit(SPEED, last, np.array([0.0, 0.0, 140.0])).command.rates
    assert np.allclose(allowed, np.minimum(SLEW * GATE.max_period, SPEED))


@given(fractions)
def test_the_gate_does_not_change_its_inputs(fraction):
    rates, q, last = (
        2 * fraction * SPEED,
        np.array([0.9, 0.0, 50.0]),
        make_last_command(0.5 * fraction * SPEED),
    )
    before = rates.copy(), q.copy(), last.rates.copy()
    admit(rates, last, q)
    for now, original in zip((rates, q, last.rates), before, strict=True):
        assert np.array_equal(now, original)


def test_rest_and_stop_give_zero_rates_and_the_drive_off():
    for command in (GATE.rest(), GATE.stop(make_last_command(SPEED), 1_000_000_000)):
        assert not command.rates.any() and not command.enabled
    assert (
        GATE.rest().number == 0 and GATE.stop(make_last_command(SPEED), 1_000_000_000).number == 8
    )


@given(any_three, fractions, st.floats(0, 1))
def test_a_fraction_of_the_speed_bounds_every_request_and_zero_ramps_to_rest(rates, last, fraction):
    result = admit_at(rates, make_last_command(0.9 * last * fraction * SPEED), fraction)
    assert np.all(np.abs(result.command.rates) <= fraction * SPEED * (1 + 1e-12))
    stopping = [make_last_command(last * SPEED)]
    for k in range(1, 11):
        q, now = np.array([0.0, 0.0, 140.0]), 1_000_000_000 + (k - 1) * TICK_NS
        stopping.append(GATE.admit(np.ones(3), stopping[-1], q, RCM, now, 0.0).command)
    assert not stopping[10].rates.any(), "from full speed it stands still within 100 ms"
    assert stopping[10].deadline == stopping[10].time + 50_000_000


def admit_at(rates, last, fraction):
    return GATE.admit(rates, last, np.array([0.0, 0.0, 140.0]), RCM, 1_000_000_000, fraction)


@pytest.mark.parametrize(
    "invalid",
    [
        {"speed": (1.0, 1.0)},
        {"speed": (1.0, 1.0, np.inf)},
        {"slew": (8.0, 0.0, 500.0)},
        {"slew": (8.0, np.nan, 500.0)},
        {"latency": -0.01},
        {"latency": np.nan},
        {"max_period": 0.0},
        {"max_period": np.inf},
        {"deadline": 0.2},
        {"deadline": np.nan},
    ],
)
def test_invalid_settings_are_refused_by_name(invalid):
    with pytest.raises(BadInput, match=next(iter(invalid))):
        Gate(**invalid)
