"""Score of a recording: as JSON, as a table of marker centres, and in words."""

from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from rcmservo.cli.terminal import format_quantity
from rcmservo.interfaces import Floats
from rcmservo.loop.run_result import finite_or_none
from rcmservo.recording.foreign import scoring

Pair = tuple[float, float]


def convert_score_to_json(result: scoring.RecordingScore) -> dict[str, Any]:
    """Return a score in the form of replay.json; None stands for a value that is not available."""
    return {
        "frames": [
            {
                "frame": pose.name,
                "m1": _convert_point(found.points[0]),
                "m2": _convert_point(found.points[1]),
            }
            for pose, found in zip(result.poses, result.markers, strict=True)
        ],
        "imaged_rcm_px": _convert_point(result.o_c),
        "imaged_rcm_condition": finite_or_none(result.condition),
        "reprojection_rms_px": dict(
            zip(("m1", "m2"), map(finite_or_none, result.reprojection), strict=True)
        ),
        "one_step_rms": {
            name: {
                "s_deg": finite_or_none(np.degrees(s)),
                "r_px": finite_or_none(r),
                "d_px": finite_or_none(d),
            }
            for name, (s, r, d) in result.one_step.items()
        },
    }


def _convert_point(point: Floats) -> Pair | None:
    return (float(point[0]), float(point[1])) if np.isfinite(point).all() else None


def format_centres_csv(result: scoring.RecordingScore) -> str:
    """Return the markers' centres as CSV; undetected markers are empty."""
    lines = ["frame,m1_u_px,m1_v_px,m2_u_px,m2_v_px"]
    for pose, found in zip(result.poses, result.markers, strict=True):
        row = [f"{n:.3f}" if np.isfinite(n) else "" for n in found.points.ravel()]
        lines.append(",".join([pose.name, *row]))
    return "\n".join(lines) + "\n"


def print_score(console: Console, result: scoring.RecordingScore) -> None:
    """Print a score in words, and the one-step errors as a table."""
    found = [[np.isfinite(m).all() for m in markers.points] for markers in result.markers]
    m1, m2 = (sum(column) for column in zip(*found, strict=True)) if found else (0, 0)
    rms_1, rms_2 = (format_quantity(finite_or_none(rms), "px", 2) for rms in result.reprojection)
    lines = [
        f"{len(found)} frames, marker 1 found in {m1}, marker 2 in {m2}",
        f"imaged RCM{_describe_imaged_rcm(result)}",
        f"reprojection: marker 1 {rms_1}, marker 2 {rms_2} rms",
    ]
    for line in lines:
        console.print(line, soft_wrap=True)
    table = Table("one-step prediction, rms", "s [°]", "r [px]", "d [px]")
    for name, (s, r, d) in result.one_step.items():
        table.add_row(
            name,
            *(format_quantity(finite_or_none(value), "", 2) for value in (np.degrees(s), r, d)),
        )
    console.print(table)


def _describe_imaged_rcm(result: scoring.RecordingScore) -> str:
    o_c, condition = result.o_c, result.condition
    if not (np.isfinite(o_c).all() and np.isfinite(condition)):
        return ": not observable, because the imaged tool rotates too little"
    return f" ({o_c[0]:.1f}, {o_c[1]:.1f}) px, condition number {condition:.0f}"
