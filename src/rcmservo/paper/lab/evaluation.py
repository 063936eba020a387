"""Evaluation of a run with the true state.

The settling time uses the true features about the true imaged RCM, because noise makes single
frames leave the tolerance.
"""

import numpy as np

from rcmservo.geometry.features import compute_feature_error, compute_features, shift_to_rcm
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.loop.plant import Plant
from rcmservo.loop.servo_loop import Tick, servo_ticks
from rcmservo.loop.teach import teach
from rcmservo.paper.lab.paper_settings import FAST_CONTROLLER, FAST_ESTIMATOR, TEACHING_FRAMES
from rcmservo.paper.plan import TaskResult
from rcmservo.paper.statistics import median, rms
from rcmservo.recording.outcome import MAX_SAME_POSE_DISTANCE_MM, find_settle_time
from rcmservo.safety.causes import Cause
from rcmservo.servo.servo import Servo
from rcmservo.sim import Rig, RigSettings, SceneSettings
from rcmservo.tracking import PointMarkers

STRIDE_TICKS = 10
"""Ticks between two samples of the true state."""

END_S = 5.0
"""Time (s) at the end of a run over which the pose error is averaged; noise moves the tool on a
time scale of one second."""


def laboratory(seed: int, scene: SceneSettings, noise: float) -> tuple[Rig, Plant]:
    """Return a rig in `scene`, and its plant with a camera of points with `noise` (px)."""
    return rig_with_points(seed, RigSettings(point_noise=noise, scene=scene))


def rig_with_points(seed: int, settings: RigSettings) -> tuple[Rig, Plant]:
    """Return a rig, and its plant with a camera that delivers points."""
    rig = Rig(seed, settings, pictures=False)
    return rig, Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)


def settle(
    seed: int, settings: RigSettings, duration: float, tool: Tool | None = None
) -> tuple[TaskResult, list[Tick]]:
    """Servo from the start to the target with `FAST_ESTIMATOR` and `FAST_CONTROLLER`.

    Parameters
    ----------
    seed
        Seed of the scene and of the noise.
    settings
        Settings of the laboratory.
    duration
        Duration (s) of the run.
    tool
        Model of the tool in the servo; by default the true tool.

    Returns
    -------
    tuple[TaskResult, list[Tick]]
        The trial and its ticks. The trial has ``failure``, the reason why it did not settle;
        ``settle_time`` in s, or None; ``pose``, ‖p₂ − p_d‖ in mm as rms over `END_S`, or at the end
        if a cause stopped the run; ``jacobian``, the median scaled error of Ĵ after exploration.
    """
    rig, plant = rig_with_points(seed, settings)
    rig.move_to_target()
    target = teach(plant, TEACHING_FRAMES)
    rig.go_home()
    servo = Servo(settings.mechanism, tool or settings.tool, FAST_ESTIMATOR, FAST_CONTROLLER)
    p_d, y_d = rig.body.points(rig.scene.target)[1], _true_features(rig, rig.scene.target)
    ticks = list[Tick]()
    samples = list[tuple[float, Floats, float]]()
    jacobian_errors = list[float]()
    for tick in servo_ticks(plant, servo, target, duration):
        ticks.append(tick)
        if (len(ticks) - 1) % STRIDE_TICKS == 0:
            q = rig.truth.arm.q_true
            displacement: Floats = rig.body.points(q)[1] - p_d
            distance = float(np.linalg.norm(displacement))
            delta = compute_feature_error(_true_features(rig, q), y_d)
            samples.append((tick.time / 1e9, delta, distance))
            if tick.state.explored:
                jacobian_errors.append(rig.truth.jacobian_error_at_tick(tick))
    times, deltas, distances = (np.array(values) for values in zip(*samples, strict=True))
    cause, settle_time = ticks[-1].state.cause, find_settle_time(times, deltas, distances)
    is_at_end = times > times[-1] - END_S
    pose = float(distances[-1]) if cause.stop_sentence else rms(distances[is_at_end])
    failure = _explain_failure(cause, settle_time, pose)
    return {
        "failure": failure,
        "settle_time": None if failure else settle_time,
        "pose": pose,
        "jacobian": median(jacobian_errors) if jacobian_errors else None,
    }, ticks


def _true_features(rig: Rig, q: Floats) -> Floats:
    return compute_features(shift_to_rcm(rig.truth.pixels(q), rig.truth.imaged_rcm()))


def _explain_failure(cause: Cause, settle_time: float | None, pose: float) -> str:
    if cause.stop_sentence:
        return cause.stop_sentence
    if settle_time is None:
        return "the true features did not settle in time"
    return "the features agree in a different pose" if pose > MAX_SAME_POSE_DISTANCE_MM else ""


def count_settled(trials: list[TaskResult]) -> int:
    """Return the number of trials that settled."""
    return sum(not trial["failure"] for trial in trials)


def list_failures(trials: list[TaskResult]) -> str:
    """Return the reasons of trials that did not settle, as the end of a sentence."""
    failures = sorted({trial["failure"] for trial in trials if trial["failure"]})
    return "; not settled: " + ", ".join(failures) if failures else ""
