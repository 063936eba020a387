"""What became of a run: settled or not, when, and why not. Judged from what the servo measured, tick by tick."""

from dataclasses import dataclass

import numpy as np

from rcmservo.loop import Tick
from rcmservo.plant import Floats, Target
from rcmservo.servo import Servo
from rcmservo.states import Cause, Phase

TOLERANCE = np.array([np.radians(0.5), 1.0, 1.0])
"""|Δs|, |Δr|, |Δd| (rad, px, px) within which a run counts as settled."""

LAST = 1.0
"""s at the end of a run through which the errors must keep within the tolerance."""

SAME_POSE = 5.0
"""mm between the tool's end and where it was shown, by its own joints, beyond which it is another pose."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """``settled``, or the ``cause`` in words why not; ``settle_time`` s after which the errors stayed small, or None.

    ``error`` (3,) rad, px, px is the root mean square of Δy over the last second. ``explored_at`` is the time s at
    which exploration ended, or None.
    """

    settled: bool
    cause: str
    settle_time: float | None
    error: Floats
    explored_at: float | None


class Judge:
    """Collects what an outcome needs, one tick at a time."""

    def __init__(self, servo: Servo, target: Target) -> None:
        self._servo, self._target = servo, target
        self._times: list[float] = []
        self._errors: list[Floats] = []
        self._explored_at: float | None = None
        self._last: Tick | None = None

    def add(self, tick: Tick) -> None:
        self._times.append(tick.time / 1e9)
        self._errors.append(tick.state.delta)
        if self._explored_at is None and tick.state.explored:
            self._explored_at = self._times[-1]
        self._last = tick

    @property
    def duration(self) -> float:
        """Time s of the last tick."""
        return self._times[-1] if self._times else 0.0

    def outcome(self) -> Outcome:
        """The verdict on the ticks so far."""
        if self._last is None:
            return Outcome(False, "the run was stopped before its first tick", None, np.full(3, np.nan), None)
        last = np.array(self._errors)[np.array(self._times) > self._times[-1] - LAST]
        error = np.sqrt(np.mean(last**2, axis=0))
        settle_time = self._settle_time()
        cause = self._cause(settle_time)
        return Outcome(cause == "", cause, settle_time, error, self._explored_at)

    def _settle_time(self) -> float | None:
        """When the errors last came within the tolerance, to stay; None if they are outside now."""
        good = [bool(np.all(np.abs(error) < TOLERANCE)) for error in self._errors]
        if not good[-1]:
            return None
        since = len(good) - good[::-1].index(False) if False in good else 0
        return self._times[since]

    def _cause(self, settle_time: float | None) -> str:
        assert self._last is not None
        state = self._last.state
        if state.cause is not Cause.NONE:
            return state.cause.words
        if state.phase is not Phase.SERVO:
            return "time ran out during exploration"
        if settle_time is None or self._times[-1] - settle_time < LAST - 1e-6:
            return "time ran out before the feature errors had settled"
        away = float(np.linalg.norm(self._servo.marker_1(self._last.seen.q) - self._servo.marker_1(self._target.q)))
        if away > SAME_POSE:
            return (
                f"the features agree, but marker 1 is {away:.0f} mm from where it was shown: a pose beyond the "
                "singular surface looks the same"
            )
        return ""
