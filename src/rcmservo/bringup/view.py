"""The camera that would have seen the markers where they were seen, had they been at given places.

Nobody knows the camera, but it is one: square pixels, its axis near the picture's middle, a lens
that bends little. Places of which no such camera makes this picture are wrong. With
X = R (P - P₀) + (a, b, 1) Z in the camera's axes and the slopes s = (X₁, X₂) / X₃, the picture

    m = f (1 + k |s|²) s + c

is fitted to all that was seen at once, by damped least squares over R, a, b, Z, f, c and k, and
over what the places leave open. What is known beforehand of f, c and k counts as a measurement.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.loops import cross

FOCAL = 1.2
"""Widths of the picture that a focal length is likely to have,"""
FOCAL_WITHIN = 0.6
"""and how far its logarithm may be from that: one standard deviation, as are the next."""
CENTRE_WITHIN = 0.025
"""Widths of the picture by which the camera's axis may miss its middle."""
BENT_WITHIN = 0.15
"""How far k may be from 0."""

CAMERA = 10
"""Numbers that a camera has here: R, (a, b, Z), f, c and k."""
UNITS = 0.1, 0.1, 0.1, 0.05, 0.05, 0.3
"""Of the first six of them, about which nothing is known."""

STEPS = 60
"""Of the fit, at most;"""
FIRST_STEPS, HOPELESS = 16, 30.0
"""after so many it ends where more than this is left over of a number of the picture;"""
ENOUGH = 1e-3
"""it ends when one makes the misfit smaller by less than this."""
SMALL = 1e-5
"""Step of a difference, in standard deviations."""
FAR = 1e3
"""px by which a point behind the camera is off."""


@dataclass(frozen=True, eq=False)
class Views:
    """What was seen while the arm stood at several places."""

    q: Floats
    """The joints (n, 3) as the arm told them."""
    points: Floats
    """The markers (n, 2, 2) px, each the mean over many frames."""
    noise: Floats
    """(n,) px, the standard deviation of these means."""
    size: tuple[int, int]
    """px, width and height of the picture."""

    def mirrored(self) -> "Views":
        """The same in a mirror."""
        flipped = self.points * [-1.0, 1.0] + [self.size[0] - 1.0, 0.0]
        return Views(self.q, flipped, self.noise, self.size)


@dataclass(frozen=True, eq=False)
class Fit:
    """How well a camera explains what was seen."""

    misfit: float
    """The sum of squares left over, in standard deviations."""
    free: Floats
    """What the places left open, as it fits best,"""
    within: Floats
    """and the standard deviations of that."""


Places = Callable[[Floats], Floats]
"""The markers (n, 2, 3) mm, given what they leave open."""


def fitted(seen: Views, places: Places, within: Floats, begin: Floats) -> Fit:
    """The best camera for these places. What they leave open is about 0 beforehand, ``within`` so
    many standard deviations; it is looked for from ``begin`` on."""
    left_over = _left_over(seen, places, within, begin)
    x: Floats = np.concatenate([np.zeros(CAMERA), begin / within])
    steps = np.vstack([np.zeros_like(x), SMALL * np.eye(len(x))])
    damping = 1e-3
    at = left_over(x + steps)
    for k in range(STEPS):
        if k >= FIRST_STEPS and at[0] @ at[0] > HOPELESS * seen.points.size:
            break
        r, J = at[0], (at[1:] - at[0]).T / SMALL
        square = J.T @ J
        step = _damped(square, damping, -J.T @ r)
        then = left_over(x + step + steps)
        gained = r @ r - then[0] @ then[0]
        if not gained >= 0.0:
            damping *= 8.0
            if damping > 1e12:
                break
            continue
        x, at, damping = x + step, then, max(damping / 8.0, 1e-9)
        if gained < ENOUGH:
            break
    J = (at[1:] - at[0]).T / SMALL
    inverse = np.asarray(np.linalg.pinv(J.T @ J), float)
    spread = np.sqrt(np.abs(np.diag(inverse)))[CAMERA:]
    return Fit(float(at[0] @ at[0]), x[CAMERA:] * within, spread * within)


