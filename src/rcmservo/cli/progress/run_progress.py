"""Progress of a run on the terminal: a status line, and printed lines for events.

`RunProgress` follows a simulated run tick by tick. `LiveProgress` follows a run in wall time by the
reports of its supervisor.
"""

from typing import TYPE_CHECKING

import numpy as np
from rich.live import Live
from rich.text import Text

from rcmservo.loop.pixel_precision import describe_precision
from rcmservo.safety.causes import Action, Cause
from rcmservo.safety.state_machine import Phase

if TYPE_CHECKING:
    from rcmservo.live.loop_statistics import Report
    from rcmservo.loop.tick import Tick


class RunProgress:
    """Progress of a simulated run; a line is printed whenever a stop begins or ends.

    Parameters
    ----------
    status_line : Live
        Line that is rewritten at each tick.
    duration_s : float
        Length of the run in s.
    """

    def __init__(self, status_line: Live, duration_s: float) -> None:
        self._status_line, self._duration_s = status_line, duration_s
        self._last_phase: Phase | None = None
        self._last_cause = Cause.NONE
        self._has_explored = False

    def __call__(self, tick: "Tick") -> None:
        state, time_s = tick.state, tick.time * 1e-9
        if state.explored and not self._has_explored:
            _print_event(self._status_line, time_s, describe_precision(state, tick.servo.tool))
        self._has_explored = state.explored
        if (state.phase, state.cause) != (self._last_phase, self._last_cause):
            if max(state.cause.action, self._last_cause.action) >= Action.HOLD:
                _print_event(self._status_line, time_s, state.text)
            self._last_phase, self._last_cause = state.phase, state.cause
        text = f"{time_s:6.2f} / {self._duration_s:g} s  {state.phase.value:<14}"
        if state.cause is not Cause.NONE:
            text += f"  {state.cause.value}"
        elif np.isfinite(state.delta).all():
            s_deg, r_px, d_px = np.degrees(state.delta[0]), state.delta[1], state.delta[2]
            text += f"  Δs {s_deg:+7.2f}°  Δr {r_px:+7.2f} px  Δd {d_px:+7.2f} px"
            text += f"  cond {state.condition:5.1f}"
        self._status_line.update(Text(text), refresh=False)


class LiveProgress:
    """Progress of a run in wall time; a line is printed for each new phase or cause.

    Parameters
    ----------
    status_line : Live
        Line that is rewritten at each report; the first report starts it.
    duration_s : float
        Length of the run in s.
    """

    def __init__(self, status_line: Live, duration_s: float) -> None:
        self._status_line, self._duration_s, self._last_text = status_line, duration_s, ""

    def __call__(self, report: "Report") -> None:
        self._status_line.start()
        time_s = report.time * 1e-9
        if report.text != self._last_text:
            self._last_text = report.text
            _print_event(self._status_line, time_s, report.text)
        text = f"{time_s:6.2f} / {self._duration_s:g} s  {report.text}"
        self._status_line.update(Text(text), refresh=False)


def _print_event(status_line: Live, time_s: float, text: str) -> None:
    """Print a lasting line above the status line."""
    status_line.console.print(f"{time_s:6.2f} s  {text}", soft_wrap=True, highlight=False)
