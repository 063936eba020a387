"""Progress of a simulated run."""

import numpy as np
from rich.live import Live
from rich.text import Text

from rcmservo.loop.tick import Tick
from rcmservo.safety.causes import Action, Cause
from rcmservo.safety.state_machine import Phase


class RunProgress:
    """Progress of a run: a status line, and a printed line whenever a stop begins or ends."""

    def __init__(self, live: Live, duration: float) -> None:
        self._live, self._duration = live, duration
        self._mode: tuple[Phase, Cause] | None = None

    def __call__(self, tick: Tick) -> None:
        state = tick.state
        if (state.phase, state.cause) != self._mode:
            stops = state.cause.action >= Action.HOLD
            if stops or (self._mode is not None and self._mode[1].action >= Action.HOLD):
                self._live.console.print(
                    f"{tick.time * 1e-9:6.2f} s  {state.text}", soft_wrap=True, highlight=False
                )
            self._mode = state.phase, state.cause
        self._live.update(_status(tick, self._duration), refresh=False)


def _status(tick: Tick, duration: float) -> Text:
    """Return the status line of a tick."""
    state = tick.state
    line = f"{tick.time * 1e-9:6.2f} / {duration:g} s  {state.phase.value:<14}"
    if state.cause is not Cause.NONE:
        return Text(f"{line}  {state.cause.value}")
    if np.isfinite(state.delta).all():
        s, r, d = np.degrees(state.delta[0]), state.delta[1], state.delta[2]
        line += f"  Δs {s:+7.2f}°  Δr {r:+7.2f} px  Δd {d:+7.2f} px  cond {state.condition:5.1f}"
    return Text(line)
