"""Rows of benchmarks/unnoticed.py: they draw possible disturbances, and a run of each is judged."""

import numpy as np
import pytest
from unnoticed import DURATION, UNREADY, one, report
from unnoticed_rows import ROWS, RUN, SHOWING, TWO_RUNS

from conftest import mark_others_slow
from rcmservo.sim.disturbances import DISTURBANCE_KINDS


@pytest.mark.parametrize("name", ROWS)
def test_every_row_draws_disturbances_within_the_time_of_its_run(name: str) -> None:
    row = ROWS[name]
    assert row.when in (RUN, SHOWING, TWO_RUNS)
    for seed in range(20):
        for disturbance in row.draw(np.random.default_rng(seed)):
            assert disturbance.kind in DISTURBANCE_KINDS
            assert disturbance.at < DURATION - 5.0


@pytest.mark.parametrize(
    "name", mark_others_slow(["freeze", "lag", "taught", "between_15", "none"])
)
def test_a_run_of_a_row_is_judged(name: str) -> None:
    run = one(name, 3)
    assert run.end != UNREADY
    assert run.settled or run.stops or run.end
    assert np.isfinite(run.error) or name == "taught"
    assert name != "freeze" or (run.stops[0][2] == "FROZEN" and run.stops[0][3])
    assert not (name == "none" and (run.stops or run.wrong or run.grown))


@pytest.mark.slow
def test_a_frozen_image_is_detected_before_the_pose_error_is_large() -> None:
    """Seed 25 once moved 2.6 mm, which moved the markers by half a pixel.

    Since the joints of teaching help, the tool may stay where it is, and nothing is to be found.
    """
    run = one("freeze_after", 25)
    causes = [cause for _, _, cause, _ in run.stops]
    assert causes in ([], ["FROZEN"]) and run.error < 1.5


@pytest.mark.parametrize("seed", mark_others_slow([0, 4, 8, 19]))
def test_a_zoom_since_teaching_is_detected_although_single_frames_are_noisy(seed):
    """In single frames the remaining distance often exceeds what counts as an arrival."""
    run = one("zoom_out", seed, "projection")
    assert not run.settled and len(run.stops) == 1
    assert run.stops[0][2] in ("ELSEWHERE", "IMPLAUSIBLE")


WRONGLY_TAUGHT = [
    ("marker_25", 9081, "projection"),  # one marker agrees, and the tool moves far from the target
    ("marker_25", 9039, "projection"),
    ("marker_8", 9053, "dlt"),  # excused by a tenth of the motion until the tool moves away
    ("mirrored", 9001, "flow"),  # the estimator needs longer than an exploration may last
]


@pytest.mark.parametrize("case", mark_others_slow(WRONGLY_TAUGHT))
def test_a_wrong_target_is_found_as_soon_as_the_fit_is_known(case: tuple[str, int, str]) -> None:
    """Once the tool moved away by 80, 32 and 28 mm; the last case ended as NOT_EXPLORED."""
    run = one(*case)
    assert run.grown < 5.0
    ((time_s, _, cause, _),) = run.stops
    assert cause == "IMPLAUSIBLE" and time_s < 3.0


def test_the_report_has_a_line_for_each_row_that_was_run(capsys: pytest.CaptureFixture) -> None:
    report([one("arm_clock", 1)])
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].startswith("arm_clock ")
    assert len([line for line in lines if line.startswith("arm_clock")]) == 2
