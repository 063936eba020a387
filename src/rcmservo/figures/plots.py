"""Figures of a recorded run: feature errors, phases, path and estimate.

Symbols are those of the paper: s, r, d are the angle and the two distances of the imaged tool, p₁
the position of marker 1, m₁ and m₂ the imaged markers, Ĵ the estimated Jacobian.
"""

from textwrap import fill

import numpy as np
from numpy.typing import NDArray

from rcmservo.figures.charts import Bar, Figure, Lane, Panel, make_curve
from rcmservo.interfaces import Floats
from rcmservo.recording.outcome import SETTLED_TOLERANCE
from rcmservo.recording.reader import Record
from rcmservo.recording.timeline import Span, compute_distances, find_taught_position, list_spans
from rcmservo.safety.causes import Action, Cause
from rcmservo.safety.state_machine import Phase, Request

DISPLAY_UNITS = np.array([180.0 / np.pi, 1.0, 1.0])
"""Factors that convert (s, r, d) from rad, px, px to deg, px, px."""
TIME_LABEL = "time [s] (shaded: exploration)"
ERROR_LABELS = ("$|\\Delta s|$ [deg]", "$|\\Delta r|$ [px]", "$|\\Delta d|$ [px]")
MIN_PLOTTED_ERROR = 1e-3
"""Lower end of the logarithmic error axes. Smaller errors are drawn there."""

ERROR_SYMBOLS = ("$|\\Delta s|$", "$|\\Delta r|$", "$|\\Delta d|$")
CAUSE_LABEL_WIDTH = 48
"""Largest number of characters in a line of a cause's label."""

PHASE_TONES = {
    Phase.DISABLED: 0,
    Phase.IDLE: 1,
    Phase.ACQUIRE: 2,
    Phase.SERVO: 3,
    Phase.HOLD: 4,
    Phase.PAUSED: 5,
    Phase.JOG: 7,
    Phase.FAULT: 6,
}
"""Tone of each phase, an index in `charts.TONES`."""
ACTION_TONES = {
    Action.NONE: 0,
    Action.WARN: 0,
    Action.SLOW: 2,
    Action.HOLD: 4,
    Action.PAUSE: 5,
    Action.FAULT: 6,
}
"""Tone of a cause, by the action that it requests."""


def plot_errors(record: Record) -> Figure:
    """Return |Δs|, |Δr| and |Δd| over time, with tolerances and exploration: Fig. 9 and 10."""
    deltas = np.maximum(np.abs(record.ticks["delta"]) * DISPLAY_UNITS, MIN_PLOTTED_ERROR)
    panels = [
        Panel(
            TIME_LABEL,
            name,
            [make_curve("", record.time, deltas[:, i])],
            levels=[("tolerance", float(SETTLED_TOLERANCE[i] * DISPLAY_UNITS[i]))],
            shaded=find_exploration_spans(record),
            log_y=True,
        )
        for i, name in enumerate(ERROR_LABELS)
    ]
    return Figure(f"Feature errors (values below {MIN_PLOTTED_ERROR} are drawn there)", panels)


def plot_distance(record: Record) -> Figure:
    """Return the distance (mm) of marker 2 from the taught pose over time.

    It is shown by the image (Ĵ⁻¹ Δy) and by the joints.
    """
    by_image, by_joints = compute_distances(record)
    curves = [
        make_curve("by the image", record.time, np.maximum(by_image, MIN_PLOTTED_ERROR), 0),
        make_curve("by the joints", record.time, np.maximum(by_joints, MIN_PLOTTED_ERROR), 1),
    ]
    panel = Panel(
        TIME_LABEL,
        "marker 2 to target [mm]",
        curves,
        shaded=find_exploration_spans(record),
        log_y=True,
    )
    return Figure("Distance from the taught pose", [panel])


