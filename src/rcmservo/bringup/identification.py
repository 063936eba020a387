"""Identification of an arm and its camera from joints and markers by nonlinear least squares.

The pose and the intrinsic parameters of the camera are unknown. The model assumes square pixels,
an optical axis near the middle of the image and a small radial distortion. A marker at P, eq. (2),
has the position X in the frame of the camera, the slopes s and the pixels m:

    X = R (P − P₀) + (a, b, 1) Z        s = (X₁, X₂) / X₃        m = f (1 + k |s|²) s + c

P₀ is the mean of all markers. The fit uses all observations at once. Its unknowns are R, a, b, Z,
f, c, k, the free corrections of the arm and the backlash β of each joint. The encoders at the
motors do not show the backlash: where joint j has come from above, the tool is at qⱼ + βⱼ. Priors
on f, c, k, β and on the corrections enter as additional measurements. A large misfit shows that no
such camera projects the markers to the observed pixels.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from rcmservo.geometry.kinematics import Kinematics, RcmStruct, compute_position
from rcmservo.geometry.tool import RIGID, Tool, ToolStruct, compute_second_marker
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.least_squares import LeastSquaresFit, fit_residuals

ZERO, SPACING = 3, 4
"""Indices of the corrections of the insertion's zero and of the spacing of the markers. Indices 0
to 2 are the corrections of the motions of joints 1, 2 and 3."""
CORRECTION_PRIOR = np.array([2.0, 2.0, 2.0, 50.0, 2.0])
"""Prior standard deviations of the corrections: logarithm of a factor on the motion of joints 1 to
3, mm of the zero of the insertion, logarithm of a factor on the spacing of the markers."""
BACKLASH_PRIOR = np.array([0.01, 0.01, 1.0])
"""Prior standard deviations (rad, rad, mm) of the backlash of the joints."""
BACKLASH = slice(5, 8)
"""Indices of the backlash of joints 1 to 3, after the corrections."""

MEAN_FOCAL_WIDTHS = 1.2
"""Prior mean of the focal length, in image widths."""
CAMERA_UNITS = np.array([0.5, 0.5, 0.5, 0.1, 0.1, 0.5, 0.6, 0.025, 0.025, 0.15])
"""Units of the unknowns of the camera: Rodrigues vector of R (half a rad), pixel of P₀ (image
widths), log f/Z, log f, c (image widths) and k. For log f, c and k the units are the prior standard
deviations.

