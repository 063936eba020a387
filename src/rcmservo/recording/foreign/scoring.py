"""Scores of the estimators on a recording, by one-step prediction.

The recorded frames pass through tracking, features, imaged RCM and estimators. From all frames up
to t each estimator predicts y at t + 1 for the recorded joints. The score is the root mean square
of the errors, next to that of the prediction of no motion. An estimator with a projection model
predicts ŷ(t+1) = y(t) + h(p(t+1)) − h(p(t)). Every estimator also predicts linearly, with Ĵ Δp.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.config.rig_file import RigDescription
from rcmservo.errors import UnusableFile
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.geometry.features import compute_feature_error, compute_features, shift_to_rcm
from rcmservo.geometry.imaged_rcm import ImagedRcm, solve_imaged_rcm, store_line
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import FailureExplainer, Floats, Markers, Tracker
from rcmservo.recording.foreign.frame_folder import RecordedPose, iterate_frames, load_recording
from rcmservo.tracking import PointMarkers

FIRST_PREDICTED_INDEX = 9
"""Index of the first frame from which a step is predicted: the tenth."""

MIN_FRAMES = FIRST_PREDICTED_INDEX + 2
"""Smallest number of frames with both markers: one step can be predicted."""

ASSUMED_SPEED_MM_S = 10.0
"""Assumed speed of the tool (mm/s) between stills, for a recording without times."""


@dataclass(frozen=True, eq=False)
class RecordingScore:
    """Scores and intermediate results of a recording.

    Parameters
    ----------
    poses : list[RecordedPose]
        All rows of the recording, in order.
    markers : list[Markers]
        Markers of each frame.
    o_c : Floats
        Imaged RCM (2,) px after the last frame; NaN if it is not observable.
    condition : float
        Condition number of (16); infinite if (16) is singular.
    reprojection : Floats
        Root mean square (2,) px of each marker's 2-D error under the final fit.
    one_step : dict[str, Floats]
        Root mean square error (3,) in rad, px, px of each predictor; NaN if it predicted no step.
    """

    poses: list[RecordedPose]
    markers: list[Markers]
    o_c: Floats
    condition: float
    reprojection: Floats
    one_step: dict[str, Floats]


@dataclass(frozen=True, eq=False)
class _Observation:
    """Frame with both markers."""

    p1: Floats
    points: Floats
    dt: float
    sizes: Floats


def score_recording(
    folder: Path,
    lab: RigDescription,
    tracker: Tracker,
    estimators: dict[str, Estimator],
    imaged_rcm: ImagedRcm,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> RecordingScore:
    """Score estimators on a recording.

    Parameters
    ----------
    folder : Path
        Recording.
    lab : RigDescription
        Mechanism and tool.
    tracker : Tracker
        Tracker of the images; a recording of points does not use it.
    estimators : dict of str to Estimator
        Estimators by name. The first one with a projection model gives the reprojection.
    imaged_rcm : ImagedRcm
        Settings of (16).
    progress : callable, optional
        Called with the number of tracked frames and their total.

    Returns
    -------
    RecordingScore
        Scores by estimator name.

    Raises
    ------
    UnusableFile
        If fewer than `MIN_FRAMES` frames show both markers, or if the recording cannot be read.
    """
    poses = load_recording(folder, lab.mechanism, lab.tool)
    if poses and poses[0].points is not None:
        tracker = PointMarkers()
    markers: list[Markers] = []
    for frame in iterate_frames(poses):
        markers.append(tracker.find(frame))
        progress(len(markers), len(poses))
    observations = _select_observations(poses, markers)
    if len(observations) < MIN_FRAMES:
        raise UnusableFile(folder, _shortage_sentence(len(observations), poses, markers, tracker))
    origins = _imaged_rcms(observations, imaged_rcm)
    one_step = {"no_motion": _score_no_motion(observations, origins)}
    reprojection = np.full(2, np.nan)
    for name, estimator in estimators.items():
        finite, linear, memory = _score_estimator(estimator, lab.tool, observations, origins)
        if finite is not None:
            one_step[name] = finite
        one_step[f"{name}_linear"] = linear
        if finite is not None and np.isnan(reprojection).any():
            o_c = origins[-1][0]
            reprojection = _reprojection_error(estimator, memory, lab.tool, observations, o_c)
    o_c, condition = origins[-1]
    return RecordingScore(poses, markers, o_c, condition, reprojection, one_step)


def _select_observations(poses: list[RecordedPose], markers: list[Markers]) -> list[_Observation]:
    observations: list[_Observation] = []
    previous: RecordedPose | None = None
    for pose, detected in zip(poses, markers, strict=True):
        if np.isfinite(detected.points).all():
            dt = _interval(previous, pose)
            observations.append(_Observation(pose.p1, detected.points, dt, detected.radius))
            previous = pose
    return observations


def _shortage_sentence(
    count: int, poses: list[RecordedPose], markers: list[Markers], tracker: Tracker
) -> str:
    """Return the number of frames with both markers, and why the first other frame lacks one."""
    shortage = f"only {count} show both markers" if count else "no frame shows both markers"
    sentence = f"{len(poses)} frames, {shortage}, and a score needs {MIN_FRAMES}"

    for frame, pose, detected in zip(iterate_frames(poses), poses, markers, strict=True):
        if not np.isfinite(detected.points).all():
            reason = tracker.explain_failure(frame) if isinstance(tracker, FailureExplainer) else ""
            return f"{sentence} (frame {pose.name}: {reason})" if reason else sentence
    return sentence


def _interval(previous: RecordedPose | None, pose: RecordedPose) -> float:
    """Return the seconds between two poses: recorded, or the distance at the assumed speed."""
    if previous is None:
        return 0.0
    if previous.time is not None and pose.time is not None:
        return max(pose.time - previous.time, 0.0)
    return float(np.linalg.norm(pose.p1 - previous.p1)) / ASSUMED_SPEED_MM_S


def _imaged_rcms(
    observations: list[_Observation], imaged_rcm: ImagedRcm
) -> list[tuple[Floats, float]]:
    """Return o_c (2,) and its condition after each frame; NaN while it is not observable."""
    (lines, count), printed = imaged_rcm.init(), imaged_rcm.printed
    origins: list[tuple[Floats, float]] = []
    for current in observations:
        lines, count = store_line(lines, count, current.points, printed)
        o_c, condition = solve_imaged_rcm(lines, count, imaged_rcm.refinements, printed)
        is_observable = condition <= imaged_rcm.max_condition
        origins.append((o_c, condition) if is_observable else (np.full(2, np.nan), condition))
    return origins


def _score_no_motion(
    observations: list[_Observation], origins: list[tuple[Floats, float]]
) -> Floats:
    errors = [
        _feature_change(observations[t], observations[t + 1], origins[t][0])
        for t in range(FIRST_PREDICTED_INDEX, len(observations) - 1)
        if np.isfinite(origins[t][0]).all()
    ]
    return _rms(errors)


def _score_estimator(
    estimator: Estimator,
    tool: Tool,
    observations: list[_Observation],
    origins: list[tuple[Floats, float]],
) -> tuple[Floats | None, Floats, Any]:
    """Return the errors of the finite and of the linear step, and the last memory.

    The errors of the finite step are None without a projection model.
    """
    memory = estimator.init()
    finite: list[Floats] = []
    linear: list[Floats] = []
    since_update: float | None = None
    for t, (current, (o_c, _)) in enumerate(zip(observations, origins, strict=True)):
        since_update = None if since_update is None else since_update + current.dt
        if not np.isfinite(o_c).all():
            continue
        sample = Sample(current.p1, current.points, o_c, since_update or 0.0, current.sizes)
        memory, since_update = estimator.update(memory, tool, sample), 0.0
        if t < FIRST_PREDICTED_INDEX or t + 1 == len(observations):
            continue
        following = observations[t + 1]
        change = _feature_change(current, following, o_c)
        J_hat = estimator.jacobian(memory, tool, sample)
        linear.append(compute_feature_error(change, J_hat @ (following.p1 - current.p1)))
        predicted_now, predicted_next = (
            estimator.predict(memory, tool, p1) for p1 in (current.p1, following.p1)
        )
        if predicted_now is not None and predicted_next is not None:
            predicted_change = compute_feature_error(
                compute_features(predicted_next), compute_features(predicted_now)
            )
            finite.append(compute_feature_error(change, predicted_change))
    return (_rms(finite) if estimator.predicts_markers else None), _rms(linear), memory


def _feature_change(current: _Observation, following: _Observation, o_c: Floats) -> Floats:
    """Return Δy (3,) from one frame to the next, about the same origin."""
    return compute_feature_error(
        compute_features(shift_to_rcm(following.points, o_c)),
        compute_features(shift_to_rcm(current.points, o_c)),
    )


def _rms(errors: list[Floats]) -> Floats:
    return np.sqrt(np.mean(np.array(errors) ** 2, axis=0)) if errors else np.full(3, np.nan)


def _reprojection_error(
    estimator: Estimator, memory: Any, tool: Tool, observations: list[_Observation], o_c: Floats
) -> Floats:
    """Return the root mean square (2,) px of each marker's error under one fit, over all frames."""
    squares: list[Floats] = []
    for current in observations:
        model = estimator.predict(memory, tool, current.p1)
        assert model is not None
        squares.append(
            np.sum((model - shift_to_rcm(current.points, o_c)).reshape(2, 2) ** 2, axis=1)
        )
    return np.sqrt(np.mean(squares, axis=0))