def plot_timeline(record: Record) -> Figure:
    """Return the phases as bands behind the errors, and a row for each cause.

    The errors are divided by their tolerances.
    """
    spans = list_spans(record)
    ratios = np.maximum(np.abs(record.ticks["delta"]) / SETTLED_TOLERANCE, MIN_PLOTTED_ERROR)
    errors = Panel(
        "time [s]",
        f"error / tolerance, ≥ {MIN_PLOTTED_ERROR}",
        [make_curve(name, record.time, ratios[:, i], i) for i, name in enumerate(ERROR_SYMBOLS)],
        levels=[("tolerance", 1.0)],
        log_y=True,
        bands=[Bar(span.start, span.end, PHASE_TONES[span.phase]) for span in spans],
    )
    groups = _list_phase_lanes(spans), _list_cause_lanes(spans) + _list_request_lanes(spans)
    lanes = [Panel("time [s]", "", [], lanes=group) for group in groups if group]
    return Figure("Phases and causes", [errors, *lanes])


def _list_phase_lanes(spans: list[Span]) -> list[Lane]:
    """Return one row for each phase that occurred."""
    lanes: list[Lane] = []
    for phase, tone in PHASE_TONES.items():
        bars = [Bar(s.start, s.end, tone) for s in spans if s.phase is phase]
        if bars:
            lanes.append(Lane(phase.value, bars))
    return lanes


def _list_cause_lanes(spans: list[Span]) -> list[Lane]:
    """Return one row for each cause that occurred."""
    lanes: list[Lane] = []
    for cause in Cause:
        bars = [Bar(s.start, s.end, ACTION_TONES[s.action]) for s in spans if s.cause is cause]
        if bars and cause is not Cause.NONE:
            lanes.append(Lane(fill(cause.value, CAUSE_LABEL_WIDTH), bars))
    return lanes


def _list_request_lanes(spans: list[Span]) -> list[Lane]:
    """Return a row with the operator's requests, if there are any."""
    requests = [Bar(s.start, s.start, 0) for s in spans if s.request is not Request.NONE]
    return [Lane("operator requests: pause, resume, clear, jog", requests)] if requests else []


def plot_path(record: Record) -> Figure:
    """Return the path of marker 1 in two views of space, and of both markers in the image.

    The target is marked in each panel.
    """
    panels = [_plot_space(record, 0, 1), _plot_space(record, 0, 2), _plot_image(record)]
    return Figure("Path", panels, columns=3)


def _plot_space(record: Record, i: int, j: int) -> Panel:
    """Return p₁ along the axes with the indices i and j of x, y, z."""
    p1, target = record.ticks["p1"][:, [i, j]].T, find_taught_position(record)
    is_exploring = record.ticks["explored"][:, 0] == 0
    curves = [
        make_curve("exploration", *np.where(is_exploring, p1, np.nan), style=1),
        make_curve("servoing", *np.where(is_exploring, np.nan, p1)),
    ]
    if target is not None:
        curves.append(make_curve("target", [target[i]], [target[j]], style=3, marks=True))
    names = "xyz"
    return Panel(f"${names[i]}$ of $\\mathbf{{p}}_1$ [mm]", f"${names[j]}$ [mm]", curves, map=True)


def _plot_image(record: Record) -> Panel:
    """Return m₁ and m₂ in pixels."""
    points = record.ticks["points"][record.new_frames()]
    curves = [
        make_curve("$\\mathbf{m}_1$", points[:, 0], points[:, 1]),
        make_curve("$\\mathbf{m}_2$", points[:, 2], points[:, 3], style=2),
    ]
    if record.stages:
        target = record.stages[-1].target.points
        curves.append(make_curve("target", target[:, 0], target[:, 1], style=3, marks=True))
    return Panel("$u$ [px]", "$v$ [px]", curves, map=True, downward=True)


def plot_estimate(record: Record) -> Figure:
    """Return the estimate and the measurement over time.

    For an estimator with a projection model these are π, eq. (34), and m₁, as in Fig. 11; for any
    other ω = Ĵ ṗ₁, eq. (35), and ẏ, as in Fig. 12.
    """
    has_model = np.isfinite(record.ticks["model"]).any()
    return plot_projection(record) if has_model else plot_flow(record)


