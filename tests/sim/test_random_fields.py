"""Periodic random fields and their interpolation, compared with SciPy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from rcmservo.interfaces import Floats
from rcmservo.sim.rendering import make_random_field, sample_field

SIZE = 64


def ten_waves(waves: Floats) -> Floats:
    return np.exp(-((waves / 10.0) ** 2))


@given(
    seed=st.integers(0, 1000),
    positions=st.lists(st.tuples(*[st.floats(-200.0, 200.0)] * 2), min_size=1, max_size=20),
)
def test_fields_are_interpolated_as_scipy_does_periodically(
    seed: int, positions: list[tuple[float, float]]
) -> None:
    field = make_random_field(np.random.default_rng(seed), SIZE, ten_waves)[:, : SIZE // 2]
    where = np.array(positions).T
    expected = ndimage.map_coordinates(field, where, order=1, mode="grid-wrap")
    np.testing.assert_allclose(sample_field(field, where), expected, atol=1e-9)


@pytest.mark.parametrize("invalid", [np.nan, np.inf])
def test_a_position_that_is_not_finite_has_no_value(invalid: float) -> None:
    field = make_random_field(np.random.default_rng(0), SIZE, ten_waves)
    values = sample_field(field, np.array([[[invalid, 1.0]], [[1.0, 2.0]]]))
    assert np.isnan(values[0, 0]) and values[0, 1] == field[1, 2]


def test_a_field_has_mean_0_spread_1_and_the_requested_spectrum() -> None:
    field = make_random_field(
        np.random.default_rng(1), SIZE, lambda waves: (waves == 4.0).astype(float)
    )
    assert abs(field.mean()) < 1e-12 and field.std() == pytest.approx(1.0)
    power = np.abs(np.fft.fft2(field)) ** 2
    frequencies = np.fft.fftfreq(SIZE, 1 / SIZE)
    assert power[np.hypot(frequencies[:, None], frequencies) != 4.0].max() < 1e-18 * power.max()
