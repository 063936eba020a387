"""The first motion: reachable corners that span space, inside the limits and near the start."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import make_laboratory, make_random, seeds
from rcmservo.control.exploration import (
    CORNER_TOLERANCE,
    CORNERS,
    Exploration,
    ExplorationState,
    compute_max_leg_length,
    compute_rates_to_corner,
    compute_relative_difference,
    is_at_corner,
    is_overdue,
    set_next_corner,
    set_round,
    start_exploration,
)
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.errors import BadInput
from rcmservo.geometry.kinematics import (
    JointLimits,
    PitchYawRcm,
    SphericalRcm,
    compute_position,
    compute_position_jacobian,
)
from rcmservo.geometry.tool import RIGID, RigidTool, ToolStruct, compute_second_marker
from rcmservo.numerics.structs import to_row
from rcmservo.safety.gate import Gate
from rcmservo.safety.thresholds import Thresholds
from rcmservo.sim import RigSettings
from rcmservo.sim.scene import SceneSettings

MIN_ROOM = Thresholds.min_exploration_room
MAX_RATES = np.array(Gate.speed)
RCMS = [SphericalRcm(), PitchYawRcm(), PitchYawRcm(insertion_zero=-7.0)]
rcms = st.sampled_from(RCMS)


def random_joints(rcm, seed, margin=0.0):
    lower, upper = np.array(rcm.limits.lower), np.array(rcm.limits.upper)
    return make_random(seed).uniform(
        lower + margin * (upper - lower), upper - margin * (upper - lower)
    )


def begun(rcm, q, now=0, least_room=MIN_ROOM, **choices):
    """Return an exploration, or None if there is no room for it."""
    state = ExplorationState.of()
    parameters = to_row(Exploration(**choices))[0]
    start_exploration(state.rows[0], rcm.to_struct(), MAX_RATES, q, now, least_room, parameters)
    assert state.has_begun != state.has_no_room
    return state if state.has_begun else None


def sides_of_round(state, rcm, number, **choices):
    """Return the sides of round `number`, counted from 0."""
    rows = state.rows.copy()
    rows["visited_corners"] = number * len(CORNERS)
    set_round(rows[0], rcm.to_struct(), MAX_RATES, 0.0, to_row(Exploration(**choices))[0])
    return ExplorationState(rows).sides


def corners(home, sides):
    return home + CORNERS * sides


def longest_distance(rcm, joints):
    """Return the longest distance in mm of marker 1 between any two of these joints."""
    p = np.stack([compute_position(rcm.to_struct(), q) for q in joints])
    return np.linalg.norm(p[:, None] - p[None], axis=2).max()


@given(rcms, seeds, st.integers(0, 6))
def test_every_rounds_corners_are_within_the_limits_and_marker_1_goes_no_further_than_the_reach(
    rcm, seed, number
):
    q, reach = random_joints(rcm, seed), Exploration.max_leg_length
    state = begun(rcm, q)
    if state is not None:
        reached = corners(q, sides_of_round(state, rcm, number))
        assert np.all(reached >= rcm.limits.lower) and np.all(reached <= rcm.limits.upper)
        assert longest_distance(rcm, reached) < 1.15 * reach, (
            "longer only by the curvature of a joint's path"
        )


@given(rcms, seeds)
def test_the_corners_of_an_exploration_span_space(rcm, seed):
    """The volume of the corners is a third of the product of the sides."""
    q = random_joints(rcm, seed)
    state = begun(rcm, q)
    if state is not None:
        reached = corners(q, state.sides)
        volume = np.linalg.det(reached[:3] - reached[3])
        assert abs(volume) == pytest.approx(2.0 * abs(np.prod(state.sides)))
        assert np.all(
            np.abs(state.sides) >= MIN_ROOM * np.abs(expected_sides(rcm, q)) * (1 - 1e-12)
        )


def expected_sides(rcm, q, number=0, parameters=Exploration()):  # noqa: B008 frozen
    """Return the sides of a round with enough room."""
    sides = parameters.speed_scale * parameters.leg_time * MAX_RATES * parameters.growth**number
    return sides * min(
        parameters.max_leg_length / compute_max_leg_length(rcm.to_struct(), q, sides), 1.0
    )


@given(rcms, seeds)
def test_far_from_limits_a_side_is_the_motion_of_one_leg_up_to_the_reach(rcm, seed):
    q = random_joints(rcm, seed, margin=0.3)
    state = begun(rcm, q, now=5)
    assert state is not None and state.visited_corners == 0 and state.start_time == 5
    np.testing.assert_allclose(state.sides, expected_sides(rcm, q))
    assert np.array_equal(state.start_joints, q)


@given(rcms, seeds)
def test_every_round_is_larger_until_the_reach_and_mirrored(rcm, seed):
    q = random_joints(rcm, seed, margin=0.35)
    state = begun(rcm, q, max_leg_length=20.0)
    for number in range(1, 7):
        sides = sides_of_round(state, rcm, number, max_leg_length=20.0)
        size = expected_sides(rcm, q, number, Exploration(max_leg_length=20.0))
        np.testing.assert_allclose(sides, size * (-1.0) ** number)


@given(rcms, seeds)
def test_the_span_is_the_longest_corner_distance_by_the_derivative(rcm, seed):
    random, q = make_random(seed), random_joints(rcm, seed)
    sides = random.uniform(-1.0, 1.0, 3) * (0.1, 0.1, 10.0)
    steps = compute_position_jacobian(rcm.to_struct(), q) * np.abs(sides)
    pairs = (0, 1), (1, 2), (2, 0)
    longest = max(np.linalg.norm(np.abs(steps[:, pair]).sum(axis=1)) for pair in pairs)
    assert compute_max_leg_length(rcm.to_struct(), q, sides) == pytest.approx(longest)
    p = corners(np.zeros(3), sides) @ compute_position_jacobian(rcm.to_struct(), q).T
    assert np.linalg.norm(p[:, None] - p[None], axis=2).max() <= longest * (1 + 1e-12)


def drive_exploration(rcm, q, visits, dt=0.01):
    """Return the joints at every visited corner, by an arm that follows its rates exactly.

    A round may take 3 s at most.
    """
    state, parameters, reached = begun(rcm, q), to_row(Exploration())[0], []
    for _ in range(round(3.0 / dt) * visits // len(CORNERS)):
        if state is None or state.visited_corners == visits:
            break
        if is_at_corner(state.rows[0], state.next_corner, q):
            reached.append(q)
            state.rows["visited_corners"] += 1
            if state.visited_corners % len(CORNERS) == 0:
                set_round(state.rows[0], rcm.to_struct(), MAX_RATES, 0.0, parameters)
            set_next_corner(state.rows[0])
        q = q + compute_rates_to_corner(state.rows[0], MAX_RATES, q, 0.0, parameters) * dt
        assert np.all(q >= rcm.limits.lower) and np.all(q <= rcm.limits.upper)
    return state, reached


@given(rcms, seeds)
def test_every_exploration_can_be_driven_within_the_limits_and_every_round_ends_at_its_start(
    rcm, seed
):
    q = random_joints(rcm, seed)
    state, reached = drive_exploration(rcm, q, visits=12)
    if state is not None:
        assert state.visited_corners == 12
        largest = np.abs([sides_of_round(state, rcm, number) for number in range(3)]).max(axis=0)
        for home in reached[3::4]:
            assert np.all(np.abs(home - q) <= CORNER_TOLERANCE * largest)


def test_an_exploration_can_be_driven_from_a_spherical_start_near_half_a_turn():
    rcm = SphericalRcm()
    for theta in (0.5, 1.0):
        for side in (-1, 1):
            assert (
                drive_exploration(rcm, np.array([theta, side * 3.0, 100.0]), visits=8)[
                    0
                ].visited_corners
                == 8
            )


def test_the_first_round_is_driven_in_less_than_a_second():
    state, reached = drive_exploration(PitchYawRcm(), np.array([0.1, 0.2, 100.0]), visits=4)
    assert len(reached) == 4
    durations = np.abs(np.diff([state.start_joints, *reached], axis=0)) / (
        Exploration.speed_scale * MAX_RATES
    )
    assert durations.max(axis=1).sum() < 1.0


@pytest.mark.parametrize("joint", range(3))
def test_without_room_in_one_joint_there_is_no_exploration(joint):
    q = np.array([0.1, 0.2, 100.0])
    lower, upper = np.array([-1.0, -0.9, 50.0]), np.array([1.0, 0.9, 200.0])
    lower[joint], upper[joint] = q[joint] - 1e-3, q[joint] + 1e-3
    rcm = PitchYawRcm(JointLimits(tuple(lower), tuple(upper)))
    assert begun(rcm, q) is None


def test_the_room_that_an_exploration_needs_is_a_threshold():
    rcm, q = PitchYawRcm(), np.array([0.1, 0.2, 100.0])
    found = [begun(rcm, q, least_room=fraction) is not None for fraction in (0.2, 1.0, 1.1)]
    assert found == [True, True, False]


@pytest.mark.parametrize("joint", range(3))
@pytest.mark.parametrize("end", ["lower", "upper"])
def test_next_to_a_limit_the_joint_goes_to_the_other_side_in_every_round(joint, end):
    rcm = PitchYawRcm()
    q, inside = np.array([0.1, 0.2, 100.0]), 1.0 if end == "lower" else -1.0
    q[joint] = getattr(rcm.limits, end)[joint]
    state = begun(rcm, q)
    for number in range(6):
        assert sides_of_round(state, rcm, number)[joint] * inside > 0.0


def test_there_is_room_at_every_position_within_the_margins():
    for rcm in RCMS:
        assert all(begun(rcm, random_joints(rcm, seed)) is not None for seed in range(100))


def test_at_the_corner_itself_nothing_moves_and_far_from_it_the_slowest_joint_at_its_speed():
    state = begun(PitchYawRcm(), np.array([0.1, 0.2, 100.0]))
    parameters, corner = to_row(Exploration())[0], corners(state.start_joints, state.sides)[0]
    assert not compute_rates_to_corner(state.rows[0], MAX_RATES, corner, 0.0, parameters).any()
    rates = compute_rates_to_corner(
        state.rows[0], MAX_RATES, corner - [1.0, -1.0, 50.0], 0.0, parameters
    )
    np.testing.assert_allclose(rates, Exploration.speed_scale * MAX_RATES * [1.0, -1.0, 1.0])


def test_a_corner_counts_as_visited_by_all_three_joints():
    state = begun(PitchYawRcm(), np.array([0.1, 0.2, 100.0]))
    corner = corners(state.start_joints, state.sides)[0]
    for joint in range(3):
        for fraction, reached in ((0.9, True), (1.1, False)):
            q = corner.copy()
            q[joint] += fraction * CORNER_TOLERANCE * state.sides[joint]
            assert is_at_corner(state.rows[0], state.next_corner, q) == reached
    assert not is_at_corner(state.rows[0], state.next_corner, np.full(3, np.nan))


@given(seeds, st.floats(0.0, 2.0))
def test_the_disagreement_is_the_relative_error_of_the_estimate(seed, fraction):
    random = make_random(seed)
    J, error = random.standard_normal((2, 3, 3))
    J_hat = J + fraction * error * np.linalg.norm(J) / np.linalg.norm(error)
    assert compute_relative_difference(J_hat, J) == pytest.approx(fraction, abs=1e-9)


def test_an_empty_or_invalid_estimate_never_agrees():
    assert compute_relative_difference(np.ones((3, 3)), np.zeros((3, 3))) == np.inf
    assert compute_relative_difference(np.zeros((3, 3)), np.ones((3, 3))) == 1.0
    assert not compute_relative_difference(np.full((3, 3), np.nan), np.ones((3, 3))) <= 1e9


def test_an_exploration_is_overdue_just_after_its_time():
    state = begun(PitchYawRcm(), np.array([0.1, 0.2, 100.0]), now=3_000_000_000)
    parameters = to_row(Exploration(max_time=10.0))[0]
    assert not is_overdue(state.rows[0], 13_000_000_000, parameters)
    assert is_overdue(state.rows[0], 13_000_000_001, parameters)
    assert not is_overdue(ExplorationState.of().rows[0], 13_000_000_001, parameters)


@pytest.mark.parametrize(
    "name",
    [
        "leg_time",
        "speed_scale",
        "max_leg_length",
        "growth",
        "uncertainty",
        "tolerance",
        "min_corners",
        "max_time",
    ],
)
@pytest.mark.parametrize("value", [0, -1, 1e300])
def test_settings_that_cannot_work_are_refused_by_name(name, value):
    if value == 1e300 and name not in ("speed_scale", "growth", "min_corners"):
        value = np.inf
    with pytest.raises(BadInput, match=name):
        Exploration(**{name: value})


@pytest.mark.parametrize("spacing", [30.0, 100.0, 200.0])
def test_neither_marker_exceeds_the_speed_cap_while_exploring(spacing):
    """Without the cap, marker 2 moves at 50 mm/s, and at 71 mm/s if it is 200 mm from marker 1."""
    speeds, tool = [], RigidTool(spacing)
    for seed in (1, 2, 3):
        lab = make_laboratory(seed, RigSettings(tool=tool, scene=SceneSettings(travel=(5.0, 40.0))))
        servo = lab.servo()
        rows = [observation for observation, state in lab.run(servo, 3.0) if not state.explored]
        rcm, shaft = servo.mechanism.to_struct(tool.offset), ToolStruct(RIGID, spacing)
        markers = [
            [p1, compute_second_marker(shaft, p1)]
            for p1 in (compute_position(rcm, row.q) for row in rows)
        ]
        times_s = np.array([row.q_time for row in rows]) * 1e-9
        moved_mm = np.linalg.norm(np.diff(markers, axis=0), axis=2)
        speeds.append((moved_mm / np.diff(times_s)[:, None]).max())
    assert 0.5 * SaturatedController.max_speed < max(speeds) < 1.02 * SaturatedController.max_speed
