"""Features: eq. (6)-(9) as printed, wrapped angle, continuous errors and invariances."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from conftest import make_random, seeds
from rcmservo.geometry.features import (
    compute_feature_error,
    compute_features,
    compute_features_jacobian,
    shift_to_rcm,
)

angles = st.one_of(
    st.floats(-10, 10),
    st.sampled_from([np.pi, -np.pi, 2 * np.pi, 3 * np.pi, np.nextafter(np.pi, 4), 0.0]),
)


def draw_markers(seed):
    random = make_random(seed)
    return random.uniform(-400, 400, 4)


def test_features_of_known_markers():
    y = compute_features(np.array([3.0, 4.0, 3.0, -6.0]))
    assert np.allclose(y, [-np.pi / 2, 5.0, 10.0])


@given(seeds, st.floats(-np.pi, np.pi))
def test_rotation_about_the_imaged_rcm_changes_s_only(seed, turn):
    m = draw_markers(seed)
    c, s = np.cos(turn), np.sin(turn)
    turned = (m.reshape(2, 2) @ np.array([[c, s], [-s, c]])).ravel()
    assert np.allclose(
        compute_feature_error(
            compute_features(turned), compute_features(m) + np.array([turn, 0, 0])
        ),
        0,
        atol=1e-9,
    )


@given(seeds, st.floats(0.01, 100))
def test_enlargement_about_the_imaged_rcm_scales_the_distances_only(seed, factor):
    m = draw_markers(seed)
    s, r, d = compute_features(m)
    assert np.allclose(compute_features(factor * m), [s, factor * r, factor * d])


@given(seeds)
def test_a_common_shift_of_pixels_and_imaged_rcm_changes_nothing(seed):
    random = make_random(seed)
    points, o_c, shift = (
        random.uniform(0, 640, (2, 2)),
        random.uniform(-500, 900, 2),
        random.uniform(-99, 99, 2),
    )
    assert np.allclose(shift_to_rcm(points + shift, o_c + shift), shift_to_rcm(points, o_c))


@given(seeds)
def test_the_shift_of_the_origin_takes_both_shapes_and_does_not_change_its_input(seed):
    random = make_random(seed)
    points, o_c = random.uniform(0, 640, (2, 2)), random.uniform(0, 640, 2)
    before = points.copy()
    expected = (points - o_c).ravel()
    assert np.array_equal(shift_to_rcm(points, o_c), expected)
    assert np.array_equal(shift_to_rcm(points.ravel(), o_c), expected)
    assert np.array_equal(points, before)


@given(angles, angles)
def test_the_error_of_the_angle_is_wrapped(s, s_d):
    y, y_d = np.array([s, 30.0, 40.0]), np.array([s_d, 35.0, 20.0])
    before = y.copy(), y_d.copy()
    delta = compute_feature_error(y, y_d)
    assert -np.pi <= delta[0] <= np.pi
    assert np.cos(delta[0]) == pytest.approx(np.cos(s - s_d), abs=1e-9)
    assert np.sin(delta[0]) == pytest.approx(np.sin(s - s_d), abs=1e-9)
    assert delta[1:].tolist() == [-5.0, 20.0]
    assert np.array_equal(y, before[0]) and np.array_equal(y_d, before[1])


@pytest.mark.parametrize("s", [np.pi, -np.pi, 3 * np.pi])
def test_half_a_turn_counts_as_plus_pi(s):
    assert compute_feature_error(np.array([s, 0.0, 0.0]), np.zeros(3))[0] == np.pi


@given(angles, angles)
def test_the_error_is_antisymmetric_except_at_half_a_turn(s, s_d):
    y, y_d = np.array([s, 30.0, 40.0]), np.array([s_d, 35.0, 20.0])
    forth, back = compute_feature_error(y, y_d), compute_feature_error(y_d, y)
    assume(abs(forth[0]) < np.pi - 1e-9)
    assert np.allclose(forth, -back, atol=1e-12)


def test_a_small_rotation_across_the_cut_of_atan2_is_a_small_error():
    near, past = (
        compute_features(np.array([0.0, 0.0, -100.0, 1.0])),
        compute_features(np.array([0.0, 0.0, -100.0, -1.0])),
    )
    assert near[0] - past[0] > 6
    assert compute_feature_error(past, near)[0] == pytest.approx(0.02, rel=1e-3)


@pytest.mark.parametrize("m", [[50.0, 60.0, 50.0, 60.0], [0.0, 0.0, 50.0, 60.0]])
def test_an_undefined_derivative_is_not_finite(m):
    """The Jacobian is not finite where the markers coincide or marker 1 is at the imaged RCM."""
    assert not np.isfinite(compute_features_jacobian(np.array(m))).all()
