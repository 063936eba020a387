"""A simulated run as it is told: while it goes, and its result as a table."""

import math
from collections.abc import Iterator

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.text import Text

from rcmservo.app.simulated_run.metrics import RunMetrics
from rcmservo.app.terminal import result_table, unit
from rcmservo.guard.causes import Action, Cause
from rcmservo.guard.states import Phase
from rcmservo.loop.tick import Tick


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


def show_run(console: Console, metrics: RunMetrics) -> None:
    """The result of a simulated run, and where its files are."""
    table = result_table(metrics.settled, metrics.cause)
    table.add_row("settle time", unit(metrics.settle_time_s, "s", 2))
    table.add_row("feature error (rms, last second)", _feature_error(metrics))
    table.add_row(
        "pose error ‖p₂ − p_d‖ (simulation's truth)", unit(metrics.pose_error_mm, "mm", 3)
    )
    explore, jacobian = metrics.explore, metrics.jacobian_error
    table.add_row(
        "exploration",
        f"{unit(explore.time_s, 's', 2)}, path {unit(explore.path_mm, 'mm', 1)}, "
        f"at most {unit(explore.max_excursion_mm, 'mm', 1)} from the start",
    )
    table.add_row(
        "‖Ĵ − J‖/‖J‖ (scaled)",
        f"{unit(jacobian.explored, 'after exploration', 3)}, "
        f"{unit(jacobian.final, 'at the end', 3)}",
    )
    for title, words in _remarks(metrics):
        if words:
            table.add_row(title, words)
    table.add_row("speed", f"{metrics.real_time_factor:.1f} x real time")
    console.print(table)
    console.print(f"files in {metrics.folder}", soft_wrap=True)


def _feature_error(metrics: RunMetrics) -> str:
    error = metrics.feature_error
    s = None if error.s_rad is None else math.degrees(error.s_rad)
    return f"s {unit(s, '°', 3)}, r {unit(error.r_px, 'px', 2)}, d {unit(error.d_px, 'px', 2)}"


def _remarks(metrics: RunMetrics) -> Iterator[tuple[str, str]]:
    """What is told of some runs only: a title, and words that are empty where there is nothing."""
    given = metrics.estimator_time_per_frame_s
    yield "estimator's own time", f"{given:g} s for every frame, not real time" if given else ""
    yield "at the end", metrics.remark
    yield "the person", _person(metrics)
    yield "not recorded", metrics.not_recorded
    yield "not filmed", metrics.not_filmed
    yield "not written", metrics.not_written
    median, p99 = metrics.latency_s.median, metrics.latency_s.p99
    if median is not None and p99 is not None:
        spread = f"{1e3 * median:.0f} ms median, {1e3 * p99:.0f} ms p99"
        yield "latency, exposure to command", f"{spread}; {metrics.late_ticks} late ticks"


def _person(metrics: RunMetrics) -> str:
    if not (metrics.resumed or metrics.refused or metrics.shown_again):
        return ""
    refused = f" (refused {metrics.refused} x)" if metrics.refused else ""
    return f"resumed {metrics.resumed} x{refused}, showed the target again {metrics.shown_again} x"
