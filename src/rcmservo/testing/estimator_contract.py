"""Contract of an estimator: pure functions, and a Jacobian in the units of eq. (14)."""

from typing import Any

import numpy as np

from rcmservo.errors import require
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.geometry.features import compute_features, compute_features_jacobian, shift_to_rcm
from rcmservo.geometry.tool import RigidTool, Tool
from rcmservo.interfaces import Floats
from rcmservo.servo.user_estimator import check_estimator as check_before_motion
from rcmservo.servo.user_estimator import make_trial_sample, make_trial_samples
from rcmservo.testing.violations import WatchedPart, report_violations

DIFFERENCE_STEP_MM = 1e-3
"""Step of p₁ in mm for finite differences."""

MAX_JACOBIAN_ERROR = 1e-3
"""Largest error of a row of a Jacobian relative to its largest number."""

MAX_SCALE, MIN_SCALE = 5.0, -0.2
"""Limits of a row of Ĵ along the true one, as a ratio, after 30 samples without noise.

Those of the estimators of this package are between 0.7 and 1.4. A slow one may be near zero.
"""

FEATURE_UNITS = ("s", "rad"), ("r", "px"), ("d", "px")


def check_estimator(estimator: Estimator, tool: Tool | None = None) -> None:
    """Check an estimator against its contract with made-up samples of a known camera.

    Parameters
    ----------
    estimator : Estimator
        Estimator of the user.
    tool : Tool, optional
        Tool with both markers; default ``RigidTool(spacing=30.0)``, in mm.

    Raises
    ------
    ContractViolation
        With the first violation in one sentence: what `Servo.warm_up` refuses, a changed memory or
        sample, a result that depends on a hidden state, a Ĵ that is far from the true one or in
        another unit, Jacobians that are not derivatives of `predict` or disagree with eq. (15), or
        a lost marker that `update` does not tolerate though the class says so.

    Notes
    -----
    The check does not judge how quickly or accurately an estimator learns; `rcmservo study` does.
    """
    expected = "an estimator, not a class: call the class, with () after its name"
    require(not isinstance(estimator, type), "estimator", estimator, expected)
    tool = tool or RigidTool(spacing=30.0)
    part, samples = WatchedPart(estimator), list(make_trial_samples(tool))
    _check_arguments(part, tool, samples)
    memory = _check_pure(part, tool, samples)
    with report_violations():
        check_before_motion(estimator, tool)
    sample = _place_in_prediction(part, memory, tool, samples[-1])
    _check_units(part, memory, tool, sample)
    _check_derivatives(part, memory, tool, sample, estimator.has_markers_jacobian)
    if estimator.estimates_rcm and estimator.tolerates_lost_marker:
        _check_lost_marker(part, memory, tool, samples[-1])


def _check_arguments(part: WatchedPart, tool: Tool, samples: list[Sample]) -> None:
    """Check that no method changes the sample that it receives."""
    memory = part.call("init")
    for sample in samples:
        given = _copy(sample)
        memory = part.call("update", memory, tool, given)
        _require_unchanged(part, "update", given, sample)
        part.call("jacobian", memory, tool, given)
        _require_unchanged(part, "jacobian", given, sample)


def _check_pure(part: WatchedPart, tool: Tool, samples: list[Sample]) -> Any:
    """Check that the memory alone holds the state, and return it after all samples."""
    memories, results = _update_all(part, tool, samples)
    _, replayed = _update_all(part, tool, samples)
    finding = "returned two results for one sequence of samples: a state outside of its memory"
    part.require(replayed == results, "update", finding)
    for memory, sample, result in zip(memories[:-1], samples, results, strict=True):
        again = _observe(part, part.call("update", memory, tool, _copy(sample)), tool, sample)
        finding = "changed its memory in place, expected a new one and the old one unchanged"
        part.require(again == result, "update", finding)
    return memories[-1]


def _update_all(
    part: WatchedPart, tool: Tool, samples: list[Sample]
) -> tuple[list[Any], list[list[bytes]]]:
    """Return the memories before the first and after each sample, and the results of each."""
    memories, results = [part.call("init")], list[list[bytes]]()
    for sample in samples:
        memories.append(part.call("update", memories[-1], tool, _copy(sample)))
        results.append(_observe(part, memories[-1], tool, sample))
    return memories, results


def _observe(part: WatchedPart, memory: Any, tool: Tool, sample: Sample) -> list[bytes]:
    """Return all that an estimator reports about a sample, to compare it bit by bit."""
    sample = _copy(sample)
    reports = (
        part.call("jacobian", memory, tool, sample),
        part.call("filtered_markers", memory, tool, sample),
        part.call("predict", memory, tool, sample.p1),
        part.call("recorded_numbers", memory),
        part.call("imaged_rcm", memory),
    )
    return [r.tobytes() if isinstance(r, np.ndarray) else repr(r).encode() for r in reports]