def _damped(square: Floats, damping: float, downhill: Floats) -> Floats:
    """The step of damped least squares."""
    return np.asarray(np.linalg.solve(square + damping * np.eye(len(square)), downhill), float)


def _left_over(
    seen: Views, places: Places, within: Floats, begin: Floats
) -> Callable[[Floats], Floats]:
    """What a fit leaves over (b, rows), in standard deviations, at several x (b, numbers)."""
    width, height = seen.size
    middle = np.array([width - 1.0, height - 1.0]) / 2.0
    usual = places(begin)
    origin = usual.reshape(-1, 3).mean(axis=0)
    rotation, scale = _from_afar(usual, seen.points)
    focal = FOCAL * width
    aside = (seen.points.reshape(-1, 2).mean(axis=0) - middle) / focal
    known = [FOCAL_WITHIN, CENTRE_WITHIN * width, CENTRE_WITHIN * width, BENT_WITHIN]
    units = np.concatenate([UNITS, known, within])

    def left_over(x: Floats) -> Floats:
        scaled = np.clip(x, -50.0, 50.0) * units
        R = turned(scaled[:, :3]) @ rotation
        different, which = np.unique(scaled[:, CAMERA:], axis=0, return_inverse=True)
        P = np.stack([places(free) for free in different])[which.ravel()] - origin
        depth = focal / scale * np.exp(scaled[:, 5])[:, None, None]
        X = P.reshape(len(x), -1, 3) @ R.transpose(0, 2, 1)
        X[:, :, :2] += (aside + scaled[:, 3:5])[:, None] * depth
        X[:, :, 2:] += depth
        before = X[:, :, 2:] > 1e-2 * depth
        slope = X[:, :, :2] / np.where(before, X[:, :, 2:], 1.0)
        bent = 1.0 + scaled[:, 9][:, None, None] * (slope**2).sum(axis=2, keepdims=True)
        picture = focal * np.exp(scaled[:, 6])[:, None, None] * bent * slope
        off = picture + middle + scaled[:, None, 7:9] - seen.points.reshape(-1, 2)
        off = np.where(before & (np.abs(off) < FAR), off, FAR) / np.repeat(seen.noise, 2)[:, None]
        return np.concatenate([off.reshape(len(x), -1), x[:, 6:]], axis=1)

    return left_over


def _from_afar(places: Floats, points: Floats) -> tuple[Floats, float]:
    """The rotation (3, 3) and the px per mm of a camera far away that sees about this.

    How the markers stand to each other weighs as much as all their motion.
    """
    P, m = places - places.mean(axis=0), points - points.mean(axis=0)
    along = (places[:, 1] - places[:, 0]).mean(axis=0)[None]
    between = (points[:, 1] - points[:, 0]).mean(axis=0)[None]
    share = np.sqrt((P**2).sum() / (along**2).sum())
    of, to = np.vstack([*P, share * along]), np.vstack([*m, share * between])
    U, sizes, V = np.linalg.svd(np.linalg.lstsq(of, to, rcond=1e-6)[0].T)
    rows = U @ V[:2]
    return np.vstack([rows, cross(rows[0], rows[1])]), float(sizes.mean())


def turned(turns: Floats) -> Floats:
    """The rotations (b, 3, 3) about `turns` (b, 3), each by its length in rad."""
    angle = np.linalg.norm(turns, axis=1)[:, None, None]
    K = np.zeros((len(turns), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -turns[:, 2], turns[:, 1], -turns[:, 0]
    K -= K.transpose(0, 2, 1)
    small = angle < 1e-6
    by = np.where(small, 1.0, angle)
    first = np.where(small, 1.0, np.sin(by) / by)
    second = np.where(small, 0.5, (1.0 - np.cos(by)) / by**2)
    return np.eye(3) + first * K + second * K @ K
