"""Contract of a feature vector: declared units, a true Jacobian, and pure functions."""

import numpy as np

from rcmservo.control.feature_vectors import FeatureVector, MarkerPair, check_declaration
from rcmservo.errors import shorten_to_line
from rcmservo.servo.user_features import TRIAL_MARKERS
from rcmservo.servo.user_features import check_feature_vector as check_before_motion
from rcmservo.testing.violations import WatchedPart, report_violations

TRIAL_TURNS = 24
"""Number of directions in which the image of the tool is turned about the imaged RCM."""

MAX_ANGLE_RAD = 2.0 * np.pi
"""Largest plausible number of a component in rad."""


def check_feature_vector(vector: FeatureVector) -> None:
    """Check a feature vector against its contract with made-up markers.

    Parameters
    ----------
    vector : FeatureVector
        Feature vector of the user. It is not registered.

    Raises
    ------
    ContractViolation
        With the first violation in one sentence: invalid components or units, an exception, arrays
        of another shape, a Jacobian that is not the derivative of the features, an angle that is
        not in rad, changed arguments, or a result that depends on a hidden state.
    """
    with report_violations():
        check_declaration(vector)
    part, n = WatchedPart(vector), len(vector.units)
    _check_pure(part, "measure", (n,))
    _check_pure(part, "jacobian", (n, 6 if vector.needs_sizes else 4))
    with report_violations():
        check_before_motion(vector)
    _check_angles(part, vector)


def _check_pure(part: WatchedPart, method: str, shape: tuple[int, ...]) -> None:
    """Check that a method changes nothing, and returns new arrays of the same numbers."""
    markers = MarkerPair(*(array.copy() for array in TRIAL_MARKERS))
    first = part.call(method, markers)
    finding = f"returned {shorten_to_line(repr(first))}, expected an array of shape {shape}"
    part.require(getattr(first, "shape", None) == shape, method, finding)
    is_unchanged = all(
        a.tobytes() == b.tobytes() for a, b in zip(markers, TRIAL_MARKERS, strict=True)
    )
    part.require(is_unchanged, method, "changed the markers in place, expected them unchanged")
    part.require(bool(np.isfinite(first).all()), method, f"returned {first}, expected numbers")
    numbers = first.copy()
    part.call(method, _turn(markers, 1.0))
    finding = "overwrote the array of an earlier result, expected a new array"
    part.require(first.tobytes() == numbers.tobytes(), method, finding)
    again = part.call(method, markers)
    finding = "returned two results for the same markers, expected a pure function"
    part.require(again.tobytes() == numbers.tobytes(), method, finding)


def _check_angles(part: WatchedPart, vector: FeatureVector) -> None:
    """Check that the components in rad are no degrees, for the tool in every direction."""
    angles = np.linspace(0.0, 2.0 * np.pi, TRIAL_TURNS, endpoint=False)
    values = np.stack([part.call("measure", _turn(TRIAL_MARKERS, angle)) for angle in angles])
    for name, is_angle, largest in zip(
        vector.components, vector.angles, np.abs(values).max(axis=0), strict=True
    ):
        finding = f"returned {largest:.4g} for the component {name!r}, which is declared in rad"
        part.require(not is_angle or largest <= MAX_ANGLE_RAD, "measure", f"{finding}: degrees?")


def _turn(markers: MarkerPair, angle: float) -> MarkerPair:
    """Return markers that are turned about the imaged RCM by an angle in rad."""
    c, s = np.cos(angle), np.sin(angle)
    turned = (markers.points - markers.o_c) @ np.array([[c, s], [-s, c]]) + markers.o_c
    return MarkerPair(turned, markers.sizes.copy(), markers.o_c.copy())
