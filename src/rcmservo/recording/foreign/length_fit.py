"""Lengths of an arm and its tool by the pixels of a recording, with 95 % intervals.

The camera is unknown. By the rig file the markers lie at ρ n and (ρ + l) n, with the tool's
direction n from the RCM. Their actual positions P_k and pixels m_k are

    P₁ = (ρ + ζ) n + a₁ e₁ + b₁ e₂            w = A x̄ / (1 + gᵀx),    x = (P − P₀) / 100 mm
    P₂ = (ρ + ζ + l + δ) n + a₂ e₁ + b₂ e₂    m = m₀ + c + (1 + κ |w − c|²/r²) (w − c)

ζ corrects the zero of the insertion, and δ the spacing l. a_k and b_k are the offsets of marker k
from the tool's axis, in the directions e₁ and e₂ in which joints 1 and 2 move it. A and g are the
projection of estimation/camera_fit.py, κ is the radial distortion about m₀ + c, and r is the root
mean square distance of the pixels from their mean m₀. One fit determines all 20 numbers; wide
priors keep finite what the motion does not determine.

Errors of the arm and the lens are alike in both markers and in neighbouring frames. The intervals
are therefore those of the jackknife: groups of consecutive frames are left out one after another,
and the changes of the fit are its standard errors. The scale of the joints and the zeros of the
angles count as exact.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from rcmservo.estimation.base import Sample
from rcmservo.estimation.camera_fit import MIN_FRAME_SPACING_MM, UNIT_LENGTH_MM
from rcmservo.geometry.kinematics import MIN_LEVER, Kinematics, compute_axis_jacobian
from rcmservo.geometry.tool import RIGID, Tool
from rcmservo.interfaces import Floats
from rcmservo.numerics.least_squares import (
    compute_jackknife_covariance,
    differentiate,
    fit_residuals,
)

MAX_HALF_WIDTH_MM = 5.0
"""Largest half width (mm) of the 95 % interval of a determined length."""

LENGTH_PRIOR_MM = 50.0
"""Prior standard deviation (mm) of each correction and offset. A motion that leaves an interval of
this half width or more does not determine the length at all."""

A, G, KAPPA, C, LENGTHS = slice(0, 8), slice(8, 11), slice(11, 12), slice(12, 14), slice(14, 20)
"""Indices of the unknowns; the lengths are ζ, δ, a₁, b₁, a₂, b₂."""
PRIOR = np.repeat([1e4, 3.0, 0.05, 1.0, LENGTH_PRIOR_MM], [8, 3, 1, 2, 6])
"""Units of the unknowns: the standard deviations of their priors, whose mean is 0. A is in px, c in
multiples of r and the lengths are in mm."""

MIN_DEPTH = 0.02
"""Smallest relative depth 1 + gᵀx."""

INITIAL_NOISE_PX, MIN_NOISE_PX = 1.0, 0.01
"""Standard deviation (px) of the residuals before a fit, and the smallest one after it."""

MIN_FRAMES, MAX_FRAMES = 10, 300
"""Smallest and largest number of frames in a fit: fewer do not show how large the errors are, and
more would only take longer."""

GROUP_COUNT = 30
"""Largest number of groups of frames that are left out."""

PROBABILITY = 0.95
"""Probability of the intervals."""


@dataclass(frozen=True)
class LengthEstimate:
    """A length of the arm or the tool by the pixels of a recording.

    Parameters
    ----------
    name : str
        Name of the length.
    described : float
        Length in mm by the rig file; 0 for an offset from the tool's axis.
    value : float
        Length in mm by the pixels.
    half_width : float
        Half width in mm of the 95 % interval about `value`; infinite if the motion does not
        determine the length at all.
    """

    name: str
    described: float
    value: float
    half_width: float

    @property
    def is_determined(self) -> bool:
        """True if the motion determines the length to ± `MAX_HALF_WIDTH_MM`."""
        return self.half_width <= MAX_HALF_WIDTH_MM


def fit_lengths(
    mechanism: Kinematics, tool: Tool, samples: Sequence[Sample]
) -> list[LengthEstimate]:
    """Estimate the lengths of an arm and its tool, together with an unknown camera.

    Parameters
    ----------
    mechanism, tool
        Kinematics and tool as the rig file describes them.
    samples
        Frames with both markers, in the order in which they were recorded. Those whose marker 1 has
        moved by less than 0.3 mm do not count.

    Returns
    -------
    list of LengthEstimate
        Zero of the insertion, spacing of the markers, and the offsets of markers 1 and 2 from the
        tool's axis in the directions of joints 1 and 2. With fewer than `MIN_FRAMES` frames that
        count, none of them is determined. The list is empty for a scaled tool, whose spacing is not
        constant.

    Notes
    -----
    Errors that repeat at every pose are in no residual. Hinge axes that pass each other count as an
    offset of both markers. In rendered pictures of an arm without any error, the tracker's errors
    exceed one in five of the intervals, which are 0.2 mm there.

    References
    ----------
    B. Efron and C. Stein, The jackknife estimate of variance, Annals of Statistics, 1981.
    """
    if tool.kind != RIGID:
        return []
    frames = _select_frames(samples)
    joints = mechanism.joint_names[:2]
    offsets = [f"marker_{k}_off_axis_along_{joint}" for k in (1, 2) for joint in joints]
    names = ["insertion_zero", "spacing", *offsets]
    described = np.array([mechanism.insertion_zero, tool.value, 0.0, 0.0, 0.0, 0.0])
    correction, half_width = np.zeros(6), np.full(6, np.inf)
    if len(frames) >= MIN_FRAMES:
        correction, half_width = _LengthProblem.of(mechanism, tool, frames).solve()
        half_width[half_width >= LENGTH_PRIOR_MM] = np.inf
    rows = zip(names, described, described + correction, half_width, strict=True)
    return [LengthEstimate(name, *map(float, numbers)) for name, *numbers in rows]


def _select_frames(samples: Sequence[Sample]) -> list[Sample]:
    """Return frames some distance apart, so that a tool at rest does not outweigh its motion."""
    frames = [samples[0]]
    for sample in samples[1:]:
        if np.linalg.norm(sample.p1 - frames[-1].p1) >= MIN_FRAME_SPACING_MM:
            frames.append(sample)
    return frames[:: -(-len(frames) // MAX_FRAMES)]


@dataclass(frozen=True, eq=False)
class _LengthProblem:
    """Least-squares problem of the module's equations for n frames.

    Parameters
    ----------
    x : Floats
        Markers x (2 n, 3) by the rig file, frame by frame.
    derivative : Floats
        Derivative (6 n, 6) of x with respect to the lengths in mm.
    points : Floats
        Observed markers (2 n, 2) in px from m₀.
    """

    x: Floats
    derivative: Floats
    points: Floats

    @classmethod
    def of(cls, mechanism: Kinematics, tool: Tool, frames: Sequence[Sample]) -> "_LengthProblem":
        """Return the problem for these frames."""
        p1 = np.array([frame.p1 for frame in frames])
        points = np.array([frame.points for frame in frames])
        n = p1 / np.linalg.norm(p1, axis=1, keepdims=True)
        rcm = mechanism.to_struct(tool.offset)
        levers = np.array([compute_axis_jacobian(rcm, mechanism.joints(p)) for p in p1])
        e = levers / np.maximum(np.linalg.norm(levers, axis=2, keepdims=True), MIN_LEVER)
        P, derivative = np.stack([p1, p1 + tool.value * n], axis=1), np.zeros((len(n), 2, 3, 6))
        derivative[..., 0], derivative[:, 1, :, 1] = n[:, None], n
        for k in range(2):
            derivative[:, k, :, 2 + 2 * k : 4 + 2 * k] = e.swapaxes(1, 2)
        x = (P - P.mean(axis=(0, 1))).reshape(-1, 3) / UNIT_LENGTH_MM
        m = (points - points.mean(axis=(0, 1))).reshape(-1, 2)
        return cls(x, derivative.reshape(-1, 6) / UNIT_LENGTH_MM, m)

    def project(self, unknowns: Floats) -> Floats:
        """Return the markers (m, 2 n, 2) in px from m₀ for m sets of unknowns (m, 20)."""
        values = unknowns * PRIOR
        numerator = values[:, A].reshape(-1, 2, 4)
        moved = values[:, LENGTHS] @ self.derivative.T
        x = self.x + moved.reshape(len(values), -1, 3)
        depth = np.maximum(1.0 + x @ values[:, G, None], MIN_DEPTH)
        w = (x @ numerator[..., :3].swapaxes(1, 2) + numerator[:, None, :, 3]) / depth
        square_radius = (self.points**2).sum(axis=1).mean()
        c = values[:, None, C] * np.sqrt(square_radius)
        square = ((w - c) ** 2).sum(axis=2, keepdims=True) / square_radius
        return c + (1.0 + values[:, KAPPA, None] * square) * (w - c)

    def compute_residuals(self, unknowns: Floats, noise: float) -> Floats:
        """Return the residuals (m, 4 n + 20) in standard deviations, those of the prior last.

        `noise` is the standard deviation (px) of a marker coordinate.
        """
        error = (self.project(unknowns) - self.points) / noise
        return np.concatenate([error.reshape(len(unknowns), -1), unknowns], axis=1)

    def solve(self) -> tuple[Floats, Floats]:
        """Return corrections of the lengths (6,) in mm and the half widths of their intervals."""
        from scipy.special import stdtrit  # local because the import takes 0.1 s

        x = self._fit(self._guess_camera(), INITIAL_NOISE_PX)
        noise = self._estimate_noise(x)
        x = self._fit(x, noise)
        residuals, jacobian = differentiate(partial(self.compute_residuals, noise=noise), x)
        rows = np.arange(self.points.size).reshape(-1, 4)
        groups = np.array_split(rows, min(len(rows), GROUP_COUNT))
        covariance = compute_jackknife_covariance(residuals, jacobian, groups)
        quantile = float(stdtrit(len(groups) - 1, 0.5 + 0.5 * PROBABILITY))
        deviation = np.sqrt(np.diag(covariance)) * PRIOR
        return x[LENGTHS] * PRIOR[LENGTHS], quantile * deviation[LENGTHS]

    def _fit(self, x: Floats, noise: float) -> Floats:
        """Return the unknowns (20,) of the best fit near `x`."""
        return fit_residuals(partial(self.compute_residuals, noise=noise), x).x

    def _estimate_noise(self, x: Floats) -> float:
        """Return the standard deviation (px) of the residuals, which sets the prior's weight."""
        squares = ((self.project(x[None])[0] - self.points) ** 2).sum()
        return max(float(np.sqrt(squares / (self.points.size - len(x)))), MIN_NOISE_PX)

    def _guess_camera(self) -> Floats:
        """Return the unknowns (20,) of a distant camera, with the lengths of the rig file."""
        unknowns = np.zeros(len(PRIOR))
        homogeneous = np.column_stack([self.x, np.ones(len(self.x))])
        unknowns[A] = np.linalg.lstsq(homogeneous, self.points)[0].T.ravel() / PRIOR[A]
        return unknowns
