"""What came of scoring a recording: as JSON, as a table of centres, and in words."""

from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.table import Table

from rcmservo.app.terminal import unit
from rcmservo.interfaces import Floats
from rcmservo.offline import score

Pair = tuple[float, float]


@dataclass(frozen=True)
class FrameReport:
    """Where the markers' centres are in a frame."""

    frame: str
    """The frame's name."""
    m1: Pair | None
    """(u, v) px of the marker nearer the RCM; None where it was not found."""
    m2: Pair | None
    """(u, v) px of the marker nearer the tip; None where it was not found."""


@dataclass(frozen=True)
class MarkerErrors:
    """A root mean square for each marker, px; None where there is no fit."""

    m1: float | None
    """Of the marker nearer the RCM."""
    m2: float | None
    """Of the marker nearer the tip."""


@dataclass(frozen=True)
class StepErrors:
    """The root mean square error of predicting one step; None where none could be predicted."""

    s_deg: float | None
    """Of s, the imaged tool's angle, in degrees."""
    r_px: float | None
    """Of r, marker 1's distance from the imaged RCM."""
    d_px: float | None
    """Of d, the imaged markers' distance from each other."""


@dataclass(frozen=True)
class ScoreReport:
    """A scored recording: what replay.json holds, by the same names."""

    frames: list[FrameReport]
    """All of the recording in their order, also those in which no marker was found."""
    imaged_rcm_px: Pair | None
    """o_c; None where it was not observable."""
    imaged_rcm_condition: float | None
    """Condition number of (16); None where (16) is singular."""
    reprojection_rms_px: MarkerErrors
    """The error of the final fit."""
    one_step_rms: dict[str, StepErrors]
    """By the way of predicting."""


def report_of(result: score.Replay) -> ScoreReport:
    """A score as plain numbers."""
    return ScoreReport(
        [
            FrameReport(pose.name, _pair(found.points[0]), _pair(found.points[1]))
            for pose, found in zip(result.poses, result.markers, strict=True)
        ],
        _pair(result.o_c),
        _finite(result.condition),
        MarkerErrors(*map(_finite, result.reprojection)),
        {
            name: StepErrors(_finite(np.degrees(s)), _finite(r), _finite(d))
            for name, (s, r, d) in result.one_step.items()
        },
    )


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _pair(point: Floats) -> Pair | None:
    return (float(point[0]), float(point[1])) if np.isfinite(point).all() else None


def centres(report: ScoreReport) -> str:
    """The markers' centres as CSV; what was not found is left empty."""
    lines = ["frame,m1_u_px,m1_v_px,m2_u_px,m2_v_px"]
    for row in report.frames:
        numbers = [f"{n:.3f}" for n in row.m1] if row.m1 else ["", ""]
        numbers += [f"{n:.3f}" for n in row.m2] if row.m2 else ["", ""]
        lines.append(",".join([row.frame, *numbers]))
    return "\n".join(lines) + "\n"


def show_report(console: Console, report: ScoreReport) -> None:
    """The score in words, and the one-step errors as a table."""
    found = [sum(row.m1 is not None for row in report.frames)]
    found += [sum(row.m2 is not None for row in report.frames)]
    count, rms = len(report.frames), report.reprojection_rms_px
    lines = [
        f"{count} frames, marker 1 found in {found[0]}, marker 2 in {found[1]}",
        f"imaged RCM{_imaged_rcm(report)}",
        f"reprojection: marker 1 {unit(rms.m1, 'px', 2)}, marker 2 {unit(rms.m2, 'px', 2)} rms",
    ]
    for line in lines:
        console.print(line, soft_wrap=True)
    table = Table("one-step prediction, rms", "s [°]", "r [px]", "d [px]")
    for name, row in report.one_step_rms.items():
        table.add_row(name, *(unit(value, "", 2) for value in (row.s_deg, row.r_px, row.d_px)))
    console.print(table)


def _imaged_rcm(report: ScoreReport) -> str:
    place, condition = report.imaged_rcm_px, report.imaged_rcm_condition
    if place is None or condition is None:
        return ": not observable, the imaged tool turned too little"
    return f" ({place[0]:.1f}, {place[1]:.1f}) px, condition number {condition:.0f}"
