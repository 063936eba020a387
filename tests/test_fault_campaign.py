"""Small campaign of random faults: the first runs of benchmarks/campaign.py."""

from collections.abc import Iterator

import campaign
import pytest
from campaign import Run, disturbed, one

from rcmservo.sim import Disturbance

RUN_COUNTS = {"faults": 10, "short": 4, "none": 2}
DURATION_S, FAULTS_UNTIL_S = 15.0, 9.0
"""Length of a run, and the time until which its faults begin: half of those of the benchmark."""
VALID_ENDS = {"settled", "HOLD", "PAUSED", "FAULT", "killed"}


@pytest.fixture(scope="module", autouse=True)
def shorter_runs() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(campaign, "DURATION", DURATION_S)
        patched.setattr(campaign, "FAULTS_UNTIL", FAULTS_UNTIL_S)
        yield


@pytest.fixture(scope="module")
def runs(shorter_runs: None) -> dict[str, list[Run]]:
    return {kind: [one(seed, kind) for seed in range(n)] for kind, n in RUN_COUNTS.items()}


def test_a_run_with_faults_meets_all_requirements() -> None:
    run = one(1, "faults")
    assert not run.wrong_commands and not run.too_slow, run
    assert all(stop[3] for stop in run.stops), run
    assert run.end in VALID_ENDS, run


@pytest.mark.slow
@pytest.mark.parametrize("kind", RUN_COUNTS)
def test_no_command_is_invalid_and_no_stop_is_slow(kind: str, runs: dict[str, list[Run]]) -> None:
    for run in runs[kind]:
        assert not run.wrong_commands, run
        assert not run.too_slow, run


@pytest.mark.slow
def test_every_stop_names_an_injected_fault(runs: dict[str, list[Run]]) -> None:
    stops = [
        (run.seed, stop) for kind in ("faults", "short") for run in runs[kind] for stop in run.stops
    ]
    assert len(stops) > 15
    assert [stop for stop in stops if not stop[1][3]] == []


@pytest.mark.slow
def test_every_run_settles_or_ends_at_rest(runs: dict[str, list[Run]]) -> None:
    ends = {run.end for run in runs["faults"]}
    assert ends <= VALID_ENDS
    assert all(run.pose_error < 2.0 for run in runs["faults"] if run.end == "settled")


@pytest.mark.slow
def test_runs_without_faults_never_stop_and_runs_with_short_faults_settle(
    runs: dict[str, list[Run]],
) -> None:
    assert all(not run.stops and run.end == "settled" for run in runs["none"])
    assert all(run.end == "settled" for run in runs["short"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "text"),
    [
        (264, "corrupt:at=2.582,for=1.356,what=noise"),
        (1853, "corrupt:at=2.157,for=1.301,what=noise"),
    ],
)
def test_random_points_do_not_change_the_estimate(seed: int, text: str) -> None:
    """Points beyond 10^12 px stopped the servo as if the estimator had failed."""
    run = disturbed(seed, [Disturbance.parse(text)])
    assert run.stops and all(stop[3] for stop in run.stops), run


@pytest.mark.slow
def test_an_arm_that_stops_answering_while_its_drive_is_enabled_ends_the_run_in_one_sentence() -> (
    None
):
    texts = "decoy:at=0.855,for=1.02,marker=2,px=23.2", "arm_silent:at=4.459,for=1.427"
    run = disturbed(1667, [Disturbance.parse(text) for text in texts])
    assert run.end == "not enabled"
    assert "the drive does not come on" in run.words
    assert not run.wrong_commands and not run.too_slow
