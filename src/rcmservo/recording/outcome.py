"""Outcome of a run from its ticks: whether it settled at the target, when, and if not, why.

A run has settled if the feature errors Δy = (Δs, Δr, Δd) stay within a tolerance up to its end,
with the joints near those of the taught target.
"""

from dataclasses import replace

import numpy as np

from rcmservo.interfaces import Floats, Target
from rcmservo.loop.run_result import (
    ExplorationCost,
    FeatureError,
    FinalPose,
    RunResult,
    finite_or_none,
)
from rcmservo.loop.tick import Tick
from rcmservo.recording.final_pose import (
    FINAL_WINDOW_S,
    RunCourse,
    measure_backlash,
    measure_distances,
    measure_drive_response,
    measure_final_pose,
)
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Mode, Phase
from rcmservo.servo.servo import Servo
from rcmservo.servo.user_estimator import EstimatorGuard, format_class_name_of

SETTLED_TOLERANCE = np.array([np.radians(0.5), 1.0, 1.0])
"""Upper limits of |Δs|, |Δr|, |Δd| in rad, px, px for a settled run."""

SETTLED_DURATION_S = FINAL_WINDOW_S
"""Time in s at the end of a run during which the errors must stay within the tolerance."""

END_DURATION_S = 2.0
"""Time in s at the target after which `Settled` ends a run."""

SETTLED_DURATION_ROUNDING_S = 1e-6
"""Rounding error in s that the difference of two tick times may have."""

MAX_SETTLED_DISTANCE_MM = 1.0
"""Largest distance in mm of marker 2 from its taught position by the joints, for a settled run."""

MAX_SAME_POSE_DISTANCE_MM = 5.0
"""Distance in mm by the joints above which the pose is another one that looks like the target."""

UNFINISHED_CAUSES = {
    Phase.DISABLED: "the arm's drive is off",
    Phase.IDLE: "time ran out before both markers were seen",
    Phase.ACQUIRE: "time ran out during exploration",
}
"""Causes of runs that end without a fault in a phase before SERVO."""


class Settled:
    """Function of a `Tick` that returns True once the tool has settled at the target.

    It has settled after 2 s in SERVO in which the feature errors stayed within 0.5°, 1 px and 1 px
    and marker 2, by the joints, within 1 mm of its taught position. A run that ends then has a last
    second, over which its result is averaged, that begins at rest.
    """

    def __init__(self) -> None:
        self._since_ns: int | None = None

    def __call__(self, tick: Tick) -> bool:
        """Return True at the tick at which the tool has settled, and while it stays so."""
        if not _is_at_target(tick):
            self._since_ns = None
            return False
        self._since_ns = tick.time if self._since_ns is None else self._since_ns
        return tick.time - self._since_ns >= END_DURATION_S * 1e9


def _is_at_target(tick: Tick) -> bool:
    """Return True in SERVO with small feature errors, if the joints do not contradict."""
    state, target = tick.state, tick.state.target
    if state.phase is not Phase.SERVO or target is None:
        return False
    if not (np.abs(state.delta) < SETTLED_TOLERANCE).all():
        return False
    servo = tick.servo
    p2, taught_p2 = (
        servo.tool.second_marker(servo.position_of_marker_1(q))
        for q in (tick.observation.q, target.q)
    )
    return not np.linalg.norm(p2 - taught_p2) > MAX_SETTLED_DISTANCE_MM


