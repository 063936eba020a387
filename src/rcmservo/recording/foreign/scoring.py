"""Scores of the estimators on a recording, by one-step prediction.

The recorded frames pass through tracking, features y = (s, r, d), imaged RCM and estimators. From
all frames up to frame t each estimator predicts the features of frame t + 1, given its recorded
joints, in up to two ways:

    ŷ(t+1) = y(t) + Ĵ (p₁(t+1) − p₁(t))            linear, with its estimate Ĵ of the Jacobian
    ŷ(t+1) = y(t) + h(p₁(t+1)) − h(p₁(t))          with its projection model h, if it has one

The score is the root mean square of the errors, next to that of the prediction of no motion,
ŷ(t+1) = y(t). The recording also determines lengths of the arm and the tool, see length_fit.py.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.config.rig_file import RigDescription
from rcmservo.errors import UnusableFile
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.geometry.features import compute_feature_error, compute_features, shift_to_rcm
from rcmservo.geometry.imaged_rcm import ImagedRcm, update_imaged_rcm
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import FailureExplainer, Floats, Markers, Tracker
from rcmservo.recording.foreign.frame_folder import RecordedPose, iterate_frames, load_recording
from rcmservo.recording.foreign.length_fit import LengthEstimate, fit_lengths
from rcmservo.tracking import PointMarkers

FIRST_PREDICTED_INDEX = 9
"""Index of the first frame from which a step is predicted: the tenth frame with both markers."""

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
        Condition number of eq. (16), which is solved for o_c; infinite if it is singular.
    reprojection : Floats
        Root mean square (2,) px of each marker's distance from its prediction by the final fit.
    one_step : dict[str, Floats]
        Root mean square error (3,) in rad, px, px by prediction: "no_motion", the name of an
        estimator with a projection model, or a name with "_linear"; NaN if no step was predicted.
    lengths : list[LengthEstimate]
        Lengths of the arm and the tool by the pixels.
    """

    poses: list[RecordedPose]
    markers: list[Markers]
    o_c: Floats
    condition: float
    reprojection: Floats
    one_step: dict[str, Floats]
    lengths: list[LengthEstimate]


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
        Settings for the solution of eq. (16).
    progress : callable, optional
        Function that receives the number of tracked frames and their total.

    Returns
    -------
    RecordingScore
        Scores and intermediate results.

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
    samples = _select_samples(poses, markers)
    if len(samples) < MIN_FRAMES:
        raise UnusableFile(folder, _describe_shortage(len(samples), poses, markers, tracker))
    samples, condition = _solve_imaged_rcms(samples, imaged_rcm)
    o_c, one_step = samples[-1].o_c, {"no_motion": _score_no_motion(samples)}
    reprojection = np.full(2, np.nan)
    for name, estimator in estimators.items():
        model_score, linear_score, memory = _score_estimator(estimator, lab.tool, samples)
        if model_score is not None:
            one_step[name] = model_score
        one_step[f"{name}_linear"] = linear_score
        if model_score is not None and np.isnan(reprojection).any():
            predict = partial(estimator.predict, memory, lab.tool)
            reprojection = _compute_reprojection_error(predict, samples, o_c)
    lengths = fit_lengths(lab.mechanism, lab.tool, samples)
    return RecordingScore(poses, markers, o_c, condition, reprojection, one_step, lengths)


def _select_samples(poses: list[RecordedPose], markers: list[Markers]) -> list[Sample]:
    """Return the frames with both markers as samples without o_c."""
    samples: list[Sample] = []
    previous: RecordedPose | None = None
    for pose, detected in zip(poses, markers, strict=True):
        if np.isfinite(detected.points).all():
            dt, unknown_o_c = _compute_interval(previous, pose), np.full(2, np.nan)
            samples.append(Sample(pose.p1, detected.points, unknown_o_c, dt, detected.radius))
            previous = pose
    return samples


