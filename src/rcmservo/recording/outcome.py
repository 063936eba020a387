"""Outcome of a run from its ticks: settled or not, with time and cause."""

from dataclasses import replace

import numpy as np

from rcmservo.interfaces import Floats, Target
from rcmservo.loop.run_result import ExplorationCost, FeatureError, RunResult, finite_or_none
from rcmservo.loop.tick import Tick
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Mode, Phase
from rcmservo.servo.servo import Servo
from rcmservo.servo.user_estimator import EstimatorGuard, class_path_of

SETTLED_TOLERANCE = np.array([np.radians(0.5), 1.0, 1.0])
"""Largest |Δs|, |Δr|, |Δd| (rad, px, px) at which a run counts as settled."""

SETTLED_DURATION_S = 1.0
"""Time (s) at the end of a run in which the errors must stay within the tolerance."""

MAX_SAME_POSE_DISTANCE_MM = 5.0
"""Largest distance (mm) of marker 1 from its taught position, by the joints, at which the pose
counts as the taught one."""

UNFINISHED_CAUSES = {
    Phase.DISABLED: "the arm's drive is off",
    Phase.IDLE: "time ran out before both markers were seen",
    Phase.ACQUIRE: "time ran out during exploration",
}
"""Causes of runs that end in a phase before servoing without a fault."""


def find_stop_cause(mode: Mode, why: str) -> str:
    """Return the cause that stops the arm at the last tick; empty if nothing stops it.

    `why` is the reason why no marker was ever observed, or empty.
    """
    if mode.cause.stop_sentence:
        return mode.cause.describe(
            mode.detail or (why if mode.cause.declared.hides_markers else "")
        )
    return (
        f"{UNFINISHED_CAUSES[mode.phase]}: {why}" if why and mode.phase in UNFINISHED_CAUSES else ""
    )


def find_settle_time(times: Floats, errors: Floats) -> float | None:
    """Return the time (s) from which on the errors Δy (N, 3) stay within `SETTLED_TOLERANCE`.

    None unless they stay within for at least `SETTLED_DURATION_S` up to the last of ``times``
    (N,) s.
    """
    outside = np.flatnonzero(~(np.abs(errors) < SETTLED_TOLERANCE).all(axis=1))
    since = int(outside[-1]) + 1 if len(outside) else 0
    has_settled = since < len(times) and times[-1] - times[since] >= SETTLED_DURATION_S - 1e-6
    return float(times[since]) if has_settled else None


class OutcomeCollector:
    """Collector of a run's ticks that computes their outcome."""

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
        self._seen = self._seen or tick.state.accepted_frame >= 0
        self._last, self._target = tick, tick.state.target or self._target

    @property
    def blind(self) -> Tick | None:
        """Last tick, if no tick has accepted an observation of both markers; otherwise None."""
        return None if self._seen else self._last

    @property
    def duration(self) -> float:
        """Time (s) of the last tick."""
        return self._times[-1] if self._times else 0.0

    def result(self) -> RunResult:
        """Return the outcome of the ticks so far."""
        if self._last is None:
            return RunResult(target_q=self._target.q.tolist())
        marker_1 = self._servo.position_of_marker_1
        distance = np.linalg.norm(marker_1(self._last.observation.q) - marker_1(self._target.q))
        times, errors = np.array(self._times), np.array(self._errors)
        result = judge_run(times, errors, self._explored_at, self._last.state.mode, float(distance))
        return replace(
            result,
            cause=result.cause + _slow_estimator(self._last),
            duration_s=self.duration + 1.0 / self._servo.rate,
            target_q=self._target.q.tolist(),
        )


def _slow_estimator(last: Tick) -> str:
    """Return the end of a sentence about a user-defined estimator that delayed the loop.

    It is empty if no such estimator did.
    """
    cause, estimator = last.state.cause, last.servo.guarded_estimator
    is_late = cause in (Cause.OVERRUN, Cause.DRIVE_OFF)  # the arm's watchdog may act first
    if (
        is_late
        and isinstance(estimator, EstimatorGuard)
        and estimator.slowest_ns > last.servo.period
    ):
        longest = f"{estimator.slowest_ns * 1e-6:.1f} ms"
        return f": estimator {class_path_of(estimator.estimator)} took up to {longest} for a frame"
    return ""


def judge_run(
    times: Floats, errors: Floats, explored_at: float | None, mode: Mode, apart: float
) -> RunResult:
    """Return the outcome of a run.

    Parameters
    ----------
    times : Floats
        Times (N,) of its ticks, s.
    errors : Floats
        Errors Δy (N, 3) at these times, rad, px, px.
    explored_at : float | None
        Time at which exploration ended, s.
    mode : Mode
        Mode of the servo at the end.
    apart : float
        Distance (mm) of marker 1 at the end from its taught position, by the joints.
    """
    if not len(times):
        return RunResult()
    error = np.sqrt(np.mean(errors[times > times[-1] - SETTLED_DURATION_S] ** 2, axis=0))
    settled_at = find_settle_time(times, errors)
    cause = _cause(mode, explored_at, settled_at, apart)
    return RunResult(
        settled=cause == "",
        cause=cause,
        remark="" if mode.cause.stop_sentence else mode.cause.value,
        settle_time_s=None if cause else settled_at,
        feature_error=FeatureError(*map(finite_or_none, error)),
        explore=ExplorationCost(explored_at),
    )


def _cause(mode: Mode, explored_at: float | None, settled_at: float | None, apart: float) -> str:
    if mode.cause.stop_sentence:
        return mode.reason
    if mode.phase is Phase.ACQUIRE and explored_at is not None:
        return "time ran out on the way back from a hold"
    if mode.phase in UNFINISHED_CAUSES:
        return UNFINISHED_CAUSES[mode.phase]
    if settled_at is None:
        return "time ran out before the feature errors had settled"
    if apart > MAX_SAME_POSE_DISTANCE_MM:
        return (
            f"the features agree, but marker 1 is {apart:.0f} mm from its taught position: a pose "
            f"beyond the singular surface looks the same"
        )
    return ""
