"""Camera model of the simulation: a pinhole with radial distortion at a pose in the world.

Camera axes: x right, y down, z forward. With X = R_c_w (X_world - position) in those axes and
slopes (x, y) = (X1, X2) / X3, the image of a point is

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
from rcmservo.numerics.small_linalg import cross
from rcmservo.numerics.structs import Rows
from rcmservo.sim.camera_kernels import CameraStruct, project_jacobian

MAX_LENS_SLOPE = 100.0
"""Largest slope of a line of sight: no lens is wider.

Where the distortion polynomial has its maximum beyond this slope, the maximum is ignored.
"""

NEWTON_TOLERANCE = 1e-12
"""Newton step, as a slope, below which the inversion of the distortion stops."""

MAX_NEWTON_STEPS = 20
"""Largest number of Newton steps. The corners of a strong wide-angle lens need about ten."""

SILHOUETTE_POINTS = 256
"""Points on a silhouette. The polygon's centroid is then accurate to 1e-6 of its radius."""


@dataclass(frozen=True, eq=False)
class CameraModel(Checked):
    """Pose and lens of a simulated camera, with its projection and the images of spheres.

    Parameters
    ----------
    width : int
        Width of the image, px.
    height : int
        Height of the image, px.
    focal : float
        Focal length, px.
    centre : Floats
        Principal point (2,), px.
    distortion : Floats
        Radial distortion (2,): k1 and k2.
    rotation : Floats
        Rotation (3, 3) R_c_w from world axes to camera axes.
    position : Floats
        Camera centre (3,) in the world, mm.

    Raises
    ------
    BadInput
        If a field is outside its range, the rotation is improper, or the distortion is so strong
        that two directions have the same pixel.
    """

    width: Annotated[int, above(0, what="a whole number of px")]

    height: Annotated[int, above(0, what="a whole number of px")]

    focal: Annotated[float, positive("number of px")]

    centre: Annotated[Floats, array(2)]

    distortion: Annotated[Floats, array(2)]

    rotation: Annotated[Floats, array(3, 3)]

    position: Annotated[Floats, array(3)]

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("centre", "distortion", "rotation", "position"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=np.float64))
        is_orthogonal = np.allclose(self.rotation @ self.rotation.T, np.eye(3), atol=1e-9)
        is_proper = is_orthogonal and np.linalg.det(self.rotation) > 0
        self.require(is_proper, "rotation", "a proper rotation matrix")
        max_radius = self.fold if np.isinf(self.fold) else self.fold * self._stretch(self.fold)
        is_unique = self._corner_radius < max_radius
        self.require(is_unique, "distortion", "so weak that no two directions share a pixel")

    def pinhole(self) -> Floats:
        """Return the projection matrix C (3, 4) of eq. (4), which leaves out the distortion."""
        u0, v0 = self.centre
        K = np.array([[self.focal, 0.0, u0], [0.0, self.focal, v0], [0.0, 0.0, 1.0]])
        return K @ self.rotation @ np.column_stack([np.eye(3), -self.position])

    @cached_property
    def lens(self) -> Rows[CameraStruct]:
        """Camera parameters for compiled functions, an array of one row."""
        names = (field.name for field in CameraStruct.fields)
        return CameraStruct.of(**{name: getattr(self, name) for name in names}).rows

    def depth(self, points: Floats) -> Floats:
        """Return the depths (N,) mm of world `points` (N, 3) mm along the camera's z axis.

        A depth is negative behind the camera.
        """
        return self._transform_to_camera(points)[:, 2]

    def project(self, points: Floats) -> Floats:
        """Return the images (N, 2) px of world `points` (N, 3) mm.

        The image of a point is NaN if the point is behind the camera, or beyond the slope `fold`.
        """
        return self._project_camera_points(self._transform_to_camera(points))

    def project_jacobian(self, point: Floats) -> Floats:
        """Return the derivative (2, 3) px/mm of `project` at a world `point` (3,) mm."""
        return project_jacobian(self.lens[0], np.ascontiguousarray(point, dtype=float))

    def slopes(self, pixels: Floats) -> Floats:
        """Return the slopes (x, y) of the undistorted rays (x, y, 1) through `pixels`.

        Parameters
        ----------
        pixels : Floats, shape (..., 2)
            Image points, px.

        Returns
        -------
        Floats, shape (..., 2)
            Slopes in camera axes.
        """
        distorted = (pixels - self.centre) / self.focal
        distorted_radius = np.linalg.norm(distorted, axis=-1, keepdims=True)
        k1, k2 = self.distortion
        r = distorted_radius.copy()
        for _ in range(MAX_NEWTON_STEPS):
            r2 = r * r
            residual = r * (1 + r2 * (k1 + k2 * r2)) - distorted_radius
            step = residual / (1 + r2 * (3 * k1 + 5 * k2 * r2))
            r -= step
            if np.abs(step).max(initial=0.0) < NEWTON_TOLERANCE:
                break
        return distorted / self._stretch(r)

    def pixels(self) -> Floats:
        """Return the centre (u, v) of every pixel, (H, W, 2) px."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return np.stack([u, v], axis=-1).astype(np.float64)

    def rays(self) -> Floats:
        """Return the unit direction in the world through every pixel's centre, (H, W, 3)."""
        slopes = self.slopes(self.pixels())
        rays = np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1)
        return rays / np.linalg.norm(rays, axis=-1, keepdims=True) @ self.rotation

    def silhouette_centre(self, centre: Floats, radius: float) -> Floats:
        """Return the centroid (2,) px of the image of an unoccluded sphere.

        An ideal blob detector would report it. It differs from the image of the sphere's centre,
        because perspective moves it outwards: without distortion by the slope x R²/(Z² − R²), for
        a sphere of radius R at depth Z, whose centre is at slope x. It is NaN if a part of the
        outline is not visible.

        Parameters
        ----------
        centre : Floats, shape (3,)
            Centre of the sphere in the world, mm.
        radius : float
            Radius of the sphere, mm.
        """
        return _polygon_moments(self._outline(centre, radius))[1]

    def silhouette_radius(self, centre: Floats, radius: float) -> float:
        """Return the radius (px) of the disc whose area equals that of a sphere's image.

        Parameters
        ----------
        centre : Floats, shape (3,)
            Centre of the sphere in the world, mm.
        radius : float
            Radius of the sphere, mm.
        """
        return float(np.sqrt(_polygon_moments(self._outline(centre, radius))[0] / np.pi))

    def _outline(self, centre: Floats, radius: float) -> Floats:
        """Return the silhouette (SILHOUETTE_POINTS, 2) px of a sphere.

        It is the image of the circle in which the cone from the camera touches the sphere. It is
        NaN where the camera is inside the sphere or the cone reaches behind the camera.
        """
        to_centre: Floats = self._transform_to_camera(centre[None])[0]
        distance = np.linalg.norm(to_centre)
        if distance <= radius:
            return np.full((SILHOUETTE_POINTS, 2), np.nan)
        axis = to_centre / distance
        perpendicular = np.linalg.svd(axis[None])[2][1:]
        angles = np.linspace(0, 2 * np.pi, SILHOUETTE_POINTS, endpoint=False)
        circle = np.column_stack([np.cos(angles), np.sin(angles)]) @ perpendicular
        sine = radius / distance
        return self._project_camera_points(np.sqrt(1 - sine**2) * axis + sine * circle)

    def _transform_to_camera(self, points: Floats) -> Floats:
        """Return world points (N, 3) mm in camera axes."""
        return (points - self.position) @ self.rotation.T

    def _project_camera_points(self, X: Floats) -> Floats:
        """Return the images (N, 2) px of points X (N, 3) in camera axes."""
        with np.errstate(divide="ignore", invalid="ignore"):
            slopes = X[:, :2] / X[:, 2:]
            r = np.linalg.norm(slopes, axis=1, keepdims=True)
            image = self.focal * self._stretch(r) * slopes + self.centre
            return np.where((X[:, 2:] > 0) & (r < self.fold), image, np.nan)

    def _stretch(self, r: Any) -> Any:
        """Return the ratio of the distorted to the undistorted slope of length `r`."""
        k1, k2 = self.distortion
        return 1 + k1 * r**2 + k2 * r**4

    @cached_property
    def fold(self) -> float:
        """Slope beyond which the distortion polynomial decreases and has no meaning, else inf.

        x = 1 / r^2 with x^2 + 3 k1 x + 5 k2 = 0 gives the maximum of the distorted radius.
        """
        k1, k2 = self.distortion
        discriminant = 9 * k1**2 - 20 * k2
        root = -1.5 * k1 + 0.5 * np.sqrt(discriminant) if discriminant >= 0 else 0.0
        return float(1 / np.sqrt(root)) if root > MAX_LENS_SLOPE**-2 else np.inf

    @property
    def _corner_radius(self) -> float:
        """Distorted radius (as a slope) of the image corner farthest from the principal point."""
        size = np.array([self.width, self.height])
        reach = np.maximum(self.centre + 0.5, size - 0.5 - self.centre)
        return float(np.linalg.norm(reach) / self.focal)


