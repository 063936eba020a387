"""One ball of a recorded real arm gives the tool's position, if its size follows one edge."""

import numpy as np
import pytest
from one_ball import Still, errors, stills

from conftest import ARM_RECORDING, ROOT
from rcmservo.config.rig_file import RigDescription, load_rig_file


@pytest.fixture(scope="module")
def lab() -> RigDescription:
    return load_rig_file(ROOT / "examples/davinci.toml")


@pytest.fixture(scope="module")
def observations(lab: RigDescription) -> list[Still]:
    if not ARM_RECORDING.exists():
        pytest.skip("../shared/data/dvrk_two_balls is not here")
    return stills(ARM_RECORDING, lab)


@pytest.mark.parametrize(("k", "limit"), [(0, 1.5), (1, 2.0)])
def test_the_size_of_one_ball_gives_the_position(
    k: int, limit: float, observations: list[Still], lab: RigDescription
) -> None:
    """Ball 2 is smaller and farther away: the same size error causes 1.5 times the error."""
    assert len(observations) == 30
    for sizes in ([one.tracked for one in observations], [one.outlined for one in observations]):
        error_mm = errors(observations, sizes, k, lab.tool)
        assert np.median(error_mm) <= limit and np.quantile(error_mm, 0.975) <= 2.0 * limit
