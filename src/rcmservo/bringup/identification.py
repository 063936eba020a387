"""Identification of an arm and its camera from joints and markers by nonlinear least squares.

The camera is unknown, but it is a camera: square pixels, an optical axis near the middle of the
picture, a lens that distorts little. Marker positions P, eq. (2), of which no such camera makes the
picture are invalid. With X = R (P − P₀) + (a, b, 1) Z in the axes of the camera and the slopes
s = (X₁, X₂) / X₃, the picture

    m = f (1 + k |s|²) s + c

is fitted to all observations at once, over R, a, b, Z, f, c, k and the free corrections of the arm.
Prior knowledge of f, c, k and of the corrections counts as a measurement.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, cast

import numpy as np

from rcmservo.geometry.kinematics import Kinematics, Rcm, position
from rcmservo.geometry.tool import RIGID, Shaft, Tool, second_marker
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled

ZERO, SPACING = 3, 4
"""Indices of the corrections of an arm that follow those of the motion of joints 1, 2 and 3."""
CORRECTION_PRIOR = np.array([2.0, 2.0, 2.0, 50.0, 2.0])
"""Standard deviations of the corrections before anything is observed: logarithms of factors on the
motion of each joint, mm of the zero of the insertion, logarithm of a factor on the spacing."""

FOCAL_WIDTHS = 1.2
"""Likely focal length in widths of the picture."""
CAMERA_UNITS = np.array([0.5, 0.5, 0.5, 0.1, 0.1, 0.5, 0.6, 0.025, 0.025, 0.15])
"""Units of the unknowns of the camera: Rodrigues vector of R (half a rad), picture of P₀ (widths of
the picture), log f/Z, log f, c (widths) and k. Those of the last four are their standard deviations
before anything is observed.

