"""Calls of a feature vector that is measured in Python.

`check_feature_vector` refuses a faulty one before the drive is enabled. In motion a failure becomes
a message and a fault, and never ends the loop.
"""

import numpy as np

from rcmservo.control.feature_vectors import FeatureVector, MarkerPair
from rcmservo.errors import BadInput, require, shorten_to_line
from rcmservo.interfaces import Floats

TRIAL_MARKERS = MarkerPair(
    np.array([[300.0, 180.0], [330.0, 260.0]]), np.array([6.0, 7.0]), np.array([320.0, 100.0])
)
"""Markers with which a feature vector is checked."""

DIFFERENCE_STEP_PX = 1e-3
"""Step of a coordinate in px for finite differences."""

MAX_JACOBIAN_ERROR = 1e-4
"""Largest error of a Jacobian relative to its largest number."""


def linearise(
    vector: FeatureVector, markers: MarkerPair, target: MarkerPair, motion: Floats
) -> tuple[Floats, Floats, str]:
    """Return error (n,), Jacobian (n, 3) and failure message of a feature vector.

    Error and Jacobian are NaN if the feature vector fails; the message is empty if it does not.
    """
    n = len(vector.units)
    try:
        error, J = vector.linearise(markers, target, motion)
        if error.shape != (n,) or J.shape != (n, 3):
            failure = f"returned an error of shape {error.shape} and a Jacobian of shape {J.shape}"
            failure = f"{failure}, expected ({n},) and ({n}, 3)"
        elif np.isfinite(motion).all() and not np.isfinite(J[np.isfinite(error)]).all():
            failure = "returned a Jacobian that is not finite"
        else:
            return error, J, ""
    except Exception as error:  # of any kind: the loop must reach its fault
        failure = f"raised {shorten_to_line(repr(error))}"
    unknown = np.full((n, 3), np.nan)
    return unknown[:, 0], unknown, f"feature vector {vector.name} {failure}"


def check_feature_vector(vector: FeatureVector) -> None:
    """Call a feature vector with made-up markers and compare its Jacobian with finite differences.

    Raises
    ------
    BadInput
        If it fails, or if its Jacobian is not the derivative of its features.
    """
    _, _, failure = linearise(vector, TRIAL_MARKERS, TRIAL_MARKERS, np.ones((6, 3)))
    if failure:
        raise BadInput("controller.features", vector.name, f"one that works; {failure}")
    J, n = vector.jacobian(TRIAL_MARKERS), len(vector.units)
    coordinates = 6 if vector.needs_sizes else 4
    expected = f"one with a jacobian of shape ({n}, {coordinates})"
    require(J.shape == (n, coordinates), "controller.features", vector.name, expected)
    max_error = MAX_JACOBIAN_ERROR * max(np.abs(J).max(), 1.0)
    for k in range(coordinates):
        after = _measure_moved(vector, k, DIFFERENCE_STEP_PX)
        before = _measure_moved(vector, k, -DIFFERENCE_STEP_PX)
        slope = (after - before) / (2.0 * DIFFERENCE_STEP_PX)
        is_derivative = bool(np.abs(slope - J[:, k]).max() <= max_error)
        expected = "one whose jacobian is the derivative of its measure"
        require(is_derivative, "controller.features", vector.name, expected)


def _measure_moved(vector: FeatureVector, k: int, step: float) -> Floats:
    """Return the features with coordinate k moved, as an error, so that angles wrap."""
    numbers = np.concatenate([TRIAL_MARKERS.points.ravel(), TRIAL_MARKERS.sizes])
    numbers[k] += step
    markers = MarkerPair(numbers[:4].reshape(2, 2), numbers[4:], TRIAL_MARKERS.o_c)
    return vector.linearise(markers, TRIAL_MARKERS, np.zeros((6, 3)))[0]
