"""The true camera: a pinhole with radial distortion, standing still in the world.

Camera axes: x right, y down, z forward. With X = R_c_w (X_world - position) in those axes and
slopes (x, y) = (X1, X2) / X3, the picture of a point is

    (u, v) = focal (1 + k1 r^2 + k2 r^4) (x, y) + centre,    r^2 = x^2 + y^2    (Brown)

Pixel (0, 0) is the centre of the top left pixel, u right, v down. Lengths in mm, image in px.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from rcmservo.constraints import Checked, above, array, positive
from rcmservo.errors import require
from rcmservo.interfaces import Floats
from rcmservo.loops import cross
from rcmservo.rows import Rows
from rcmservo.sim.camera_kernels import Lens, project_jacobian

WIDEST = 100.0
"""The slope beyond which no lens looks aside."""

ROUNDING = 1e-12
"""A step of Newton's method, as a slope, after which the next one would change nothing."""

OUTLINE = 256
"""Points on a silhouette. The polygon's centroid is then good to 1e-6 of its radius."""


@dataclass(frozen=True, eq=False)
class Optics(Checked):
    """What the camera does to light."""

    width: Annotated[int, above(0, what="a whole number of px")]
    """px of the picture."""

    height: Annotated[int, above(0, what="a whole number of px")]
    """px of the picture."""

    focal: Annotated[float, positive("number of px")]
    """px."""

    centre: Annotated[Floats, array(2)]
    """(2,) px, the principal point."""

    distortion: Annotated[Floats, array(2)]
    """(2,) k1 and k2."""

    rotation: Annotated[Floats, array(3, 3)]
    """(3, 3) R_c_w, from world axes to camera axes."""

    position: Annotated[Floats, array(3)]
    """(3,) mm, the camera's centre in the world."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("centre", "distortion", "rotation", "position"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=np.float64))
        proper = np.allclose(self.rotation @ self.rotation.T, np.eye(3), atol=1e-9)
        proper = proper and np.linalg.det(self.rotation) > 0
        self.require(proper, "rotation", "a proper rotation matrix")
        one_to_one = np.isinf(self.fold) or self._corner < self.fold * self._stretch(self.fold)
        self.require(one_to_one, "distortion", "so weak that every pixel sees one direction")

    def pinhole(self) -> Floats:
        """The calibration matrix C (3, 4) of eq. (4): all of this but the distortion."""
        K = np.array(
            [[self.focal, 0.0, self.centre[0]], [0.0, self.focal, self.centre[1]], [0.0, 0.0, 1.0]]
        )
        return K @ self.rotation @ np.column_stack([np.eye(3), -self.position])

    @cached_property
    def lens(self) -> Rows[Lens]:
        """What compiled functions know of it."""
        return Lens.of(
            width=self.width,
            height=self.height,
            focal=self.focal,
            centre=self.centre,
            distortion=self.distortion,
            fold=self.fold,
            rotation=self.rotation,
            position=self.position,
        ).rows

    def depth(self, points: Floats) -> Floats:
        """How far world `points` (N, 3) mm lie before the camera along its z axis, (N,) mm.

        Negative behind it.
        """
        return self._in_camera(points)[:, 2]

    def project(self, points: Floats) -> Floats:
        """Where world `points` (N, 3) mm appear, (N, 2) px.

        NaN behind the camera, and so far to the side that the distortion polynomial would fold the
        point back.
        """
        return self._project_camera(self._in_camera(points))

    def project_jacobian(self, point: Floats) -> Floats:
        """The derivative of `project` at a world `point` (3,) mm: (2, 3) px/mm."""
        return project_jacobian(self.lens[0], np.ascontiguousarray(point, dtype=float))

    def slopes(self, pixels: Floats) -> Floats:
        """x and y of the ray (x, y, 1), in camera axes, that each of `pixels` (..., 2) px sees.

        The lens's distortion is undone.
        """
        stretched = (pixels - self.centre) / self.focal
        wanted = np.linalg.norm(stretched, axis=-1, keepdims=True)
        k1, k2 = self.distortion
        r = wanted.copy()
        for _ in range(20):  # Newton; the corners of a strong wide-angle lens need about ten
            square = r * r
            bent = r * (1 + square * (k1 + k2 * square)) - wanted
            step = bent / (1 + square * (3 * k1 + 5 * k2 * square))
            r -= step
            if np.abs(step).max(initial=0.0) < ROUNDING:
                break
        return stretched / self._stretch(r)

    def pixels(self) -> Floats:
        """The centre (u, v) of every pixel, (H, W, 2) px."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return np.stack([u, v], axis=-1).astype(np.float64)

    def rays(self) -> Floats:
        """The unit direction, in the world, in which every pixel's centre looks: (H, W, 3)."""
        slope = self.slopes(self.pixels())
        ray = np.concatenate([slope, np.ones_like(slope[..., :1])], axis=-1)
        return ray / np.linalg.norm(ray, axis=-1, keepdims=True) @ self.rotation

    def silhouette_centre(self, centre: Floats, radius: float) -> Floats:
        """The centroid (2,) px of the image of a sphere that nothing hides.

        A perfect blob finder would report it. It is not the image of the sphere's centre:
        perspective pulls it outwards by x R^2 / (Z^2 - R^2).
        """
        return _polygon(self._outline(centre, radius))[1]

    def silhouette_radius(self, centre: Floats, radius: float) -> float:
        """The radius of the disc that has the area of a sphere's image, px."""
        return float(np.sqrt(_polygon(self._outline(centre, radius))[0] / np.pi))

    def _outline(self, centre: Floats, radius: float) -> Floats:
        """The sphere's outline (OUTLINE, 2) px: the image of the circle in which the cone of sight
        touches it.

        NaN where the camera is inside the sphere or the cone reaches behind the camera.
        """
        c: Floats = self._in_camera(centre[None])[0]
        distance = np.linalg.norm(c)
        if distance <= radius:
            return np.full((OUTLINE, 2), np.nan)
        axis = c / distance
        across = np.linalg.svd(axis[None])[2][1:]
        turn = np.linspace(0, 2 * np.pi, OUTLINE, endpoint=False)
        circle = np.column_stack([np.cos(turn), np.sin(turn)]) @ across
        sine = radius / distance
        return self._project_camera(np.sqrt(1 - sine**2) * axis + sine * circle)

    def _in_camera(self, points: Floats) -> Floats:
        return (points - self.position) @ self.rotation.T

    def _project_camera(self, X: Floats) -> Floats:
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = X[:, :2] / X[:, 2:]
            r = np.linalg.norm(slope, axis=1, keepdims=True)
            image = self.focal * self._stretch(r) * slope + self.centre
            return np.where((X[:, 2:] > 0) & (r < self.fold), image, np.nan)

    def _stretch(self, r: Any) -> Any:
        """By how much the lens stretches a slope of length `r`."""
        k1, k2 = self.distortion
        return 1 + k1 * r**2 + k2 * r**4

    @cached_property
    def fold(self) -> float:
        """The radius (as a slope) beyond which the polynomial falls again and means nothing.

        inf where it never falls. x = 1 / r^2 with x^2 + 3 k1 x + 5 k2 = 0 is where the distorted
        radius has its maximum.
        """
        k1, k2 = self.distortion
        within = 9 * k1**2 - 20 * k2
        root = -1.5 * k1 + 0.5 * np.sqrt(within) if within >= 0 else 0.0
        return float(1 / np.sqrt(root)) if root > WIDEST**-2 else np.inf

    @property
    def _corner(self) -> float:
        """The distorted radius (as a slope) of the picture's outermost corner."""
        size = np.array([self.width, self.height])
        reach = np.maximum(self.centre + 0.5, size - 0.5 - self.centre)
        return float(np.linalg.norm(reach) / self.focal)


def look_at(position: Floats, target: Floats, roll: float = 0.0) -> Floats:
    """The rotation R_c_w (3, 3) of a camera at `position` that looks at `target`, both (3,) mm.

    The target is then at the principal point. At `roll` 0 the world's z axis points up in the
    picture (its y axis if the camera looks along z). `roll` in rad turns the camera clockwise about
    its line of sight, so the picture turns anticlockwise.
    """
    sight = target - position
    distance = np.linalg.norm(sight)
    require(bool(distance > 0), "target", target, "away from the camera's position")
    forward = sight / distance
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 1 - 1e-9 else np.array([0.0, 1.0, 0.0])
    right = cross(forward, up)
    right /= np.linalg.norm(right)
    down = cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    return np.stack([c * right + s * down, c * down - s * right, forward])


def _polygon(corners: Floats) -> tuple[float, Floats]:
    """The area and the centroid (2,) of a closed polygon of `corners` (N, 2)."""
    middle = corners.mean(axis=0)
    here = corners - middle
    after = np.roll(here, -1, axis=0)
    cross = here[:, 0] * after[:, 1] - here[:, 1] * after[:, 0]
    twice = float(cross.sum())
    return abs(twice) / 2, middle + (cross @ (here + after)) / (3 * twice)