class OutcomeCollector:
    """Collector of a run's ticks, from which it computes the result of the run.

    Parameters
    ----------
    servo : Servo
        Settings at the start of the run.
    target : Target
        Target at the start of the run.
    """

    def __init__(self, servo: Servo, target: Target) -> None:
        self._servo, self._target = servo, target
        self._times_s: list[float] = []
        self._feature_errors: list[Floats] = []
        self._observed_s: list[float] = []
        self._joints: list[Floats] = []
        self._applied_rates: list[Floats] = []
        self._frames: list[int] = []
        self._frame_joints: list[Floats] = []
        self._points: list[Floats] = []
        self._exploration_end_s: float | None = None
        self._last_tick: Tick | None = None
        self._has_accepted_frame = False

    def add(self, tick: Tick) -> None:
        """Add the next tick of the run."""
        self._times_s.append(tick.time / 1e9)
        self._feature_errors.append(tick.state.delta)
        self._observed_s.append(tick.observation.now / 1e9)
        self._joints.append(tick.observation.q)
        self._applied_rates.append(tick.applied)
        self._frames.append(tick.observation.frame)
        self._frame_joints.append(tick.observation.q_exposure)
        self._points.append(tick.observation.points)
        if self._exploration_end_s is None and tick.state.explored:
            self._exploration_end_s = self._times_s[-1]
        self._has_accepted_frame = self._has_accepted_frame or tick.state.accepted_frame >= 0
        self._last_tick, self._target = tick, tick.state.target or self._target

    @property
    def last_tick_without_markers(self) -> Tick | None:
        """Last tick if no tick has accepted an observation of both markers, otherwise None."""
        return None if self._has_accepted_frame else self._last_tick

    def compute_result(self) -> RunResult:
        """Return the result of the ticks so far."""
        taught_q = self._target.q
        if self._last_tick is None:
            return RunResult(target_q=taught_q.tolist())
        q, mechanism, tool = np.array(self._joints), self._servo.mechanism, self._servo.tool
        course = RunCourse(
            times=np.array(self._times_s),
            errors=np.array(self._feature_errors),
            now=np.array(self._observed_s),
            q=q,
            applied=np.array(self._applied_rates),
            J_hat=self._last_tick.state.J_hat,
            distances=measure_distances(q, mechanism, tool, taught_q),
            pose_bound=self._last_tick.state.pose_bound,
            bound_parts=self._last_tick.state.bound_parts,
            resting_rates=self._last_tick.state.resting_rates,
            frames=np.array(self._frames, dtype=float),
            q_exposure=np.array(self._frame_joints),
            points=np.array(self._points),
        )
        backlash = measure_backlash(course, mechanism, tool)
        pose = measure_final_pose(course, mechanism, tool, backlash)
        mode = self._last_tick.state.mode
        result = judge_run(course, self._exploration_end_s, mode, pose)
        return replace(
            result,
            cause=result.cause + _describe_slow_estimator(self._last_tick),
            duration_s=self._times_s[-1] + 1.0 / self._servo.rate,
            target_q=taught_q.tolist(),
            backlash=backlash.tolist(),
        )


def judge_run(
    course: RunCourse, exploration_end_s: float | None, mode: Mode, pose: FinalPose
) -> RunResult:
    """Return the result of a run.

    Parameters
    ----------
    course : RunCourse
        Ticks of the run.
    exploration_end_s : float | None
        Time at which exploration ended, s; None if it did not end.
    mode : Mode
        Mode of the servo at the last tick.
    pose : FinalPose
        Position of marker 2 at the last tick, and its distance from the taught one.
    """
    times, errors = course.times, course.errors
    is_final = times > times[-1] - SETTLED_DURATION_S
    rms_error = np.sqrt(np.mean(errors[is_final] ** 2, axis=0))
    settle_time_s = find_settle_time(times, errors, course.distances)
    cause = _find_unsettled_cause(mode, exploration_end_s, pose.by_joints_mm, rms_error, course)
    return RunResult(
        settled=cause == "",
        cause=cause,
        remark="" if mode.cause.stop_sentence else mode.cause.value,
        settle_time_s=None if cause else settle_time_s,
        pose=pose if exploration_end_s is not None else _without_image(pose),
        drives=measure_drive_response(course),
        feature_error=FeatureError(*map(finite_or_none, rms_error)),
        explore=ExplorationCost(exploration_end_s),
    )


def _without_image(pose: FinalPose) -> FinalPose:
    """Return the pose without the distances by the image, which no estimate supports yet."""
    return replace(pose, by_image_mm=None, by_image_std_mm=None)