The picture of P₀ and f/Z replace a, b and Z: observations determine these best, and the search
takes several times fewer steps.
"""
WITHOUT_PRIOR = 6
"""Number of leading unknowns of the camera without a prior."""

CROSS_PRODUCTS = np.cross(np.eye(3), np.eye(3)[:, None]).reshape(3, 9)
"""Matrices K₁, K₂, K₃ (3, 9) with ω × x = (ω₁ K₁ + ω₂ K₂ + ω₃ K₃) x."""
RELATIVE_STEP = float(np.sqrt(np.finfo(float).eps))
"""Change of an unknown, relative to its size or to 1, for a difference of the residual."""
MAX_STEPS = 40
"""Steps of a fit at most."""
MIN_RELATIVE_GAIN = 1e-5
"""Relative decrease of the squared residuals at which a fit ends."""
MAX_RESIDUAL_PX = 1e3
"""Residual of a marker behind the camera, and of one still further off."""


@dataclass(frozen=True, eq=False)
class LeastSquaresFit:
    """Solution of a nonlinear least-squares problem.

    Parameters
    ----------
    x : Floats
        The unknowns (n,).
    covariance : Floats
        Their covariance (n, n) if the residuals are in standard deviations.
    misfit : float
        Sum of the squared residuals.
    """

    x: Floats
    covariance: Floats
    misfit: float


def fit_residuals(residuals: Callable[[Floats], Floats], x: Floats) -> LeastSquaresFit:
    """Minimise the squares of residuals within a trust region from `x` (n,).

    `residuals` takes m sets of unknowns (m, n) and returns (m, r): forward differences by all
    unknowns cost one call.
    """
    from scipy import optimize  # takes 0.1 s, which only a fit needs

    @lru_cache(maxsize=1)
    def differentiated(x: tuple[float, ...]) -> tuple[Floats, Floats]:
        """Return the residuals (r,) and their derivative (r, n)."""
        at = np.array(x)
        away = at + RELATIVE_STEP * np.maximum(1.0, np.abs(at)) * np.where(at < 0.0, -1.0, 1.0)
        here, *others = residuals(np.vstack([at, np.where(np.eye(len(at)), away, at)]))
        return here, (np.array(others) - here).T / (away - at)

    def residual(x: Floats) -> Floats:
        return differentiated(tuple(x))[0]

    def jacobian(x: Floats) -> Floats:
        return differentiated(tuple(x))[1]

    least_squares = cast(Any, optimize).least_squares
    fit: Any = least_squares(residual, x, jacobian, ftol=MIN_RELATIVE_GAIN, max_nfev=MAX_STEPS)
    J: Floats = fit.jac
    covariance = np.asarray(np.linalg.pinv(J.T @ J), np.float64)
    return LeastSquaresFit(fit.x, covariance, 2.0 * float(fit.cost))


@dataclass(frozen=True, eq=False)
class MarkerViews:
    """Joints and markers at several poses, at rest.

    Parameters
    ----------
    q : Floats
        The measured joints (n, 3) in rad, rad, mm.
    points : Floats
        The markers (n, 2, 2) px, each the mean over many frames.
    noise : Floats
        Standard deviations (n,) of these means, px.
    size : tuple[int, int]
        Width and height of the picture, px.
    """

    q: Floats
    points: Floats
    noise: Floats
    size: tuple[int, int]

    def mirrored(self) -> "MarkerViews":
        """Return the same poses in a mirrored picture."""
        flipped = self.points * [-1.0, 1.0] + [self.size[0] - 1.0, 0.0]
        return MarkerViews(self.q, flipped, self.noise, self.size)


def identify(
    mechanism: Kinematics,
    tool: Tool,
    views: MarkerViews,
    free: Sequence[int] = (),
    begin: float = 0.0,
) -> LeastSquaresFit:
    """Fit a camera and the free corrections of an arm to joints and markers.

    Parameters
    ----------
    mechanism, tool
        The arm as its rig file describes it.
    views
        Joints and markers at rest. Motion is corrected about the first pose.
    free
        Indices (0 to 4) of the corrections to estimate; the others are 0.
    begin
        Value of the free corrections at which the search begins.

    Returns
    -------
    LeastSquaresFit
        Corrections (5,), 0 where one was not free, their covariance (5, 5), and the misfit.

    Notes
    -----
    The search is local: it may miss a factor far from `begin`. Motions of a few mm determine one
    correction at a time, not all five.
    """
    index, known = list(free), len(CAMERA_UNITS)
    units = CORRECTION_PRIOR[index]

    def correction(x: Floats) -> Floats:
        full = np.zeros(5)
        full[index] = x * units
        return full

    @lru_cache(maxsize=1 + len(index))
    def markers(x: tuple[float, ...]) -> Floats:
        return corrected_markers(mechanism, tool, views.q, correction(np.array(x)))

    x = np.concatenate([np.zeros(known), begin / units])
    camera = _Camera.about(markers(tuple(x[known:])), views)
    points, noise = views.points.reshape(-1, 2), np.repeat(views.noise, 2)[:, None]

    def residuals(unknowns: Floats) -> Floats:
        """Return the residuals (m, r) of m sets of unknowns (m, n)."""
        x = np.clip(unknowns, -50.0, 50.0)
        P = np.array([markers(tuple(row)) for row in x[:, known:]]).reshape(len(x), -1, 3)
        error = camera.project(x[:, :known] * CAMERA_UNITS, P) - points
        error = np.where(np.abs(error) < MAX_RESIDUAL_PX, error, MAX_RESIDUAL_PX) / noise
        return np.concatenate([error.reshape(len(x), -1), x[:, WITHOUT_PRIOR:]], axis=1)

    fit = fit_residuals(residuals, x)
    covariance = np.zeros((5, 5))
    covariance[np.ix_(index, index)] = fit.covariance[known:, known:] * np.outer(units, units)
    return LeastSquaresFit(correction(fit.x[known:]), covariance, fit.misfit)


@dataclass(frozen=True, eq=False)
class _Camera:
    """The camera at which a search begins.

    Parameters
    ----------
    rotation : Floats
        R (3, 3).
    centre : Floats
        P₀ (3,) mm, the mean of all markers.
    pixel : Floats
        Picture (2,) px of P₀.
    scale : float
        Size of the picture of P₀ in px per mm.
    size : Floats
        Width and height (2,) px of the picture.
    """

    rotation: Floats
    centre: Floats
    pixel: Floats
    scale: float
    size: Floats

    @classmethod
    def about(cls, markers: Floats, views: MarkerViews) -> "_Camera":
        """Return a distant camera that sees markers (n, 2, 3) mm about where they were observed.

        The vector between the markers weighs as much as all of their motion.
        """
        size, points = np.array(views.size, float), views.points
        P, m = markers - markers.mean(axis=0), points - points.mean(axis=0)
        along = (markers[:, 1] - markers[:, 0]).mean(axis=0)[None]
        between = (points[:, 1] - points[:, 0]).mean(axis=0)[None]
        weight = np.sqrt((P**2).sum() / (along**2).sum())
        of, to = np.vstack([*P, weight * along]), np.vstack([*m, weight * between])
        U, px_per_mm, V = np.linalg.svd(np.linalg.lstsq(of, to, rcond=1e-6)[0].T)
        rows = U @ V[:2]
        rotation = np.vstack([rows, np.cross(rows[0], rows[1])])
        pixel, centre = points.reshape(-1, 2).mean(axis=0), markers.reshape(-1, 3).mean(axis=0)
        return cls(rotation, centre, pixel, float(px_per_mm.mean()), size)

    def project(self, change: Floats, markers: Floats) -> Floats:
        """Return the picture (..., n, 2) px of markers (..., n, 3) mm after changes of the camera
        (..., 10) in the order of `CAMERA_UNITS`; NaN for a marker behind it.
        """
        R = _rotation(change[..., :3]) @ self.rotation
        focal = FOCAL_WIDTHS * self.size[0] * np.exp(change[..., None, 6:7])
        depth = focal / (self.scale * np.exp(change[..., None, 5:6]))
        axis = (self.size - 1.0) / 2.0 + self.size[0] * change[..., None, 7:9]
        aside = (self.pixel + self.size[0] * change[..., None, 3:5] - axis) / focal
        X = (markers - self.centre) @ R.swapaxes(-1, -2)
        X += depth * np.concatenate([aside, np.ones_like(focal)], axis=-1)
        slope = X[..., :2] / np.where(X[..., 2:] > 1e-2 * depth, X[..., 2:], np.nan)
        square = (slope**2).sum(axis=-1, keepdims=True)
        return axis + focal * slope * (1.0 + change[..., None, 9:] * square)


def _rotation(half_turns: Floats) -> Floats:
    """Return the rotations (..., 3, 3) of Rodrigues vectors (..., 3): axis times tan(angle / 2)."""
    K = (half_turns @ CROSS_PRODUCTS).reshape(*half_turns.shape[:-1], 3, 3)
    return np.eye(3) + 2.0 / (1.0 + (half_turns**2).sum(axis=-1)[..., None, None]) * (K + K @ K)


def corrected_markers(mechanism: Kinematics, tool: Tool, q: Floats, correction: Floats) -> Floats:
    """Return the markers (n, 2, 3) mm at the joints q (n, 3), corrected about the first of them."""
    rcm = mechanism.rcm(tool.offset)
    rcm = rcm._replace(zero=rcm.zero + correction[ZERO])
    motion = (q - q[0]) * np.exp(correction[:ZERO])
    return _markers(rcm, q[0] + motion, stretched(tool.shaft, correction[SPACING]))


@compiled
def _markers(rcm: Rcm, q: Floats, shaft: Shaft) -> Floats:
    """Return p₁ and p₂ (n, 2, 3) mm at the joints q (n, 3), eq. (2)."""
    markers = np.empty((len(q), 2, 3))
    for i in range(len(q)):
        markers[i, 0] = position(rcm, q[i])
        markers[i, 1] = second_marker(shaft, markers[i, 0])
    return markers


def stretched(shaft: Shaft, log_factor: float) -> Shaft:
    """Return the tool with its markers further apart by the factor exp(`log_factor`)."""
    factor = float(np.exp(log_factor))
    value = shaft.value * factor if shaft.kind == RIGID else 1.0 + (shaft.value - 1.0) * factor
    return Shaft(shaft.kind, value)
