"""Figures from a record, with the paper's symbols: the errors over time, and the estimate beside the measurement."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from rcmservo.outcome import TOLERANCE
from rcmservo.plant import Floats
from rcmservo.record import Record

BLUE, ORANGE, GREY = "#0072b2", "#d55e00", "#888888"
DEGREES = np.array([180.0 / np.pi, 1.0, 1.0])
STYLE: Any = {
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "rcmservo",
}


def errors(record: Record, path: Path) -> None:
    """|Δs|, |Δr|, |Δd| over time on a logarithmic axis, with tolerances and exploration: Fig. 9 and 10."""
    names = ("$|\\Delta s|$ [deg]", "$|\\Delta r|$ [px]", "$|\\Delta d|$ [px]")
    deltas = np.abs(record.ticks["delta"]) * DEGREES
    with mpl.rc_context(STYLE):
        figure, axes = _rows(3, "Feature errors")
        for i, (axis, name) in enumerate(zip(axes, names, strict=True)):
            axis.semilogy(record.time, np.maximum(deltas[:, i], 1e-3), color=BLUE, lw=1.2)
            axis.axhline(TOLERANCE[i] * DEGREES[i], color=GREY, ls="--", lw=1)
            axis.set_ylabel(name)
            _mark_exploration(record, axis)
        axes[0].annotate(
            "tolerance", (1.0, TOLERANCE[0] * DEGREES[0]), xycoords=("axes fraction", "data"), ha="right", va="bottom"
        )
        _finish(figure, axes, path)


def estimate(record: Record, path: Path) -> None:
    """What the estimate says beside what was measured: m₁ and π (34), Fig. 11, or ẏ and ω = Ĵ ṗ₁ (35), Fig. 12."""
    new = np.flatnonzero(np.diff(record.ticks["frame"][:, 0], prepend=-1.0) > 0)
    if np.isfinite(record.ticks["model"]).any():
        m1 = record.ticks["points"][new, :2] - record.ticks["o_c"][new]
        _compare(
            record.time[new], m1, record.ticks["model"][new, :2], ("$u_1, \\pi_u$ [px]", "$v_1, \\pi_v$ [px]"),
            ("measured $\\mathbf{m}_1$", "estimate $\\mathbf{\\pi}$ (34)"), "Projection model", record, path,
        )  # fmt: skip
        return
    y_dot, omega = flows(record, new)
    _compare(
        record.time[new][1:], y_dot * DEGREES, omega * DEGREES,
        ("$\\dot s, \\omega_1$ [deg/s]", "$\\dot r, \\omega_2$ [px/s]", "$\\dot d, \\omega_3$ [px/s]"),
        ("measured $\\dot{\\mathbf{y}}$", "estimate $\\mathbf{\\omega}$ (35)"), "Output flow", record, path,
    )  # fmt: skip


def flows(record: Record, new: Any) -> tuple[Floats, Floats]:
    """ẏ by differences between new frames, and ω = Ĵ ṗ₁ with the Ĵ before each: both (N - 1, 3) rad/s, px/s, px/s."""
    dt = np.diff(record.ticks["exposure"][new], axis=0) * 1e-9
    steps = np.diff(record.ticks["y"][new], axis=0)
    steps[:, 0] = (steps[:, 0] + np.pi) % (2.0 * np.pi) - np.pi
    J_hat = record.ticks["J_hat"][new][:-1].reshape(-1, 3, 3)
    p_dot = np.diff(record.ticks["p1"][new], axis=0) / dt
    return steps / dt, np.einsum("nij,nj->ni", J_hat, p_dot)


def _compare(
    time: Floats, measured: Floats, estimated: Floats, names: tuple[str, ...], legend: tuple[str, str], title: str,
    record: Record, path: Path,
) -> None:  # fmt: skip
    with mpl.rc_context(STYLE):
        figure, axes = _rows(len(names), title)
        for i, (axis, name) in enumerate(zip(axes, names, strict=True)):
            axis.plot(time, measured[:, i], color=GREY, lw=2.5, label=legend[0])
            axis.plot(time, estimated[:, i], color=ORANGE, lw=1, ls="--", label=legend[1])
            low, high = np.nanpercentile(measured[:, i], [0.5, 99.5])
            margin = 0.15 * max(high - low, 1e-6)
            axis.set_ylim(low - margin, high + margin)
            axis.set_ylabel(name)
            _mark_exploration(record, axis)
        axes[0].legend(loc="upper right", framealpha=0.9)
        _finish(figure, axes, path)


def _rows(count: int, title: str) -> tuple[Figure, list[Any]]:
    figure = Figure(figsize=(7.0, 1.2 + 1.6 * count), layout="constrained")
    figure.suptitle(title)
    axes = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    return figure, list(axes)


def _mark_exploration(record: Record, axis: Any) -> None:
    exploring = record.time[[phase in ("IDLE", "ACQUIRE") for phase in record.phase]]
    if len(exploring):
        axis.axvspan(exploring[0], exploring[-1], color=ORANGE, alpha=0.15, lw=0)


def _finish(figure: Figure, axes: list[Any], path: Path) -> None:
    axes[-1].set_xlabel("time [s] (shaded: exploration)")
    figure.savefig(path, dpi=130)