def find_settle_time(times: Floats, errors: Floats, distances: Floats) -> float | None:
    """Return the time in s after which the feature errors stay within `SETTLED_TOLERANCE`.

    Errors at a pose that looks the same do not count. The time is None if the errors stay within
    the tolerance for less than `SETTLED_DURATION_S` up to the last tick.

    Parameters
    ----------
    times : Floats
        Times (N,) of the ticks, s.
    errors : Floats
        Feature errors Δy (N, 3) at these times, rad, px, px.
    distances : Floats
        Distances (N,) of marker 2 from its taught position, mm; NaN if unknown.
    """
    is_within = (np.abs(errors) < SETTLED_TOLERANCE).all(axis=1)
    is_within &= ~(distances > MAX_SAME_POSE_DISTANCE_MM)
    outside_indices = np.flatnonzero(~is_within)
    first_settled = int(outside_indices[-1]) + 1 if len(outside_indices) else 0
    if first_settled == len(times):
        return None
    settled_s = times[-1] - times[first_settled]
    has_settled = settled_s >= SETTLED_DURATION_S - SETTLED_DURATION_ROUNDING_S
    return float(times[first_settled]) if has_settled else None


def find_stop_cause(mode: Mode, detection_failure: str) -> str:
    """Return the cause that stops the arm at the last tick; empty if nothing stops it.

    Parameters
    ----------
    mode : Mode
        Mode of the servo at the last tick.
    detection_failure : str
        Reason for which no frame has shown both markers; empty if a frame has.
    """
    cause = mode.cause
    if cause.stop_sentence:
        hidden_reason = detection_failure if cause.declared.hides_markers else ""
        return cause.describe(mode.detail or hidden_reason)
    if detection_failure and mode.phase in UNFINISHED_CAUSES:
        return f"{UNFINISHED_CAUSES[mode.phase]}: {detection_failure}"
    return ""


def _find_unsettled_cause(
    mode: Mode,
    exploration_end_s: float | None,
    distance_mm: float | None,
    rms_error: Floats,
    course: RunCourse,
) -> str:
    """Return the reason for which a run has not settled; empty if it has settled."""
    if mode.cause.stop_sentence:
        return mode.reason
    if mode.phase is Phase.ACQUIRE and exploration_end_s is not None:
        return "time ran out on the way back from a hold"
    if mode.phase in UNFINISHED_CAUSES:
        return UNFINISHED_CAUSES[mode.phase]
    if find_settle_time(course.times, course.errors, np.zeros(len(course.times))) is None:
        words = "time ran out before the feature errors had settled"
        return words + _describe_errors(rms_error)
    if find_settle_time(course.times, course.errors, course.distances) is None:
        words = "time ran out before the tool had been at the target for a second"
        return _describe_other_pose(distance_mm) or words
    return _describe_other_pose(distance_mm)


def _describe_errors(rms_error: Floats) -> str:
    """Return the errors (3,) in rad, px, px of the last second with their tolerances."""
    if not np.isfinite(rms_error).all():
        return ""
    measured, allowed = (
        (np.degrees(s), r, d) for s, r, d in (rms_error.tolist(), SETTLED_TOLERANCE.tolist())
    )
    return (
        ": in the last second s {:.2f}°, r {:.2f} px, d {:.2f} px rms, which must stay below "
        "{:g}°, {:g} px, {:g} px".format(*measured, *allowed)
    )


def _describe_other_pose(distance_mm: float | None) -> str:
    """Return the sentence on joints that contradict the image; empty if they do not.

    `distance_mm` is that of marker 2 from its taught position by the joints; None if unknown.
    """
    if distance_mm is None or distance_mm <= MAX_SETTLED_DISTANCE_MM:
        return ""
    agreement = (
        f"the features agree, but marker 2 is {distance_mm:.1f} mm from its taught position by the "
        "joints"
    )
    if distance_mm > MAX_SAME_POSE_DISTANCE_MM:
        return f"{agreement}: a pose beyond the singular surface looks the same"
    return f"{agreement}: the image does not determine the pose so well, or the joints do not"


def _describe_slow_estimator(last_tick: Tick) -> str:
    """Return the end of a sentence on a user-defined estimator that delayed the loop; else empty.

    The last tick then shows that the loop was late, or that the arm's watchdog acted first.
    """
    estimator = last_tick.servo.guarded_estimator
    is_late = last_tick.state.cause in (Cause.OVERRUN, Cause.DRIVE_OFF)
    if not is_late or not isinstance(estimator, EstimatorGuard):
        return ""
    if estimator.slowest_ns <= last_tick.servo.period:
        return ""
    class_path, slowest_ms = format_class_name_of(estimator.estimator), estimator.slowest_ns * 1e-6
    return f": estimator {class_path} took up to {slowest_ms:.1f} ms for a frame"