def plot_projection(record: Record, since: float = 0.0) -> Figure:
    """Return the measured m₁ and the estimate π (34), both relative to o_c: Fig. 11.

    Time starts at `since` (s).
    """
    new = record.new_frames(since)
    m1 = record.ticks["points"][new, :2] - record.ticks["o_c"][new]
    names = ("$u_1, \\pi_u$ [px]", "$v_1, \\pi_v$ [px]")
    legend = "measured $\\mathbf{m}_1$", "estimate $\\mathbf{\\pi}$ (34)"
    pi, title = record.ticks["model"][new, :2], "Projection model"
    return _plot_comparison(title, record, new, m1, pi, names, legend, since)


def plot_flow(record: Record) -> Figure:
    """Return the measured ẏ and the estimate ω = Ĵ ṗ₁ (35): Fig. 12."""
    new = record.new_frames()
    y_dot, omega = compute_flows(record, new)
    y_dot, omega = y_dot * DISPLAY_UNITS, omega * DISPLAY_UNITS
    symbols = ("s", "deg/s"), ("r", "px/s"), ("d", "px/s")
    names = tuple(f"$\\dot {y}, \\omega_{i}$ [{unit}]" for i, (y, unit) in enumerate(symbols, 1))
    legend = "measured $\\dot{\\mathbf{y}}$", "estimate $\\mathbf{\\omega}$ (35)"
    return _plot_comparison("Output flow", record, new[1:], y_dot, omega, names, legend)


def compute_flows(record: Record, new: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Return ẏ by differences between new frames, and ω = Ĵ ṗ₁ with the Ĵ before each of them.

    Parameters
    ----------
    record : Record
        Recorded run.
    new : array (N,)
        Rows of ticks with a new frame.

    Returns
    -------
    y_dot, omega : array (N - 1, 3)
        Measured and estimated rates of (s, r, d) in rad/s, px/s and px/s.
    """
    dt = np.diff(record.ticks["exposure"][new], axis=0) * 1e-9
    delta_y = np.diff(record.ticks["y"][new], axis=0)
    delta_y[:, 0] = (delta_y[:, 0] + np.pi) % (2.0 * np.pi) - np.pi  # the shorter way round
    J_hat = record.ticks["J_hat"][new][:-1].reshape(-1, 3, 3)
    p_dot = np.diff(record.ticks["p1"][new], axis=0) / dt
    return delta_y / dt, np.einsum("nij,nj->ni", J_hat, p_dot)


def find_exploration_spans(record: Record) -> list[tuple[float, float]]:
    """Return the time spans (s) of exploration, from ACQUIRE to a sufficient estimate."""
    is_acquiring = np.array([phase == Phase.ACQUIRE.name for phase in record.phase], dtype=bool)
    is_exploring = is_acquiring & (record.ticks["explored"][:, 0] == 0)
    rows = np.flatnonzero(np.diff(is_exploring, prepend=False, append=False))
    times: list[float] = record.time[np.minimum(rows, len(record.time) - 1)].tolist()
    return list(zip(times[::2], times[1::2], strict=True))


def _plot_comparison(
    title: str,
    record: Record,
    rows: NDArray[np.intp],
    measured: Floats,
    estimated: Floats,
    names: tuple[str, ...],
    legend: tuple[str, str],
    since: float = 0.0,
) -> Figure:
    panels: list[Panel] = []
    time, shaded = record.time[rows] - since, [] if since else find_exploration_spans(record)
    for i, name in enumerate(names):
        finite = measured[np.isfinite(measured[:, i]), i]
        low, high = np.percentile(finite, [0.5, 99.5]) if len(finite) else (0.0, 0.0)
        margin = 0.15 * max(high - low, 1e-6)
        labels = legend if i == 0 else ("", "")
        curves = [
            make_curve(labels[0], time, measured[:, i], style=-1),
            make_curve(labels[1], time, estimated[:, i], style=1),
        ]
        limits = float(low - margin), float(high + margin)
        label = TIME_LABEL if shaded else "time [s]"
        panels.append(Panel(label, name, curves, shaded=shaded, y_limits=limits))
    return Figure(title, panels)
