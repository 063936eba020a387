"""Thresholds of the checks: every number that decides whether a cause of a stop is present."""

import math
from dataclasses import dataclass
from typing import Annotated

from rcmservo.constraints import (
    FRACTION,
    Checked,
    Limit,
    Triple,
    above,
    angles,
    at_least,
    between,
    not_negative,
    positive,
    three_positive,
)

UP_TO_1_S = above(0.0, 1.0, "a time", "s")
POSITIVE_S = positive("time in s")
POSITIVE_MM = positive("length in mm")
POSITIVE_MM_OR_INF = Limit(lambda mm: mm > 0.0, "a positive number of mm, or inf")
POSITIVE_PX = positive("number of px")
POSITIVE = positive()
COUNT_TO_1000 = between(1, 1000, "a whole number")


@dataclass(frozen=True)
class Thresholds(Checked, section="thresholds"):
    """Thresholds of the checks, from which on a cause is present.

    Names in capitals, such as `LATE`, are the members of `Cause` that a threshold decides about.
    Scaled features are divided by 10°, 10 px and 10 px, so the scaled error √(2V) and the entries
    of the scaled Ĵ have comparable parts. The signature states the range and the default of each
    threshold. A scaled error has no unit. V = Σ Vᵢ is the potential of the controller, eq. (32), of
    the scaled error Δy and its bounds bᵢ, scaled too:

        Vᵢ = ½ Δyᵢ²             if |Δyᵢ| < bᵢ
        Vᵢ = bᵢ |Δyᵢ| − ½ bᵢ²   otherwise

    An instance is passed as the argument `thresholds` of `Servo`.

    The noise σ px of a pixel coordinate is the root mean square residual of the projection fit, the
    fit of the camera's projection to all accepted frames; 0.5 px before the frames determine it.

    Parameters
    ----------
    max_frame_age_slow : float
        Age of the newest frame since its arrival, in frame periods, from which on the tool moves
        slowly (`AGEING`).
    max_frame_age_hold : float
        Age of the newest frame since its arrival, in frame periods, from which on the tool holds
        still (`STALE`); not below ``max_frame_age_slow``.
    initial_frame_period : float
        Frame period that is assumed until a second frame arrives, s.
    max_latency : float
        Longest time from the exposure of a frame to the command that uses it, s (`LATE`). Latency
        up to this value is compensated.
    arm_timeout : float
        Longest time without a reading of the joints, s (`ARM_SILENT`).
    max_following_error : Triple
        Largest following error: deviation of each joint from the position that the commands
        predict (rad, rad, mm), positive, at most π for an angle (`NOT_FOLLOWING`).
    drive_lag : float
        Time constant of the drives, with which the joints follow the commanded rates, s. At 0 the
        exploration measures it.
    following_error_decay : float
        Time constant with which the following error decays, s: a slow drift of the joints is no
        fault of the drive while a motion is commanded. For a slow joint while servoing it is at
        most 0.125 s, as a drive may rest at small rates.
    settling_time : float
        Time without a commanded motion after which the joints are at rest, s. From then on a joint
        that moves by more than ``max_following_error``, however slowly, is a fault (`CREEPS`).
    limit_tolerance : float
        Distance by which a joint may be beyond its limit, as a fraction of its range
        (`BEYOND_LIMIT`).
    max_tick_delay : float
        Longest delay of a single tick, s (`OVERRUN`).
    late_tick_fraction : float
        Delay of a tick, as a fraction of the tick's period, from which on the tick is late
        (`LATE_TICK`).
    max_late_ticks : int
        Number of successive late ticks that count as an overrun (`OVERRUN`).
    max_innovation : float
        Largest deviation of a marker from its prediction, in standard deviations (`REJECTED`).
        It is positive, without a unit, and compared with the Mahalanobis distance √(eᵀ Σ⁻¹ e) of
        the deviation e (2,) px. Σ = C + σ² (1 + 1/n) I (2, 2) px² is the covariance C of the
        projection fit at the marker, plus the noise of the detection and of the marker's mean
        residual over its n frames. First e is shortened by ``model_error`` px and by
        ``timing_error_fraction`` of the marker's motion.
    model_error : float
        Deviation (px) of a marker that is attributed to the projection model, positive.
    timing_error_fraction : float
        Deviation of a marker that is attributed to timing errors, as a fraction of its motion in
        the image since the last accepted frame, positive.
    max_residual_px : float
        Largest root mean square residual of the projection fit, px. A larger one is no camera's
        projection (`DIVERGED`).
    min_camera_distance : float
        Smallest distance between a camera and the tool, mm. A fit that implies a smaller distance
        is no camera's projection (`DIVERGED`). A marker that does not move in the image causes such
        a fit.
    max_drift_sigma : float
        Largest mean residual of a marker, in standard deviations. It is positive, without a unit,
        and compared with the Mahalanobis distance √(rᵀ Σ⁻¹ r) of the mean residual r (2,) px over
        n = ``drift_frames`` frames. Σ = C + σ²/n I (2, 2) px² is the covariance C of the
        projection fit at the marker, plus the noise of the mean. A drift (`DRIFTS`, `SURPRISED`)
        exceeds this value and ``max_drift_px``.
    max_drift_px : float
        Largest mean residual of a marker, px, positive: the length of its mean over
        ``drift_frames`` frames.
    max_arm_error : float
        Mean residual that is attributed to errors of arm and tool (backlash, bending, axes or
        markers that are not where the kinematics have them), as a distance of the marker in space,
        mm, not negative. With J = ∂m/∂p (2, 3) px/mm of the marker, a drift also exceeds
        √(rᵀ (a² I + b² J Jᵀ)⁻¹ r) = 1, with ``max_drift_px`` for a and this for b. b grows up to
        1.7 times for an arm with larger residuals on the way, and is so large at the target, where
        the arm reverses its motion and the joints bound its error.
    drift_frames : int
        Number of frames in the mean residual.
    frozen_image_motion : float
        Distance (mm) that the tool moves until an image in which both markers are at exactly the
        same pixels counts as frozen (`FROZEN`), after ``max_rejected_frames`` such frames.
    stuck_marker_px : float
        Largest motion (px) of a marker that counts as still during the exploration if the other
        marker moves five times as far, or the tool along 25 mm (`STANDS_STILL`).
    max_target_deviation : float
        Largest deviation of a taught marker from its prediction at the joints of teaching, in
        standard deviations (`IMPLAUSIBLE`). It is positive, without a unit, and compared with the
        Mahalanobis distance as ``max_innovation`` is. The deviation is first shortened by
        ``model_error`` px, by ``target_error_fraction`` of the marker's predicted motion to its
        target, and by half of ``max_target_mismatch`` mm times the px per mm there. The vector
        between the taught markers is compared in the same way, with a fraction of its own length.
        Once the tool has moved 10 mm away from the joints of teaching, ``model_error`` alone is
        subtracted. At the target, 0.63 times this number of standard deviations separate the place
        of the target by the image alone from the joints of teaching (`ELSEWHERE`).
    target_error_fraction : float
        Deviation of a taught marker that is attributed to lens, arm and tool, which the projection
        fit assumes to be ideal, as a fraction of the marker's predicted motion to the target; of
        the vector between the markers, as a fraction of its length.
    max_target_mismatch : float
        Largest distance (mm) of the tool from the taught joints while the image shows it at the
        target (`ELSEWHERE`), positive; inf switches this check, `IMPLAUSIBLE` and
        `TARGET_UNCHECKED` off. The larger distance of both markers counts. Three standard
        deviations of the pose are added: with H = ∂m/∂p₁ (4, 3) px/mm, n averaged frames and 30 of
        the target, σ √tr(HᵀH)⁻¹ √(1/n + 1/30) mm.
    target_mismatch_time : float
        Time for which image and joints must disagree at the target, s (`ELSEWHERE`). What the image
        shows is averaged over the same time.
    max_single_marker_deviation : float
        Largest standard deviation of the pose (mm) that permits slow motion with one marker lost,
        by the other marker and the joints; 0 never permits it. It is that of marker 1,
        √tr(H⁺ C H⁺ᵀ), by the covariance C px² of the lost marker's prediction.
    max_jump_px : float
        Largest motion (px) of a marker between frames while the tool is at rest and no prediction
        exists, positive. ``max_innovation`` times √2 σ, the standard deviation of the difference of
        two detections, is added, and ``max_px_per_mm`` times the motion of the tool.
    max_px_per_mm : float
        Largest motion of a marker in the image per motion of the tool, px/mm, positive, while no
        prediction exists.
    max_compared_motion : float
        Largest motion of the tool between two frames (mm) at which the markers are compared before
        an exploration is done. An operator moves the tool further by hand.
    jump_agreement : float
        Largest distance between the positions of a marker in successive rejected frames at which
        they count as the same, as a multiple of ``max_jump_px``, positive.
    max_rejected_frames : int
        Number of successive rejected frames at which the tool stops (`CAMERA_MOVED`, `SWAPPED`,
        `SURPRISED`); twice as many if the detections scatter in the image.
    moved_camera_frames : int
        Number of successive rejected frames after which the view itself must have changed
        (`CAMERA_MOVED`).
    min_predicted_change : float
        Smallest predicted change of the scaled features at which the measured change is compared
        with it, positive. The change is the largest absolute component of Ĵ Δp₁, each divided by
        10°, 10 px, 10 px.
    max_change_error : float
        Largest difference between measured and predicted change, as a fraction of the predicted
        one, in addition to ``min_predicted_change``. Both are largest absolute components.
    max_contradictions : int
        Number of successive comparisons that must contradict the estimate to invalidate it
        (`DIVERGED`).
    singular_fraction : float
        Fraction of the error that the damped control law must reduce. Below it the target lies at
        or beyond a singular surface (`SINGULAR`). With the scaled gradient g = ∂V/∂y (n,), the
        singular values σᵢ and vectors uᵢ (n,) of the scaled Ĵ and the damping λᵢ, as in
        `SaturatedController`, the fraction is Σ (uᵢᵀg)² σᵢ²/(σᵢ² + λᵢ²) / |g|².
    nearly_singular_fraction : float
        Fraction of the error that the damped control law must reduce for full speed. Below it the
        tool moves slowly (`NEARLY_SINGULAR`). It is computed as for ``singular_fraction``.
    min_checked_error : float
        Scaled error √(2V) up to which ``singular_fraction`` and ``nearly_singular_fraction`` are
        not applied, positive: noise has an arbitrary direction.
    min_exploration_room : float
        Fraction of each side of the exploration's first box that the joint limits must leave
        (`NO_ROOM`). A full side is ``speed_scale`` times ``leg_time`` of `Exploration` times the
        joint's maximal speed, reduced if a leg would exceed ``max_leg_length``.
    max_jacobian_entry : float
        Largest entry of the scaled Ĵ, 1/mm, positive: 30 is 300 px/mm, more than any camera's image
        shows (`ESTIMATE_LARGE`).
    hold_time : float
        Time in HOLD after which only the operator resumes, s.
    frames_to_recover : int
        Number of accepted frames that end a HOLD.
    frames_to_servo : int
        Number of accepted frames in ACQUIRE, with an estimate, before SERVO.
    limit_horizon : float
        Time ahead within which a joint must not pass its limit, s (`JOINT_1_LIMIT`).
    limit_speed_fraction : float
        Fraction of the speed that must remain without the joint that would pass its limit; if less
        remains, the joint blocks the path (`JOINT_1_LIMIT`).
    stall_error : float
        Scaled error √(2V) above which an error that does not decrease counts as stalled, positive
        (`STALLED`).
    stall_decrease : float
        Decrease of the scaled error √(2V) that counts as progress, positive.
    stall_decrease_fraction : float
        Decrease of the scaled error that counts as progress, as a fraction of this error. The
        smaller one of ``stall_decrease`` and this decrease counts.
    stall_time : float
        Longest time without progress, s (`STALLED`).
    stall_time_constants : float
        Longest time without progress, in time constants 1/k of the control law with the gain k,
        positive. The longer one of ``stall_time`` and this time counts.

    Raises
    ------
    BadInput
        If a threshold is outside its range, or ``max_frame_age_hold`` is below
        ``max_frame_age_slow``.

    References
    ----------
    The checks and their thresholds are this project's own.
    """

    name = "thresholds"

    max_frame_age_slow: Annotated[float, at_least(1.0, "frame period")] = 1.5
    max_frame_age_hold: Annotated[float, positive("number of frame periods")] = 3.0
    initial_frame_period: Annotated[float, UP_TO_1_S] = 0.1
    max_latency: Annotated[float, UP_TO_1_S] = 0.1

    arm_timeout: Annotated[float, UP_TO_1_S] = 0.05
    max_following_error: Annotated[
        Triple, three_positive("rad, rad, mm"), angles(math.pi, first=2)
    ] = (0.008, 0.008, 0.6)
    drive_lag: Annotated[float, between(0.0, 1.0, "a time", "s")] = 0.0
    following_error_decay: Annotated[float, POSITIVE_S] = 1.0
    settling_time: Annotated[float, UP_TO_1_S] = 0.5
    limit_tolerance: Annotated[float, FRACTION] = 0.005

    max_tick_delay: Annotated[float, UP_TO_1_S] = 0.05
    late_tick_fraction: Annotated[float, FRACTION] = 0.5
    max_late_ticks: Annotated[int, COUNT_TO_1000] = 3

    max_innovation: Annotated[float, POSITIVE] = 6.0
    model_error: Annotated[float, POSITIVE_PX] = 1.0
    timing_error_fraction: Annotated[float, POSITIVE] = 0.25

    max_residual_px: Annotated[float, POSITIVE_PX] = 2.5
    min_camera_distance: Annotated[float, POSITIVE_MM] = 30.0

    max_drift_sigma: Annotated[float, POSITIVE] = 6.0
    max_drift_px: Annotated[float, POSITIVE_PX] = 1.25
    max_arm_error: Annotated[float, not_negative("number of mm")] = 0.9
    drift_frames: Annotated[int, COUNT_TO_1000] = 20
    frozen_image_motion: Annotated[float, POSITIVE_MM] = 1.0
    stuck_marker_px: Annotated[float, POSITIVE_PX] = 2.0
    max_target_deviation: Annotated[float, POSITIVE] = 6.0
    target_error_fraction: Annotated[float, FRACTION] = 0.1
    max_target_mismatch: Annotated[float, POSITIVE_MM_OR_INF] = 2.0
    target_mismatch_time: Annotated[float, POSITIVE_S] = 0.2

    max_single_marker_deviation: Annotated[float, not_negative("number of mm")] = 1.5

    max_jump_px: Annotated[float, POSITIVE_PX] = 3.0
    max_px_per_mm: Annotated[float, POSITIVE_PX] = 20.0
    max_compared_motion: Annotated[float, POSITIVE_MM] = 10.0
    jump_agreement: Annotated[float, POSITIVE] = 2.0
    max_rejected_frames: Annotated[int, COUNT_TO_1000] = 3
    moved_camera_frames: Annotated[int, COUNT_TO_1000] = 30

    min_predicted_change: Annotated[float, POSITIVE] = 0.2
    max_change_error: Annotated[float, FRACTION] = 0.75
    max_contradictions: Annotated[int, COUNT_TO_1000] = 5
    singular_fraction: Annotated[float, FRACTION] = 0.02
    nearly_singular_fraction: Annotated[float, FRACTION] = 0.2
    min_checked_error: Annotated[float, POSITIVE] = 0.2
    min_exploration_room: Annotated[float, FRACTION] = 0.2
    max_jacobian_entry: Annotated[float, POSITIVE] = 30.0

    hold_time: Annotated[float, POSITIVE_S] = 1.0
    frames_to_recover: Annotated[int, COUNT_TO_1000] = 5
    frames_to_servo: Annotated[int, COUNT_TO_1000] = 6

    limit_horizon: Annotated[float, POSITIVE_S] = 0.1
    limit_speed_fraction: Annotated[float, FRACTION] = 0.3

    stall_error: Annotated[float, POSITIVE] = 0.5
    stall_decrease: Annotated[float, POSITIVE] = 0.2
    stall_decrease_fraction: Annotated[float, FRACTION] = 0.02
    stall_time: Annotated[float, POSITIVE_S] = 6.0
    stall_time_constants: Annotated[float, POSITIVE] = 3.0

    def __post_init__(self) -> None:
        super().__post_init__()
        expected = "a number of frame periods not below max_frame_age_slow"
        self.require(
            self.max_frame_age_hold >= self.max_frame_age_slow, "max_frame_age_hold", expected
        )