The pixel of P₀ and f/Z replace a, b and Z. The observations determine them best, and the search
takes several times fewer steps.
"""
UNKNOWNS_WITHOUT_PRIOR = 6
"""Number of leading unknowns of the camera that have no prior."""

CROSS_PRODUCTS = np.cross(np.eye(3), np.eye(3)[:, None]).reshape(3, 9)
"""Matrices K₁, K₂, K₃ (3, 9) with ω × x = (ω₁ K₁ + ω₂ K₂ + ω₃ K₃) x."""
MAX_UNKNOWN = 50.0
"""Largest absolute unknown, in its unit; it keeps the exponential functions of the model finite."""
MAX_RESIDUAL_PX = 1e3
"""Upper bound on the residual of a marker; also the residual of a marker behind the camera."""


@dataclass(frozen=True, eq=False)
class MarkerViews:
    """Joints and markers at several poses, at rest.

    Parameters
    ----------
    q : Floats
        Measured joints (n, 3) in rad, rad, mm.
    points : Floats
        Markers (n, 2, 2) in px, each the mean over many frames.
    noise : Floats
        Standard deviations (n,) of these means in px.
    size : tuple[int, int]
        Width and height of the image in px.
    descended : Floats
        1 for each joint (n, 3) whose last motion before a view was downwards, 0 for the others.
    """

    q: Floats
    points: Floats
    noise: Floats
    size: tuple[int, int]
    descended: Floats

    def mirrored(self) -> "MarkerViews":
        """Return the same poses in a mirrored image."""
        flipped = self.points * [-1.0, 1.0] + [self.size[0] - 1.0, 0.0]
        return replace(self, points=flipped)


def identify(
    mechanism: Kinematics,
    tool: Tool,
    views: MarkerViews,
    free: Sequence[int] = (),
    initial: float = 0.0,
) -> LeastSquaresFit:
    """Fit a camera and the free corrections of an arm to joints and markers.

    Parameters
    ----------
    mechanism, tool
        Kinematics and tool as the rig file describes them.
    views
        Joints and markers at rest. Corrections of a motion are relative to the first pose.
    free
        Indices (0 to 4) of the corrections to estimate; the others stay 0.
    initial
        Initial value of the free corrections.

    Returns
    -------
    LeastSquaresFit
        Corrections, 0 where not free, and backlash of the joints in rad, rad, mm: together (8,).
        Their covariance (8, 8), and the misfit.

    Notes
    -----
    The search is local: it may miss a factor far from `initial`. Motions of a few mm identify one
    correction at a time, not all five.
    """
    prior = np.concatenate([CORRECTION_PRIOR, BACKLASH_PRIOR])
    index, camera_count = [*free, *range(len(prior))[BACKLASH]], len(CAMERA_UNITS)
    units = prior[index]

    def expand_unknowns(x: Floats) -> Floats:
        """Return all corrections and the backlash (8,) from the unknowns in their units."""
        values = np.zeros(len(prior))
        values[index] = x * units
        return values

    @lru_cache(maxsize=1 + len(index))
    def compute_markers(x: tuple[float, ...]) -> Floats:
        values = expand_unknowns(np.array(x))
        correction, lost_motion = values[: BACKLASH.start], views.descended * values[BACKLASH]
        return compute_corrected_markers(mechanism, tool, views.q, correction, lost_motion)

    x = np.concatenate([np.zeros(camera_count), initial / units])
    x[camera_count + len(free) :] = 0.0
    camera = _Camera.fit_distant(compute_markers(tuple(x[camera_count:])), views)
    points, noise = views.points.reshape(-1, 2), np.repeat(views.noise, 2)[:, None]

    def compute_residuals(unknowns: Floats) -> Floats:
        """Return the residuals (m, r) of m sets of unknowns (m, n)."""
        x = np.clip(unknowns, -MAX_UNKNOWN, MAX_UNKNOWN)
        markers = [compute_markers(tuple(row)) for row in x[:, camera_count:]]
        P = np.array(markers).reshape(len(x), -1, 3)
        error = camera.project(x[:, :camera_count] * CAMERA_UNITS, P) - points
        error = np.where(np.abs(error) < MAX_RESIDUAL_PX, error, MAX_RESIDUAL_PX) / noise
        return np.concatenate([error.reshape(len(x), -1), x[:, UNKNOWNS_WITHOUT_PRIOR:]], axis=1)

    fit = fit_residuals(compute_residuals, x)
    covariance = np.zeros((len(prior), len(prior)))
    free_covariance = fit.covariance[camera_count:, camera_count:]
    covariance[np.ix_(index, index)] = free_covariance * np.outer(units, units)
    return LeastSquaresFit(expand_unknowns(fit.x[camera_count:]), covariance, fit.misfit)


@dataclass(frozen=True, eq=False)
class _Camera:
    """Camera at which the search starts.

    Parameters
    ----------
    rotation : Floats
        Rotation R (3, 3).
    centre : Floats
        P₀ (3,) in mm, the mean of all markers.
    pixel : Floats
        Pixel (2,) of P₀.
    scale : float
        Image scale at P₀ in px per mm.
    size : Floats
        Width and height (2,) of the image in px.
    """

    rotation: Floats
    centre: Floats
    pixel: Floats
    scale: float
    size: Floats

    @classmethod
    def fit_distant(cls, markers: Floats, views: MarkerViews) -> "_Camera":
        """Return a distant camera that projects `markers` (n, 2, 3) in mm near the observed ones.

        The fit is linear. The vector between the markers has the weight of all of their motion.
        """
        size, points = np.array(views.size, float), views.points
        P, m = markers - markers.mean(axis=0), points - points.mean(axis=0)
        mean_tool = (markers[:, 1] - markers[:, 0]).mean(axis=0)[None]
        mean_imaged_tool = (points[:, 1] - points[:, 0]).mean(axis=0)[None]
        weight = np.sqrt((P**2).sum() / (mean_tool**2).sum())
        mm, px = np.vstack([*P, weight * mean_tool]), np.vstack([*m, weight * mean_imaged_tool])
        U, px_per_mm, V = np.linalg.svd(np.linalg.lstsq(mm, px, rcond=1e-6)[0].T)
        right, down = list[Floats](U @ V[:2])
        rotation = np.vstack([right, down, np.cross(right, down)])
        pixel, centre = points.reshape(-1, 2).mean(axis=0), markers.reshape(-1, 3).mean(axis=0)
        return cls(rotation, centre, pixel, float(px_per_mm.mean()), size)

    def project(self, change: Floats, markers: Floats) -> Floats:
        """Return the pixels (..., n, 2) of `markers` (..., n, 3) in mm; NaN behind the camera.

        `change` (..., 10) modifies the camera, in the order of `CAMERA_UNITS`.
        """
        R = _compute_rotation(change[..., :3]) @ self.rotation
        focal = MEAN_FOCAL_WIDTHS * self.size[0] * np.exp(change[..., None, 6:7])
        depth = focal / (self.scale * np.exp(change[..., None, 5:6]))
        axis = (self.size - 1.0) / 2.0 + self.size[0] * change[..., None, 7:9]
        direction = (self.pixel + self.size[0] * change[..., None, 3:5] - axis) / focal
        X = (markers - self.centre) @ R.swapaxes(-1, -2)
        X += depth * np.concatenate([direction, np.ones_like(focal)], axis=-1)
        slope = X[..., :2] / np.where(X[..., 2:] > 1e-2 * depth, X[..., 2:], np.nan)
        square = (slope**2).sum(axis=-1, keepdims=True)
        return axis + focal * slope * (1.0 + change[..., None, 9:] * square)


def _compute_rotation(rodrigues: Floats) -> Floats:
    """Return rotations (..., 3, 3) from Rodrigues vectors (..., 3), axis times tan(angle / 2)."""
    K = (rodrigues @ CROSS_PRODUCTS).reshape(*rodrigues.shape[:-1], 3, 3)
    return np.eye(3) + 2.0 / (1.0 + (rodrigues**2).sum(axis=-1)[..., None, None]) * (K + K @ K)


def compute_corrected_markers(
    mechanism: Kinematics,
    tool: Tool,
    q: Floats,
    correction: Floats,
    lost_motion: Floats | float = 0.0,
) -> Floats:
    """Return the markers (n, 2, 3) in mm at the joints `q` (n, 3) with a `correction` (5,).

    Corrections of a motion are relative to the first joints, `q[0]`. The joints of the tool differ
    from the corrected ones by `lost_motion` (n, 3) in rad, rad, mm.
    """
    rcm = mechanism.to_struct(tool.offset)
    rcm = rcm._replace(zero=rcm.zero + correction[ZERO])
    motion = (q - q[0]) * np.exp(correction[:ZERO])
    joints = q[0] + motion + lost_motion
    return _compute_markers(rcm, joints, scale_spacing(tool.struct, correction[SPACING]))


@compiled
def _compute_markers(rcm: RcmStruct, q: Floats, shaft: ToolStruct) -> Floats:
    """Return p₁ and p₂ (n, 2, 3) in mm at the joints `q` (n, 3), eq. (2)."""
    markers = np.empty((len(q), 2, 3))
    for i in range(len(q)):
        markers[i, 0] = compute_position(rcm, q[i])
        markers[i, 1] = compute_second_marker(shaft, markers[i, 0])
    return markers


def scale_spacing(shaft: ToolStruct, log_factor: float) -> ToolStruct:
    """Return the tool with the distance between its markers scaled by exp(`log_factor`)."""
    factor = float(np.exp(log_factor))
    value = shaft.value * factor if shaft.kind == RIGID else 1.0 + (shaft.value - 1.0) * factor
    return ToolStruct(shaft.kind, value)
