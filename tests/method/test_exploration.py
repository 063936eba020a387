"""The first motion: reachable corners that span space, inside the limits and near the start, and an
honest end."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from conftest import SHAFT, markers_seen, random_from, seeds, tool_positions, true_camera
from rcmservo.errors import BadInput
from rcmservo.guard.thresholds import Thresholds
from rcmservo.method.exploration import (
    CORNERS,
    Exploration,
    Exploring,
    begin,
    complete,
    corner,
    overdue,
    towards,
    unexplained,
    visit,
    volume,
)
from rcmservo.method.kinematics import (
    JointLimits,
    PitchYawRcm,
    SphericalRcm,
    joint_rates,
    joints,
    position,
)
from rcmservo.method.projection import parameters

LEAST_ROOM = Thresholds.least_room
RCMS = [SphericalRcm(), PitchYawRcm(), PitchYawRcm(insertion_zero=-7.0)]
rcms = st.sampled_from(RCMS)


def somewhere(rcm, seed, margin=0.0):
    lower, upper = np.array(rcm.limits.lower), np.array(rcm.limits.upper)
    return random_from(seed).uniform(
        lower + margin * (upper - lower), upper - margin * (upper - lower)
    )


def begun(rcm, q, now=0, least_room=LEAST_ROOM, **choices):
    """A tour, or None where there is no room for one."""
    tour = Exploring.of()
    begin(tour.rows[0], rcm.rcm(), q, now, least_room, Exploration(**choices).row[0])
    assert tour.begun != tour.no_room
    return tour if tour.begun else None


def completed(rows, visits, J_hat, o_c, **choices):
    tour = Exploring.of(corners=rows[:, :3], seen=rows, visits=visits, begun=True)
    return complete(tour.rows[0], J_hat, o_c, Exploration(**choices).row[0])


def start_of(rcm, q):
    return position(rcm.rcm(), q)


@given(rcms, seeds, st.floats(1.0, 20.0))
def test_far_from_limits_the_corners_are_a_full_tetrahedron_at_the_radius(rcm, seed, radius):
    q = somewhere(rcm, seed, margin=0.25)
    tour = begun(rcm, q, now=5, radius=radius)
    assert tour is not None and tour.visits == 0 and tour.start == 5
    away = np.linalg.norm(tour.corners - start_of(rcm, q), axis=1)
    assert np.all(away <= radius * (1 + 1e-6))
    assert volume(tour.corners) > 0.9 * volume(radius * CORNERS)


@given(rcms, seeds, st.floats(1.0, 20.0))
def test_anywhere_the_corners_are_inside_the_limits_and_not_in_a_plane_or_there_is_no_tour(
    rcm, seed, radius
):
    q = somewhere(rcm, seed)
    tour = begun(rcm, q, radius=radius)
    if tour is not None:
        there = np.stack([joints(rcm.rcm(), p) for p in tour.corners])
        assert np.all(there > np.array(rcm.limits.lower)) and np.all(
            there < np.array(rcm.limits.upper)
        )
        assert volume(tour.corners) > 0.19 * volume(radius * CORNERS)


def drive(rcm, q, dt=0.01):
    """Corners reached by an arm that does just what it is told but stops at its limits."""
    tour, reached, x = begun(rcm, q), 0, Exploration()
    for _ in range(1000):
        if tour is None or reached == 4:
            break
        p = start_of(rcm, q)
        goal = corner(tour.rows[0])
        if np.linalg.norm(goal - p) < x.reach:
            visit(tour.rows[0], p, np.zeros((2, 2)))
            reached += 1
            continue
        rates = joint_rates(rcm.rcm(), q, towards(p, goal, x.speed, x.reach))
        q = np.clip(q + rates * dt, rcm.limits.lower, rcm.limits.upper)
    return None if tour is None else reached


@given(st.sampled_from(RCMS[1:]), seeds)
def test_every_tour_can_be_driven_within_the_limits(rcm, seed):
    assert drive(rcm, somewhere(rcm, seed)) in (None, 4)


def test_every_tour_can_be_driven_from_a_spherical_start_near_half_a_turn_too():
    rcm = SphericalRcm()
    starts = [np.array([theta, side * 3.1, 100.0]) for theta in (0.5, 1.0) for side in (-1, 1)]
    assert all(drive(rcm, q) in (None, 4) for q in starts)


@pytest.mark.parametrize("joint", range(3))
def test_without_room_in_one_joint_there_is_no_tour(joint):
    q = np.array([0.1, 0.2, 100.0])
    lower, upper = np.array([-1.0, -0.9, 50.0]), np.array([1.0, 0.9, 200.0])
    lower[joint], upper[joint] = q[joint] - 1e-3, q[joint] + 1e-3
    rcm = PitchYawRcm(JointLimits(tuple(lower), tuple(upper)))
    assert begun(rcm, q) is None


def test_how_much_room_a_tour_needs_is_a_threshold():
    rcm, q = PitchYawRcm(), np.array([0.1, 0.2, 100.0])
    found = [begun(rcm, q, least_room=share) is not None for share in (0.2, 1.0, 1.1)]
    assert found == [True, True, False]


def test_next_to_a_limit_the_other_tetrahedron_is_tried():
    """Wherever a corner of one shape is cut off, the mirrored shape may still have its volume."""
    rcm = PitchYawRcm()
    found = sum(begun(rcm, somewhere(rcm, seed)) is not None for seed in range(200))
    assert found > 180


@given(seeds, st.floats(1.0, 100.0), st.floats(0.1, 5.0))
def test_the_way_to_a_corner_is_straight_at_the_speed_and_slower_near_it(seed, speed, reach):
    random = random_from(seed)
    p, goal = random.uniform(-50, 50, 3), random.uniform(-50, 50, 3)
    distance = np.linalg.norm(goal - p)
    assume(distance > 1e-3)
    v = towards(p, goal, speed, reach)
    assert np.linalg.norm(v) == pytest.approx(speed * min(1.0, distance / (2 * reach)))
    assert v @ (goal - p) == pytest.approx(np.linalg.norm(v) * distance)


def test_at_the_corner_itself_nothing_moves():
    p = np.array([10.0, 20.0, 90.0])
    assert not towards(p, p.copy(), 35.0, 1.0).any()


def seen_at_corners(seed):
    random = random_from(seed)
    places = tool_positions(random, 1) + 0.05 * CORNERS
    C = true_camera(random, places)
    rows = np.stack([np.concatenate([p, markers_seen(C, p).ravel()]) for p in places])
    return rows, *parameters(C)


@given(seeds)
def test_the_true_jacobian_explains_small_moves_and_a_null_one_nothing(seed):
    from rcmservo.method.estimators.projection import feature_jacobian
    from rcmservo.method.features import about

    rows, a, o_c = seen_at_corners(seed)
    J = feature_jacobian(a, rows[0, :3].copy(), about(rows[0, 3:].copy(), o_c), SHAFT)
    assert unexplained(rows, J, o_c) < 0.05
    assert unexplained(rows, np.zeros((3, 3)), o_c) == pytest.approx(1.0)


@pytest.mark.parametrize("J_hat", [np.zeros((3, 3)), np.full((3, 3), np.nan)])
def test_a_tour_is_not_complete_before_the_estimate_predicts(J_hat):
    rows, _, o_c = seen_at_corners(1)
    assert not completed(rows, 400, J_hat, o_c)


def test_a_camera_that_sees_no_change_at_all_completes_nothing():
    rows, _, o_c = seen_at_corners(1)
    rows[:, 3:] = rows[0, 3:]
    assert unexplained(rows, np.zeros((3, 3)), o_c) == np.inf


def test_a_tour_is_not_complete_before_all_its_rounds():
    from rcmservo.method.estimators.projection import feature_jacobian
    from rcmservo.method.features import about

    rows, a, o_c = seen_at_corners(1)
    J = feature_jacobian(a, rows[0, :3].copy(), about(rows[0, 3:].copy(), o_c), SHAFT)
    done = [completed(rows, visits, J, o_c, rounds=2) for visits in (3, 4, 7, 8, 9)]
    assert done == [False, False, False, True, True]


def test_visits_keep_the_last_four_in_order():
    tour = begun(PitchYawRcm(), np.array([0.1, 0.2, 100.0]))
    places = tour.corners.copy()
    for i in range(6):
        assert np.array_equal(corner(tour.rows[0]), places[i % 4])
        visit(tour.rows[0], np.full(3, float(i)), 10.0 * i + np.array([[1.0, 2.0], [3.0, 4.0]]))
    assert tour.seen[:, 0].tolist() == [2, 3, 4, 5]
    assert tour.seen[:, 6].tolist() == [24, 34, 44, 54]
    assert tour.seen[3].tolist() == [5, 5, 5, 51, 52, 53, 54]
    assert tour.visits == 6


def test_a_tour_is_overdue_just_after_its_time():
    tour = begun(PitchYawRcm(), np.array([0.1, 0.2, 100.0]), now=3_000_000_000)
    x = Exploration(max_time=10.0).row[0]
    assert not overdue(tour.rows[0], 13_000_000_000, x)
    assert overdue(tour.rows[0], 13_000_000_001, x)
    assert not overdue(Exploring.of().rows[0], 13_000_000_001, x)


@pytest.mark.parametrize("name", ["radius", "speed", "tolerance", "max_time", "reach", "rounds"])
@pytest.mark.parametrize("value", [0, -1])
def test_settings_that_cannot_work_are_refused_by_name(name, value):
    with pytest.raises(BadInput, match=name):
        Exploration(**{name: value})
