"""What became of a run: settled or not, when, and why not. Judged from what the servo measured,
tick by tick."""

from dataclasses import dataclass, replace

import numpy as np

from rcmservo.guard.causes import Cause
from rcmservo.guard.states import Mode, Phase
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.tick import Tick
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
    """What holds the arm still at the last tick; `why` tells why the markers were never seen, if
    they never were."""
    if mode.cause.stopping:
        return mode.cause.describe(
            mode.detail or (why if mode.cause.declared.hides_markers else "")
        )
    return f"{ON_THE_WAY[mode.phase]}: {why}" if why and mode.phase in ON_THE_WAY else ""


@dataclass(frozen=True, eq=False)
class Outcome:
    """Whether a run settled, and if not why."""

    settled: bool
    """Whether the errors stayed small to the end, with nothing wrong then, at the pose that was
    shown."""
    cause: str
    """In words, why it did not settle; empty if it did."""
    settle_time: float | None
    """s after which the errors stayed small to the end, for LAST s or more; None if not."""
    error: Floats
    """Root mean square (3,) of Δy over the last second, rad, px, px."""
    explored_at: float | None
    """s at which exploration ended, or None."""
    remark: str = ""
    """What was not as it should be at the end although nothing stopped, in words; empty if all
    was."""


def settle_time(times: Floats, errors: Floats) -> float | None:
    """When the errors Δy (N, 3) came within TOLERANCE for good; None if not, or for less than LAST
    s before the last of ``times`` (N,) s."""
    outside = np.flatnonzero(~(np.abs(errors) < TOLERANCE).all(axis=1))
    since = int(outside[-1]) + 1 if len(outside) else 0
    stayed = since < len(times) and times[-1] - times[since] >= LAST - 1e-6
    return float(times[since]) if stayed else None


class Judge:
    """Collects what an outcome needs, one tick at a time."""

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

    def outcome(self) -> Outcome:
        """The verdict on the ticks so far."""
        if self._last is None:
            return judged(np.empty(0), np.empty((0, 3)), self._explored_at, Mode(), 0.0)
        away = float(
            np.linalg.norm(
                self._servo.marker_1(self._last.seen.q) - self._servo.marker_1(self._target.q)
            )
        )
        times, errors = np.array(self._times), np.array(self._errors)
        outcome = judged(times, errors, self._explored_at, self._last.state.mode, away)
        return replace(outcome, cause=outcome.cause + _blame(self._last))


def _blame(last: Tick) -> str:
    """The user's own estimator that made the loop run late, as the rest of a sentence; empty where
    none did."""
    cause, own = last.state.cause, last.servo.learner
    late = cause in (Cause.OVERRUN, Cause.DRIVE_OFF)  # the arm's watchdog may be the first to act
    if late and isinstance(own, Guard) and own.slowest > last.servo.period:
        return f": estimator {called(own.own)} took up to {own.slowest * 1e-6:.1f} ms for a frame"
    return ""


def judged(
    times: Floats, errors: Floats, explored_at: float | None, mode: Mode, away: float
) -> Outcome:
    """The verdict on a run: its ticks' ``times`` (N,) s and ``errors`` Δy (N, 3), and at its end
    the servo's mode and how many mm marker 1 is ``away`` from where it was shown, by its own
    joints."""
    if not len(times):
        return Outcome(
            False, "the run was stopped before its first tick", None, np.full(3, np.nan), None
        )
    error = np.sqrt(np.mean(errors[times > times[-1] - LAST] ** 2, axis=0))
    settled_at = settle_time(times, errors)
    cause = _cause(mode, explored_at, settled_at, away)
    remark = "" if mode.cause.stopping else mode.cause.value
    return Outcome(cause == "", cause, settled_at, error, explored_at, remark)


def _cause(mode: Mode, explored_at: float | None, settled_at: float | None, away: float) -> str:
    if mode.cause.stopping:
        return mode.why
    if mode.phase is Phase.ACQUIRE and explored_at is not None:
        return "time ran out on the way back from a hold"
    if mode.phase in ON_THE_WAY:
        return ON_THE_WAY[mode.phase]
    if settled_at is None:
        return "time ran out before the feature errors had settled"
    if away > SAME_POSE:
        return (
            f"the features agree, but marker 1 is {away:.0f} mm from where it was shown: a pose "
            f"beyond the "
            "singular surface looks the same"
        )
    return ""
