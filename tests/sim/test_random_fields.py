"""Random fields repeat, and are read between their places as a known library reads them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from rcmservo.interfaces import Floats
from rcmservo.sim.rendering import random_field, sampled

SIZE = 64


def waves_of_ten(waves: Floats) -> Floats:
    return np.exp(-((waves / 10.0) ** 2))


@given(
    seed=st.integers(0, 1000),
    places=st.lists(st.tuples(*[st.floats(-200.0, 200.0)] * 2), min_size=1, max_size=20),
)
def test_a_field_is_read_as_scipy_reads_one_that_repeats(
    seed: int, places: list[tuple[float, float]]
) -> None:
    field = random_field(np.random.default_rng(seed), SIZE, waves_of_ten)[:, : SIZE // 2]
    where = np.array(places).T
    expected = ndimage.map_coordinates(field, where, order=1, mode="grid-wrap")
    np.testing.assert_allclose(sampled(field, where), expected, atol=1e-9)


@pytest.mark.parametrize("lost", [np.nan, np.inf])
def test_a_place_that_is_not_known_has_no_value(lost: float) -> None:
    field = random_field(np.random.default_rng(0), SIZE, waves_of_ten)
    values = sampled(field, np.array([[[lost, 1.0]], [[1.0, 2.0]]]))
    assert np.isnan(values[0, 0]) and values[0, 1] == field[1, 2]


def test_a_field_has_mean_0_and_spread_1_and_its_waves_the_strength_asked_for() -> None:
    field = random_field(np.random.default_rng(1), SIZE, lambda waves: (waves == 4.0).astype(float))
    assert abs(field.mean()) < 1e-12 and field.std() == pytest.approx(1.0)
    power = np.abs(np.fft.fft2(field)) ** 2
    often = np.fft.fftfreq(SIZE, 1 / SIZE)
    assert power[np.hypot(often[:, None], often) != 4.0].max() < 1e-18 * power.max()
