"""Backlash of the joints, fitted to the frames of a run.

The encoders at the motors do not show the backlash β of a joint. The joint of the tool is at q + l,
with the motor at q and the lost motion l, which each step Δq of the motor changes:

    l ← min(max(l − Δq, −β/2), β/2)

The fit is the β at which a camera's projection, itself fitted to the joints of the tool, leaves the
smallest residuals of both markers. A shaft that friction bends has residuals that look alike.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rcmservo.estimation.camera_fit import ProjectionFit, make_initial_fit, update_fit
from rcmservo.estimation.camera_fit_prediction import predict_markers
from rcmservo.geometry.kinematics import RcmStruct, compute_position
from rcmservo.geometry.tool import ToolStruct
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.least_squares import (
    compute_jackknife_covariance,
    differentiate,
    fit_residuals,
)

Indices = NDArray[np.int_]

EXPECTED_BACKLASH = np.array([0.01, 0.01, 1.0])
"""Usual size of backlash (rad, rad, mm), the prior standard deviation and the unit of the fit."""

INITIAL_BACKLASH = 0.2
"""Initial value of the fit, in these units."""

MIN_SPACING_MM = 0.3
"""Motion of marker 1 (mm) from one frame of the fit to the next."""

FRAME_COUNT_RANGE = 30, 400
"""Smallest and largest number of these frames; later ones are not used."""

MAD_TO_STD = 1.4826
"""Ratio of the standard deviation of Gaussian noise to its median absolute deviation."""

MIN_NOISE_PX, MAX_SIGMAS = 0.02, 10.0
"""Smallest assumed noise (px) of a marker, and the largest residual of a marker, in noise."""

MAX_RESIDUAL_PX = 1.5
"""Largest rms residual (px); a larger one shows a camera that moved, or wrong frames."""

MIN_SIGMAS = 6.0
"""Size of a backlash, in its standard deviations, from which it counts as found."""

MIN_BACKLASH = np.array([5e-4, 5e-4, 0.05])
"""Smallest backlash (rad, rad, mm) that counts as found."""


class BacklashFit(NamedTuple):
    """Backlash of the joints.

    Parameters
    ----------
    size : Floats
        Backlash (3,) in rad, rad, mm; 0 where none was found.
    deviation : Floats
        Standard deviation (3,) of the fit by the residuals.
    """

    size: Floats
    deviation: Floats


@compiled
def compute_lost_motion(q: Floats, backlash: float) -> Floats:
    """Return the lost motion (n,) of a joint, 0 at first, for the motor at q (n,)."""
    lost = np.zeros(len(q))
    for k in range(1, len(q)):
        lost[k] = min(max(lost[k - 1] + q[k - 1] - q[k], -0.5 * backlash), 0.5 * backlash)
    return lost


@compiled
def compute_residuals(
    fit: ProjectionFit,
    rcm: RcmStruct,
    shaft: ToolStruct,
    q: Floats,
    points: Floats,
    rows: Indices,
    backlash: Floats,
) -> Floats:
    """Return the residuals (m, 2, 2) px of the frames in `rows` (m,) with this backlash (3,).

    q (n, 3) are the joints and `points` (n, 2, 2) px the markers in all frames. `fit` is the
    initial fit, which the frames then change.
    """
    joints, residuals = q.copy(), np.empty((len(rows), 2, 2))
    for j in range(3):
        joints[:, j] += compute_lost_motion(q[:, j].copy(), backlash[j])
    for k in rows:
        update_fit(fit, compute_position(rcm, joints[k]), points[k], shaft)
    for i in range(len(rows)):
        p1 = compute_position(rcm, joints[rows[i]])
        residuals[i] = predict_markers(fit, p1, shaft) - points[rows[i]]
    return residuals


def select_frames(p1: Floats) -> Indices:
    """Return the rows of the positions p₁ (n, 3) mm that are apart by `MIN_SPACING_MM`."""
    rows, last = list[int](), np.full(3, np.inf)
    for k, p in enumerate(p1):
        if not np.linalg.norm(p - last) < MIN_SPACING_MM:
            rows.append(k)
            last = p
    return np.array(rows[: FRAME_COUNT_RANGE[1]], dtype=int)


def group_frames(q: Floats, rows: Indices, backlash: Floats) -> list[Indices]:
    """Return the residuals (m, 4) of each group of successive frames between two reversals.

    All joints of the tool keep their side of the motors in a group. Errors of the camera's model
    are alike there, and the backlash is found only if the other groups show it too.
    """
    lost = [compute_lost_motion(q[:, j].copy(), backlash[j])[rows] for j in range(3)]
    sides = np.sign(np.column_stack(lost))
    starts = 1 + np.flatnonzero((sides[1:] != sides[:-1]).any(axis=1))
    return np.split(np.arange(4 * len(rows)).reshape(-1, 4), starts)


def fit_backlash(
    rcm: RcmStruct, shaft: ToolStruct, q: Floats, points: Floats
) -> BacklashFit | None:
    """Fit the backlash of the joints to the frames of a run.

    Parameters
    ----------
    rcm : RcmStruct
        Kinematics of marker 1.
    shaft : ToolStruct
        Positions of the markers on the tool.
    q : Floats
        Joints (n, 3) rad, rad, mm at the exposures of the frames, in their order, at the motors.
    points : Floats
        Markers (n, 2, 2) px.

    Returns
    -------
    BacklashFit or None
        Backlash; None if the tool moved too little, or if no camera fits the frames.
    """
    rows = select_frames(np.array([compute_position(rcm, joints) for joints in q]).reshape(-1, 3))
    if len(rows) < FRAME_COUNT_RANGE[0]:
        return None

    def compute(x: Floats) -> Floats:
        fit, backlash = make_initial_fit().rows[0], np.abs(x) * EXPECTED_BACKLASH
        residuals = compute_residuals(fit, rcm, shaft, q, points, rows, backlash)
        return np.nan_to_num(residuals, nan=np.inf, posinf=np.inf, neginf=-np.inf)

    noise = max(MAD_TO_STD * float(np.median(np.abs(compute(np.zeros(3))))), MIN_NOISE_PX)

    def compute_all(unknowns: Floats) -> Floats:
        markers = np.array([compute(x).ravel() for x in unknowns]) / noise
        return np.hstack([np.clip(markers, -MAX_SIGMAS, MAX_SIGMAS), unknowns])

    if not noise < MAX_RESIDUAL_PX:
        return None
    x = fit_residuals(compute_all, np.full(3, INITIAL_BACKLASH)).x
    residuals, jacobian = differentiate(compute_all, x)
    if not noise * np.sqrt(np.mean(residuals[:-3] ** 2)) < MAX_RESIDUAL_PX:
        return None
    size = np.abs(x) * EXPECTED_BACKLASH
    groups = group_frames(q, rows, size)
    covariance = compute_jackknife_covariance(residuals, jacobian, groups)
    deviation = np.sqrt(np.diag(covariance)) * EXPECTED_BACKLASH
    is_found = (size > MIN_SIGMAS * deviation) & (size > MIN_BACKLASH)
    return BacklashFit(np.where(is_found, size, 0.0), deviation)
