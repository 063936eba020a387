"""Judge a run by the measurements of its ticks: settled or not, when, and why not."""

from dataclasses import replace

import numpy as np

from rcmservo.interfaces import Floats, Target
from rcmservo.loop.run_result import ExplorationCost, FeatureError, RunResult, known
from rcmservo.loop.tick import Tick
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Mode, Phase
from rcmservo.servo.servo import Servo
from rcmservo.servo.user_estimator import Guard, called

TOLERANCE = np.array([np.radians(0.5), 1.0, 1.0])
"""|Δs|, |Δr|, |Δd| (rad, px, px) within which a run counts as settled."""

LAST = 1.0
"""s at the end of a run through which the errors must keep within the tolerance."""

SAME_POSE = 5.0
"""mm between the tool's end and where it was shown, by its own joints, beyond which it is another
pose."""

ON_THE_WAY = {
    Phase.DISABLED: "the arm's drive is off",
    Phase.IDLE: "time ran out before both markers were seen",
    Phase.ACQUIRE: "time ran out during exploration",
}
"""Why a run ended in a phase that nothing wrong led to."""


def held(mode: Mode, why: str) -> str:
    """Return what holds the arm still at the last tick; `why` is why the markers were never seen,
    if they never were.
    """
    if mode.cause.stopping:
        return mode.cause.describe(
            mode.detail or (why if mode.cause.declared.hides_markers else "")
        )
    return f"{ON_THE_WAY[mode.phase]}: {why}" if why and mode.phase in ON_THE_WAY else ""


def settle_time(times: Floats, errors: Floats) -> float | None:
    """Return when the errors Δy (N, 3) came within TOLERANCE for good; None if not, or for less
    than LAST s before the last of ``times`` (N,) s.
    """
    outside = np.flatnonzero(~(np.abs(errors) < TOLERANCE).all(axis=1))
    since = int(outside[-1]) + 1 if len(outside) else 0
    stayed = since < len(times) and times[-1] - times[since] >= LAST - 1e-6
    return float(times[since]) if stayed else None


class Judge:
    """Collect the ticks of a run, and judge them."""

    def __init__(self, servo: Servo, target: Target) -> None:
        self._servo, self._target = servo, target
        self._times: list[float] = []
        self._errors: list[Floats] = []
        self._explored_at: float | None = None
        self._last: Tick | None = None
        self._seen = False

    def add(self, tick: Tick) -> None:
        self._times.append(tick.time / 1e9)
        self._errors.append(tick.state.delta)
        if self._explored_at is None and tick.state.explored:
            self._explored_at = self._times[-1]
        self._seen = self._seen or tick.state.believed >= 0
        self._last, self._target = tick, tick.state.target or self._target

    @property
    def blind(self) -> Tick | None:
        """The last tick, if the markers have never been seen."""
        return None if self._seen else self._last

    @property
    def duration(self) -> float:
        """Time s of the last tick."""
        return self._times[-1] if self._times else 0.0

    def result(self) -> RunResult:
        """Return the outcome of the ticks so far."""
        if self._last is None:
            return RunResult(target_q=self._target.q.tolist())
        marker_1 = self._servo.marker_1
        apart = np.linalg.norm(marker_1(self._last.seen.q) - marker_1(self._target.q))
        times, errors = np.array(self._times), np.array(self._errors)
        result = judged(times, errors, self._explored_at, self._last.state.mode, float(apart))
        return replace(
            result,
            cause=result.cause + _slow_estimator(self._last),
            duration_s=self.duration + 1.0 / self._servo.rate,
            target_q=self._target.q.tolist(),
        )


def _slow_estimator(last: Tick) -> str:
    """Return the user's own estimator that made the loop run late, as the rest of a sentence."""
    cause, own = last.state.cause, last.servo.learner
    late = cause in (Cause.OVERRUN, Cause.DRIVE_OFF)  # the arm's watchdog may be the first to act
    if late and isinstance(own, Guard) and own.slowest > last.servo.period:
        return f": estimator {called(own.own)} took up to {own.slowest * 1e-6:.1f} ms for a frame"
    return ""


def judged(
    times: Floats, errors: Floats, explored_at: float | None, mode: Mode, apart: float
) -> RunResult:
    """Return the outcome of a run.

    Parameters
    ----------
    times : array
        Times (N,) of its ticks, s.
    errors : array
        Errors Δy (N, 3) there, rad, px, px.
    explored_at : float or None
        Time at which exploration ended, s.
    mode : Mode
        Mode of the servo at the end.
    apart : float
        Distance (mm) at the end of marker 1 from where it was taught, by the arm's own joints.
    """
    if not len(times):
        return RunResult()
    error = np.sqrt(np.mean(errors[times > times[-1] - LAST] ** 2, axis=0))
    settled_at = settle_time(times, errors)
    cause = _cause(mode, explored_at, settled_at, apart)
    return RunResult(
        settled=cause == "",
        cause=cause,
        remark="" if mode.cause.stopping else mode.cause.value,
        settle_time_s=None if cause else settled_at,
        feature_error=FeatureError(*map(known, error)),
        explore=ExplorationCost(explored_at),
    )


def _cause(mode: Mode, explored_at: float | None, settled_at: float | None, apart: float) -> str:
    if mode.cause.stopping:
        return mode.why
    if mode.phase is Phase.ACQUIRE and explored_at is not None:
        return "time ran out on the way back from a hold"
    if mode.phase in ON_THE_WAY:
        return ON_THE_WAY[mode.phase]
    if settled_at is None:
        return "time ran out before the feature errors had settled"
    if apart > SAME_POSE:
        return (
            f"the features agree, but marker 1 is {apart:.0f} mm from where it was shown: a pose "
            f"beyond the singular surface looks the same"
        )
    return ""
