"""Scores of the recording of a real arm meet the requirements."""

import json
from typing import Any

import numpy as np
import pytest

from conftest import ARM_RECORDING, ROOT
from rcmservo.cli.cli import main


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Any:
    if not ARM_RECORDING.exists():
        pytest.skip("../shared/data/dvrk_two_balls is not here")
    out = tmp_path_factory.mktemp("replay") / "out"
    assert (
        main(
            [
                "replay",
                str(ARM_RECORDING),
                "--rig",
                str(ROOT / "examples/davinci.toml"),
                "--out",
                str(out),
            ]
        )
        == 0
    )
    assert len((out / "centres.csv").read_text().splitlines()) == 31
    return json.loads((out / "replay.json").read_text())


def test_both_balls_are_found_in_every_frame_of_the_real_arm(report: Any) -> None:
    assert [row["frame"] for row in report["frames"]] == [f"{i:02d}" for i in range(30)]
    for row in report["frames"]:
        assert row["m1"][0] < row["m2"][0]
        assert row["m1"][1] < row["m2"][1]


def test_one_fit_reprojects_both_balls_to_two_pixels(report: Any) -> None:
    assert max(report["reprojection_rms_px"].values()) <= 2.0


def test_the_imaged_rcm_agrees_with_three_independent_estimates(report: Any) -> None:
    assert np.linalg.norm(np.array(report["imaged_rcm_px"]) - (-110.0, -252.0)) < 30.0
    assert 100.0 < report["imaged_rcm_condition"] < 2000.0


def test_the_next_frame_is_predicted_over_the_finite_step(report: Any) -> None:
    row = report["one_step_rms"]["projection"]
    assert row["s_deg"] <= 0.3
    assert row["r_px"] <= 2.5
    assert row["d_px"] <= 1.0


def test_the_linear_step_of_every_estimator_beats_predicting_no_motion(report: Any) -> None:
    no_motion = report["one_step_rms"]["no_motion"]
    for name in ("projection", "projection-printed", "flow"):
        row = report["one_step_rms"][f"{name}_linear"]
        assert all(row[key] < no_motion[key] for key in no_motion)


def test_the_finite_step_beats_the_linear_one(report: Any) -> None:
    rows = report["one_step_rms"]
    assert all(
        rows["projection"][key] < rows["projection_linear"][key] for key in rows["projection"]
    )


def test_the_interval_of_the_spacing_holds_the_one_in_the_description_of_the_data(
    report: Any,
) -> None:
    spacing = report["lengths_mm"]["spacing"]
    assert abs(spacing["estimate"] - 50.0) <= spacing["half_width"] <= 5.0


def test_lengths_that_the_motion_does_not_determine_have_no_estimate(report: Any) -> None:
    """The stills turn the tool by 0.25 and 0.09 rad and insert it by 52 mm."""
    lengths = dict(report["lengths_mm"])
    del lengths["spacing"]
    assert list(lengths) == [
        "insertion_zero",
        *(f"marker_{k}_off_axis_along_{joint}" for k in (1, 2) for joint in ("yaw", "pitch")),
    ]
    for length in lengths.values():
        assert length["estimate"] is None and 5.0 < length["half_width"] < 50.0


def test_the_documentation_shows_the_lengths_that_are_printed(report: Any) -> None:
    page = (ROOT / "docs/recordings.md").read_text()
    for name, length in report["lengths_mm"].items():
        (row,) = [line for line in page.splitlines() if f"│ {name.replace('_', ' ')} " in line]
        half_width = f"± {length['half_width']:.1f} mm"
        estimate = length["estimate"]
        assert (
            f"to {half_width} only" if estimate is None else f"{estimate:.1f} {half_width}"
        ) in row