def _describe_shortage(
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


def _compute_interval(previous: RecordedPose | None, pose: RecordedPose) -> float:
    """Return the seconds between two poses: recorded, or the distance at the assumed speed."""
    if previous is None:
        return 0.0
    if previous.time is not None and pose.time is not None:
        return max(pose.time - previous.time, 0.0)
    return float(np.linalg.norm(pose.p1 - previous.p1)) / ASSUMED_SPEED_MM_S


def _solve_imaged_rcms(samples: list[Sample], imaged_rcm: ImagedRcm) -> tuple[list[Sample], float]:
    """Return the samples with o_c, and the condition number of eq. (16) at the last one.

    Eq. (16) is solved from the frames up to each sample; o_c is NaN while it is not observable.
    """
    memory, count = imaged_rcm.init()
    solved: list[Sample] = []
    condition = np.inf
    for sample in samples:
        memory, count, solution = update_imaged_rcm(
            memory, count, sample.points, imaged_rcm.printed
        )
        condition = solution.condition
        is_known = imaged_rcm.knows(solution, sample.points[0])
        solved.append(sample._replace(o_c=solution.o_c) if is_known else sample)
    return solved, condition


def _score_no_motion(samples: list[Sample]) -> Floats:
    """Return the root mean square change (3,) of the features from frame to frame."""
    changes = [
        _compute_feature_change(current, following)
        for current, following in pairwise(samples[FIRST_PREDICTED_INDEX:])
        if np.isfinite(current.o_c).all()
    ]
    return _compute_rms(changes)


def _score_estimator(
    estimator: Estimator, tool: Tool, samples: list[Sample]
) -> tuple[Floats | None, Floats, Any]:
    """Return the errors of the predictions by the model and by Ĵ, and the estimator's last memory.

    The errors (3,) of the model are None for an estimator without a projection model.
    """
    memory = estimator.init()
    model_errors: list[Floats] = []
    linear_errors: list[Floats] = []
    since_update_s: float | None = None
    for t, sample in enumerate(samples):
        since_update_s = None if since_update_s is None else since_update_s + sample.dt
        if not np.isfinite(sample.o_c).all():
            continue
        current = sample._replace(dt=since_update_s or 0.0)
        memory, since_update_s = estimator.update(memory, tool, current), 0.0
        if t < FIRST_PREDICTED_INDEX or t + 1 == len(samples):
            continue
        following = samples[t + 1]
        change = _compute_feature_change(current, following)
        J_hat = estimator.jacobian(memory, tool, current)
        linear_errors.append(compute_feature_error(change, J_hat @ (following.p1 - current.p1)))
        predicted, predicted_next = (
            estimator.predict(memory, tool, p1) for p1 in (current.p1, following.p1)
        )
        if predicted is not None and predicted_next is not None:
            predicted_change = compute_feature_error(
                compute_features(predicted_next), compute_features(predicted)
            )
            model_errors.append(compute_feature_error(change, predicted_change))
    model_score = _compute_rms(model_errors) if estimator.predicts_markers else None
    return model_score, _compute_rms(linear_errors), memory


def _compute_feature_change(current: Sample, following: Sample) -> Floats:
    """Return Δy (3,) from one sample to the next, both about the imaged RCM of the first."""
    return compute_feature_error(
        compute_features(shift_to_rcm(following.points, current.o_c)),
        compute_features(shift_to_rcm(current.points, current.o_c)),
    )


def _compute_rms(errors: list[Floats]) -> Floats:
    return np.sqrt(np.mean(np.array(errors) ** 2, axis=0)) if errors else np.full(3, np.nan)


def _compute_reprojection_error(
    predict: Callable[[Floats], Floats | None], samples: list[Sample], o_c: Floats
) -> Floats:
    """Return the root mean square (2,) px of each marker's distance from its predicted position.

    `predict` returns the markers (4,) px from o_c that one fit predicts for p₁ (3,) mm.
    """
    squared_distances: list[Floats] = []
    for sample in samples:
        predicted = predict(sample.p1)
        assert predicted is not None
        errors = (predicted - shift_to_rcm(sample.points, o_c)).reshape(2, 2)
        squared_distances.append(np.sum(errors**2, axis=1))
    return np.sqrt(np.mean(squared_distances, axis=0))
