"""Call of a feature vector that is measured in Python. A failure is refused before the drive is on;
in motion it becomes a sentence and a fault, and never ends the loop.
"""

import numpy as np

from rcmservo.control.feature_vectors import FeatureVector, MarkerPair
from rcmservo.errors import BadInput, one_line, require
from rcmservo.interfaces import Floats

SAMPLE = MarkerPair(
    np.array([[300.0, 180.0], [330.0, 260.0]]), np.array([6.0, 7.0]), np.array([320.0, 100.0])
)
"""Markers that a feature vector is tried on."""

STEP = 1e-3
"""px by which a coordinate moves for a finite difference."""

TOLERANCE = 1e-4
"""Largest error of a Jacobian, relative to its largest number."""


def linearise(
    vector: FeatureVector, markers: MarkerPair, target: MarkerPair, motion: Floats
) -> tuple[Floats, Floats, str]:
    """Return error (n,) and Jacobian (n, 3) of a feature vector, NaN where it fails, and how it
    failed; empty if it did not.
    """
    n = len(vector.units)
    try:
        error, J = vector.linearise(markers, target, motion)
        if error.shape == (n,) and J.shape == (n, 3):
            return error, J, ""
        what = f"gave an error of shape {error.shape} and a Jacobian of shape {J.shape}"
        what = f"{what}, not ({n},) and ({n}, 3)"
    except Exception as error:  # whatever it is, the loop goes on to its fault
        what = f"raised {one_line(repr(error))}"
    lost = np.full((n, 3), np.nan)
    return lost[:, 0], lost, f"feature vector {vector.name} {what}"


def examine_features(vector: FeatureVector) -> None:
    """Try a feature vector on made-up markers.

    Raises
    ------
    BadInput
        If it fails, or its Jacobian is not the derivative of what it measures.
    """
    _, _, failure = linearise(vector, SAMPLE, SAMPLE, np.ones((6, 3)))
    if failure:
        raise BadInput("controller.features", vector.name, f"one that works; {failure}")
    J, count = vector.jacobian(SAMPLE), 6 if vector.needs_sizes else 4
    right = f"one with a jacobian of shape ({len(vector.units)}, {count})"
    require(J.shape == (len(vector.units), count), "controller.features", vector.name, right)
    for k in range(count):
        slope = (_measured(vector, k, STEP) - _measured(vector, k, -STEP)) / (2.0 * STEP)
        good = np.abs(slope - J[:, k]).max() <= TOLERANCE * max(np.abs(J).max(), 1.0)
        right = "one whose jacobian is the derivative of its measure"
        require(bool(good), "controller.features", vector.name, right)


def _measured(vector: FeatureVector, k: int, step: float) -> Floats:
    """The features of the sample with coordinate k moved, as an error, so that angles wrap."""
    numbers = np.concatenate([SAMPLE.points.ravel(), SAMPLE.sizes])
    numbers[k] += step
    markers = MarkerPair(numbers[:4].reshape(2, 2), numbers[4:], SAMPLE.o_c)
    return vector.linearise(markers, SAMPLE, np.zeros((6, 3)))[0]
