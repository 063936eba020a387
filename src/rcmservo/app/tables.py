"""What the commands print: a run as it goes, and its results as tables."""

from typing import Any

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from rcmservo.guard.states import Action, Cause, Phase
from rcmservo.loop.run import Tick
from rcmservo.record.recompute import Rerun


class Story:
    """Shows how a run goes: a live line, and a lasting one for every stop and every way out of
    one."""

    def __init__(self, live: Live, duration: float) -> None:
        self._live, self._duration = live, duration
        self._mode: tuple[Phase, Cause] | None = None

    def __call__(self, tick: Tick) -> None:
        state = tick.state
        if (state.phase, state.cause) != self._mode:
            stops = state.cause.action >= Action.HOLD
            if stops or (self._mode is not None and self._mode[1].action >= Action.HOLD):
                self._live.console.print(
                    f"{tick.time * 1e-9:6.2f} s  {state.words}", soft_wrap=True, highlight=False
                )
            self._mode = state.phase, state.cause
        self._live.update(_line(tick, self._duration), refresh=False)


def _line(tick: Tick, duration: float) -> Text:
    """The live line of progress."""
    state = tick.state
    line = f"{tick.time * 1e-9:6.2f} / {duration:g} s  {state.phase.value:<14}"
    if state.cause is not Cause.NONE:
        return Text(f"{line}  {state.cause.value}")
    if np.isfinite(state.delta).all():
        s, r, d = np.degrees(state.delta[0]), state.delta[1], state.delta[2]
        line += f"  Δs {s:+7.2f}°  Δr {r:+7.2f} px  Δd {d:+7.2f} px  cond {state.condition:5.1f}"
    return Text(line)


def show_run(console: Console, metrics: dict[str, Any]) -> None:
    error, explore, jacobian = (
        metrics["feature_error"],
        metrics["explore"],
        metrics["jacobian_error"],
    )
    table = Table(title="settled" if metrics["settled"] else "not settled", show_header=False)
    if metrics["cause"]:
        table.add_row("cause", metrics["cause"])
    table.add_row("settle time", _unit(metrics["settle_time_s"], "s", 2))
    angle = None if error["s_rad"] is None else np.degrees(error["s_rad"])
    table.add_row(
        "feature error (rms, last second)",
        f"s {_unit(angle, '°', 3)}, r {_unit(error['r_px'], 'px', 2)}, d "
        f"{_unit(error['d_px'], 'px', 2)}",
    )
    table.add_row(
        "pose error ‖p₂ − p_d‖ (simulation's truth)", _unit(metrics["pose_error_mm"], "mm", 3)
    )
    table.add_row(
        "exploration",
        f"{_unit(explore['time_s'], 's', 2)}, path {_unit(explore['path_mm'], 'mm', 1)}, "
        f"at most {_unit(explore['max_excursion_mm'], 'mm', 1)} from the start",
    )
    table.add_row(
        "‖Ĵ − J‖/‖J‖ (scaled)",
        f"{_unit(jacobian['explored'], 'after exploration', 3)}, "
        f"{_unit(jacobian['final'], 'at the end', 3)}",
    )
    if metrics["estimator_time_per_frame_s"]:
        table.add_row(
            "estimator's own time",
            f"{metrics['estimator_time_per_frame_s']:g} s for every frame, not real time",
        )
    if metrics["resumed"] or metrics["refused"] or metrics["shown_again"]:
        refused = f" (refused {metrics['refused']} x)" if metrics["refused"] else ""
        table.add_row(
            "the person",
            f"resumed {metrics['resumed']} x{refused}, showed the target again "
            f"{metrics['shown_again']} x",
        )
    if metrics["not_recorded"]:
        table.add_row("not recorded", metrics["not_recorded"])
    if metrics["not_filmed"]:
        table.add_row("not filmed", metrics["not_filmed"])
    latency = metrics["latency_s"]
    if latency["median"] is not None:
        spread = f"{1e3 * latency['median']:.0f} ms median, {1e3 * latency['p99']:.0f} ms p99"
        table.add_row(
            "latency, exposure to command", f"{spread}; {metrics['late_ticks']} late ticks"
        )
    table.add_row("speed", f"{metrics['real_time_factor']:.1f} x real time")
    table.add_row("files", str(metrics["folder"]))
    console.print(table)


def _unit(value: float | None, unit: str, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f} {unit}"


def show_claims(console: Console, rows: list[dict[str, Any]], every: bool) -> None:
    """Every claim of one experiment, or how many of each experiment hold."""
    verdicts = ("holds", "holds with a remark", "does not hold")
    table = (
        Table("claim", "where", "measured", "verdict") if every else Table("experiment", *verdicts)
    )
    if every:
        for row in rows:
            number = "–" if row["measured"] is None else f"{row['measured']:.3g} {row['unit']}"
            table.add_row(row["claim"], row["where"], number, row["verdict"])
    else:
        for name in dict.fromkeys(row["experiment"] for row in rows):
            found = [row["verdict"] for row in rows if row["experiment"] == name]
            table.add_row(name, *(str(found.count(verdict)) for verdict in verdicts))
    console.print(table)


def show_differences(console: Console, again: Rerun) -> None:
    """What the other settings would have made of what was seen."""
    then, now = again.then, again.now
    table = Table("", "as recorded", "with these settings")
    speeds = [np.median(np.linalg.norm(rows.ticks["v"], axis=1)) for rows in (then, now)]
    table.add_row("wanted speed of marker 1, median", *(f"{speed:.2f} mm/s" for speed in speeds))
    for name in dict.fromkeys((*then.phase, *now.phase)):
        counts = [rows.phase.count(name) for rows in (then, now)]
        table.add_row(f"ticks in {name}", *map(str, counts))
    apart = np.linalg.norm(then.ticks["v"] - now.ticks["v"], axis=1)
    table.add_row("the wanted velocities differ by, median", "", f"{np.median(apart):.2f} mm/s")
    console.print(table)


def show_replay(console: Console, report: dict[str, Any]) -> None:
    rows = report["frames"]
    found = [sum(row[name] is not None for row in rows) for name in ("m1", "m2")]
    centre, rms = report["imaged_rcm_px"], report["reprojection_rms_px"]
    console.print(f"{len(rows)} frames, marker 1 found in {found[0]}, marker 2 in {found[1]}")
    if centre is None:
        console.print("imaged RCM: not observable, the imaged tool turned too little")
    else:
        condition = report["imaged_rcm_condition"]
        console.print(
            f"imaged RCM ({centre[0]:.1f}, {centre[1]:.1f}) px, condition number {condition:.0f}"
        )
    console.print(
        f"reprojection: marker 1 {_unit(rms['m1'], 'px', 2)}, marker 2 "
        f"{_unit(rms['m2'], 'px', 2)} rms"
    )
    table = Table("one-step prediction, rms", "s [°]", "r [px]", "d [px]")
    for name, row in report["one_step_rms"].items():
        table.add_row(name, *(_unit(row[key], "", 2) for key in ("s_deg", "r_px", "d_px")))
    console.print(table)
