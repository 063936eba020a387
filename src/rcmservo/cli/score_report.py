"""Score of a recording: as JSON, as a CSV table of marker centres, and in words."""

from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from rcmservo.cli.terminal import format_quantity
from rcmservo.interfaces import Floats
from rcmservo.loop.run_result import finite_or_none
from rcmservo.recording.foreign import scoring
from rcmservo.recording.foreign.length_fit import LengthEstimate


def convert_score_to_json(score: scoring.RecordingScore) -> dict[str, Any]:
    """Return a score in the form of replay.json; None stands for a value that is not available."""
    frames = zip(score.poses, (detected.points for detected in score.markers), strict=True)
    return {
        "frames": [
            {"frame": pose.name, "m1": _convert_point(m1), "m2": _convert_point(m2)}
            for pose, (m1, m2) in frames
        ],
        "imaged_rcm_px": _convert_point(score.o_c),
        "imaged_rcm_condition": finite_or_none(score.condition),
        "reprojection_rms_px": dict(
            zip(("m1", "m2"), map(finite_or_none, score.reprojection), strict=True)
        ),
        "one_step_rms": {
            name: dict(zip(("s_deg", "r_px", "d_px"), _list_errors(errors), strict=True))
            for name, errors in score.one_step.items()
        },
        "lengths_mm": {
            length.name: {
                "rig_file": length.described,
                "estimate": length.value if length.is_determined else None,
                "half_width": finite_or_none(length.half_width),
            }
            for length in score.lengths
        },
    }


def _convert_point(point: Floats) -> tuple[float, float] | None:
    return (float(point[0]), float(point[1])) if np.isfinite(point).all() else None


def _list_errors(errors: Floats) -> list[float | None]:
    """Return the errors of s, r and d in degrees, px and px."""
    s, r, d = errors
    return [finite_or_none(np.degrees(s)), finite_or_none(r), finite_or_none(d)]


def format_centres_csv(score: scoring.RecordingScore) -> str:
    """Return the markers' centres as CSV; undetected markers are empty."""
    lines = ["frame,m1_u_px,m1_v_px,m2_u_px,m2_v_px"]
    for pose, detected in zip(score.poses, score.markers, strict=True):
        centres_px = [f"{x:.3f}" if np.isfinite(x) else "" for x in detected.points.ravel()]
        lines.append(",".join([pose.name, *centres_px]))
    return "\n".join(lines) + "\n"


def print_score(console: Console, score: scoring.RecordingScore) -> None:
    """Print a score in words, with tables of the one-step errors and of the lengths."""
    is_found = [[np.isfinite(m).all() for m in detected.points] for detected in score.markers]
    m1_count, m2_count = (
        (sum(column) for column in zip(*is_found, strict=True)) if is_found else (0, 0)
    )
    rms_1, rms_2 = (format_quantity(finite_or_none(rms), "px", 2) for rms in score.reprojection)
    for line in (
        f"{len(is_found)} frames, marker 1 found in {m1_count}, marker 2 in {m2_count}",
        f"imaged RCM{_describe_imaged_rcm(score)}",
        f"reprojection: marker 1 {rms_1}, marker 2 {rms_2} rms",
    ):
        console.print(line, soft_wrap=True)
    table = Table("one-step prediction, rms", "s [°]", "r [px]", "d [px]")
    for name, errors in score.one_step.items():
        table.add_row(name, *(format_quantity(error, "", 2) for error in _list_errors(errors)))
    console.print(table)
    table = Table("length", "rig file", "by the pixels, 95 %")
    for length in score.lengths:
        described = format_quantity(length.described, "mm", 1)
        table.add_row(length.name.replace("_", " "), described, _describe_length(length))
    if score.lengths:
        console.print(table)


def _describe_imaged_rcm(score: scoring.RecordingScore) -> str:
    o_c, condition = score.o_c, score.condition
    if not (np.isfinite(o_c).all() and np.isfinite(condition)):
        return ": not observable, because the imaged tool rotates too little"
    return f" ({o_c[0]:.1f}, {o_c[1]:.1f}) px, condition number {condition:.0f}"


def _describe_length(length: LengthEstimate) -> str:
    """Return a length with its interval, or how far from determined it is."""
    value, half_width = length.value, length.half_width
    if length.is_determined:
        digits = 1 if half_width >= 1.0 else 2
        return f"{value:.{digits}f} ± {half_width:.{digits}f} mm"
    if np.isinf(half_width):
        return "undetermined: this motion does not fix it"
    return f"undetermined: this motion fixes it to ± {half_width:.1f} mm only"