def compute_look_at_rotation(position: Floats, target: Floats, roll: float = 0.0) -> Floats:
    """Return the rotation R_c_w (3, 3) of a camera at `position` (3,) mm that looks at `target`.

    The target is then at the principal point. At `roll` 0 the world's z axis points up in the image
    (its y axis if the camera looks along z). `roll` (rad) turns the camera clockwise about its
    optical axis, so the image turns anticlockwise. Raise `BadInput` if both points are equal.
    """
    direction = target - position
    distance = np.linalg.norm(direction)
    require(bool(distance > 0), "target", target, "away from the camera's position")
    forward = direction / distance
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 1 - 1e-9 else np.array([0.0, 1.0, 0.0])
    right = cross(forward, up)
    right /= np.linalg.norm(right)
    down = cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    return np.stack([c * right + s * down, c * down - s * right, forward])


def _polygon_moments(corners: Floats) -> tuple[float, Floats]:
    """Return the area and the centroid (2,) of a closed polygon of `corners` (N, 2)."""
    middle = corners.mean(axis=0)
    relative = corners - middle
    following = np.roll(relative, -1, axis=0)
    cross = relative[:, 0] * following[:, 1] - relative[:, 1] * following[:, 0]
    twice_area = float(cross.sum())
    return abs(twice_area) / 2, middle + (cross @ (relative + following)) / (3 * twice_area)