def _place_in_prediction(part: WatchedPart, memory: Any, tool: Tool, sample: Sample) -> Sample:
    """Return a sample with the markers and the imaged RCM that the estimator predicts."""
    rcm, predicted = part.call("imaged_rcm", memory), part.call("predict", memory, tool, sample.p1)
    o_c = sample.o_c if rcm is None else np.array(rcm[0], dtype=np.float64)
    if predicted is None:
        return sample._replace(o_c=o_c)
    m = np.array(predicted, dtype=np.float64)
    error, shift = np.abs(m - shift_to_rcm(sample.points, o_c)).max(), np.abs(o_c).max()
    is_raw = bool(np.abs(m - sample.points.ravel()).max() < min(error, shift))
    part.require(not is_raw, "predict", "returned raw px, expected px from the imaged RCM o_c")
    return sample._replace(points=m.reshape(2, 2) + o_c, o_c=o_c)


def _check_units(part: WatchedPart, memory: Any, tool: Tool, sample: Sample) -> None:
    """Check each row of Ĵ against the true Jacobian of the made-up camera."""
    J = np.asarray(part.call("jacobian", memory, tool, _copy(sample)))
    J_true = _differentiate_camera(tool, sample.p1)
    for (feature, unit), row, true in zip(FEATURE_UNITS, J, J_true, strict=True):
        scale = float(row @ true / (true @ true))
        guess = ": degrees instead of rad?" if unit == "rad" and 40.0 < scale < 80.0 else ""
        finding = f"returned a row of {feature} that is {scale:.3g} times the true one in {unit}/mm"
        part.require(MIN_SCALE <= scale <= MAX_SCALE, "jacobian", f"{finding}{guess}")


def _differentiate_camera(tool: Tool, p1: Floats) -> Floats:
    """Return the true J (3, 3) of [s r d] with respect to p₁, for the made-up samples."""

    def measure(p: Floats) -> Floats:
        sample = make_trial_sample(tool, p, 0.0)
        return compute_features(shift_to_rcm(sample.points, sample.o_c))

    return _differentiate(measure, p1)


def _differentiate(function: Any, p1: Floats) -> Floats:
    """Return the derivative (n, 3) of a function of p₁ (3,) by central differences."""
    steps = DIFFERENCE_STEP_MM * np.eye(3)
    columns = [(function(p1 + h) - function(p1 - h)) / (2.0 * DIFFERENCE_STEP_MM) for h in steps]
    return np.stack(columns, axis=1)


def _check_derivatives(
    part: WatchedPart, memory: Any, tool: Tool, sample: Sample, has_markers_jacobian: bool
) -> None:
    """Check both Jacobians against the derivative of the prediction, and against eq. (15)."""

    def predict(p1: Floats) -> Floats:
        return np.asarray(part.call("predict", memory, tool, p1), dtype=np.float64)

    def measure(p1: Floats) -> Floats:
        return compute_features(predict(p1))

    J = np.asarray(part.call("jacobian", memory, tool, _copy(sample)))
    predicts = part.call("predict", memory, tool, sample.p1) is not None
    if predicts:
        expected = "is not the derivative of the features of its predict()"
        _require_close(part, "jacobian", J, _differentiate(measure, sample.p1), expected)
    if not has_markers_jacobian:
        return
    M = np.asarray(part.call("markers_jacobian", memory, tool, _copy(sample)))
    if predicts:
        expected = "is not the derivative of its predict()"
        _require_close(part, "markers_jacobian", M, _differentiate(predict, sample.p1), expected)
    product = compute_features_jacobian(shift_to_rcm(sample.points, sample.o_c)) @ M
    expected = "is not ∂y/∂m times its markers_jacobian(), eq. (15)"
    _require_close(part, "jacobian", J, product, expected)


def _require_close(
    part: WatchedPart, method: str, value: Floats, expected: Floats, finding: str
) -> None:
    """Raise the violation if a row of a Jacobian differs from the expected one."""
    limits = MAX_JACOBIAN_ERROR * np.maximum(np.abs(expected).max(axis=1), 1e-6)
    errors = np.abs(value - expected).max(axis=1)
    row = int(np.argmax(errors / limits))
    numbers = (np.array2string(array[row], precision=4) for array in (value, expected))
    finding = f"{finding}: row {row} is {', expected '.join(numbers)}"
    part.require(bool((errors <= limits).all()), method, finding)


def _check_lost_marker(part: WatchedPart, memory: Any, tool: Tool, sample: Sample) -> None:
    """Check that an estimator which tolerates a lost marker supplies it."""
    for lost in range(2):
        given = _copy(sample)
        given.points[lost] = np.nan
        updated = part.call("update", memory, tool, given)
        points = np.asarray(part.call("filtered_markers", updated, tool, _copy(given)))
        finding = f"returned NaN for marker {lost + 1}, which the class says it supplies if lost"
        part.require(bool(np.isfinite(points).all()), "filtered_markers", finding)


def _copy(sample: Sample) -> Sample:
    p1, points, o_c, dt, sizes = sample
    return Sample(p1.copy(), points.copy(), o_c.copy(), dt, sizes.copy())


def _require_unchanged(part: WatchedPart, method: str, given: Sample, sample: Sample) -> None:
    arrays = ((given[i], sample[i]) for i in (0, 1, 2, 4))
    is_unchanged = all(np.array_equal(a, b, equal_nan=True) for a, b in arrays)
    part.require(is_unchanged, method, "changed the sample in place, expected it unchanged")
