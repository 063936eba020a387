"""One ball of a recorded real arm tells the tool's place, once its size is that of one edge."""

import numpy as np
import pytest
from one_ball import Still, errors, stills

from conftest import DATA, ROOT
from rcmservo.config.rig_file import Lab, load_lab


@pytest.fixture(scope="module")
def lab() -> Lab:
    return load_lab(ROOT / "examples/davinci.toml")


@pytest.fixture(scope="module")
def seen(lab: Lab) -> list[Still]:
    if not DATA.exists():
        pytest.skip("../shared/data/dvrk_two_balls is not here")
    return stills(DATA, lab)


@pytest.mark.parametrize(("k", "bar"), [(0, 1.5), (1, 2.0)])
def test_one_ball_tells_the_place_by_its_size(
    k: int, bar: float, seen: list[Still], lab: Lab
) -> None:
    """Ball 2 is smaller and farther away: the same error of its size is 1.5 times as far."""
    assert len(seen) == 30
    for sizes in ([one.tracked for one in seen], [one.outlined for one in seen]):
        off = errors(seen, sizes, k, lab.tool)
        assert np.median(off) <= bar and np.quantile(off, 0.975) <= 2.0 * bar
