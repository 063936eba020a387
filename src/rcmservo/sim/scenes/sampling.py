"""Random scenes by rejection sampling: camera, start and target until they are feasible."""

from dataclasses import dataclass, replace

import numpy as np

from rcmservo.geometry.features import compute_features, wrap_angle
from rcmservo.interfaces import Floats
from rcmservo.sim.camera_model import CameraModel, compute_look_at_rotation
from rcmservo.sim.rendering import Tissue
from rcmservo.sim.scene import NoScene, Scene, SceneSettings
from rcmservo.sim.scenes.endoscope import sample_endoscope_view
from rcmservo.sim.scenes.feasibility import SceneFeasibility
from rcmservo.sim.scenes.joint_paths import plan_saturated_path, plan_straight_path
from rcmservo.sim.tool_body import ToolBody

MAX_DRAWS = 20_000
"""Number of samples after which no feasible one is expected."""

MIN_RCM_DEPTH_RATIO = 0.3
"""Least ratio of the RCM's depth to the tool's. The method measures depths in units of the RCM's
depth, so the RCM must be in front of the camera."""

TISSUE_CLEARANCE_MM = 15.0
"""Distance (mm) of the tissue behind the tool."""

MIN_RELOCATION_ROLL_RAD = 0.5
"""Least angle (rad) by which the tool's image is rotated after the camera has been relocated."""

MAX_AIM_OFFSET_RATIO = 0.05
"""Largest offset of the point at which the camera looks, relative to its distance from the tool."""

MAX_CENTRE_SHIFT_RATIO = 0.02
"""Largest shift of the principal point from the image's middle, relative to the image's width."""


@dataclass(frozen=True, eq=False)
class SceneSampler:
    """Distributions, tool, image size and random generator for the sampling of scenes.

    Parameters
    ----------
    settings : SceneSettings
        Distributions of the scenes.
    body : ToolBody
        Tool.
    size : tuple[int, int]
        Width and height of the image, px.
    radius : float
        Radius (mm) of the larger ball.
    random : np.random.Generator
        Random generator.
    """

    settings: SceneSettings

    body: ToolBody

    size: tuple[int, int]

    radius: float

    random: np.random.Generator

    @property
    def feasibility(self) -> SceneFeasibility:
        """Test that a sampled scene must pass."""
        return SceneFeasibility(self.settings, self.body, self.radius)


def sample_scene(sampler: SceneSampler) -> Scene:
    """Return the first feasible scene.

    Raises
    ------
    NoScene
        If `MAX_DRAWS` samples are infeasible.
    """
    for rejected in range(MAX_DRAWS):
        scene = _sample_candidate(sampler, rejected)
        if scene is not None and sampler.feasibility.is_feasible(scene):
            return scene
    raise NoScene(
        f"no scene in {MAX_DRAWS} draws has both markers in view and the requested condition: "
        "change the start and target joints, the limits, or the ranges of focal length, distance, "
        "travel and condition"
    )


def sample_relocated_scene(sampler: SceneSampler, scene: Scene) -> Scene:
    """Return a scene with another camera pose and other tissue, and the same path.

    The camera's new pose is sampled as for a new scene, until it shows the tool rotated by at least
    `MIN_RELOCATION_ROLL_RAD`.

    Raises
    ------
    NoScene
        If `MAX_DRAWS` samples are infeasible.
    """
    for rejected in range(MAX_DRAWS):
        candidate = _sample_camera(sampler, scene.start, scene.target)
        if candidate is None:
            continue
        camera, tissue = candidate
        optics = replace(scene.optics, rotation=camera.rotation, position=camera.position)
        if _is_valid_relocation(sampler, scene, optics):
            return replace(scene, optics=optics, tissue=tissue, rejected=rejected)
    raise NoScene(f"no other camera pose in {MAX_DRAWS} draws has both markers in view")


def _is_valid_relocation(sampler: SceneSampler, scene: Scene, optics: CameraModel) -> bool:
    """Return True if the scene is feasible with this camera and the tool appears rotated."""
    markers, feasibility = scene.body.points(scene.start)[:2], sampler.feasibility
    # The angle s of eq. (7) is that of the line through both markers: it needs no imaged RCM.
    s_before, s_after = (
        compute_features(camera.project(markers).ravel())[0] for camera in (scene.optics, optics)
    )
    return (
        bool(abs(wrap_angle(s_after - s_before)) > MIN_RELOCATION_ROLL_RAD)
        and feasibility.markers_visible(optics, scene.path)
        and feasibility.is_well_conditioned(optics, scene.path)
    )


def _sample_candidate(sampler: SceneSampler, rejected: int) -> Scene | None:
    """Return a scene that may be infeasible, or None if no target or no camera exists."""
    settings = sampler.settings
    start = np.array(settings.start) if settings.start else _sample_joints(sampler)
    target = np.array(settings.target) if settings.target else _sample_target(sampler, start)
    if target is None:
        return None
    camera = _sample_camera(sampler, start, target)
    if camera is None:
        return None
    optics, tissue = camera
    path = _plan_path(sampler, optics, start, target)
    return None if path is None else Scene(optics, sampler.body, *path, tissue, rejected)


def _plan_path(
    sampler: SceneSampler, optics: CameraModel, start: Floats, target: Floats
) -> tuple[Floats, Floats] | None:
    """Return the joints of the path from start to target and of its midpoint.

    None if no start has the requested `errors`.
    """
    settings, body = sampler.settings, sampler.body
    if settings.errors is not None:
        return plan_saturated_path(body, optics, target, np.array(settings.errors))
    path = np.stack([start, target])
    if settings.is_sampled:
        path = plan_straight_path(body, start, target)
    return path, path[len(path) // 2]


def _sample_joints(sampler: SceneSampler) -> Floats:
    """Sample joints (3,) within their limits, with the insertion that the settings require."""
    body = sampler.body
    q = sampler.random.uniform(body.mechanism.limits.lower, body.mechanism.limits.upper)
    insertion = sampler.random.uniform(*sampler.settings.insertion)
    q[2] = insertion - body.mechanism.insertion_zero - body.tool.offset
    return q


def _sample_target(sampler: SceneSampler, start: Floats) -> Floats | None:
    """Sample joints (3,) with marker 1 at a sampled distance and direction from its start.

    None if no joints reach that position.
    """
    body, random = sampler.body, sampler.random
    direction = random.standard_normal(3)
    travel_mm = random.uniform(*sampler.settings.travel)
    p1: Floats = body.points(start)[0] + travel_mm * direction / np.linalg.norm(direction)
    rho, offset = float(np.linalg.norm(p1)), body.tool.offset
    return body.mechanism.joints(p1 * (1.0 - offset / rho)) if rho > offset else None


def _sample_camera(
    sampler: SceneSampler, start: Floats, target: Floats
) -> tuple[CameraModel, Tissue] | None:
    """Sample a camera that looks at the tool, and tissue behind the tool.

    The normal of the tissue bisects the vertical and the viewing direction. Return None if the
    camera is impossible: an endoscope outside the body, or a free camera with the RCM behind it.
    """
    points = np.concatenate([sampler.body.points(q) for q in (start, target)])
    down = np.array([0.0, 0.0, 1.0 if points[:, 2].sum() > 0.0 else -1.0])
    middle, is_endoscope = points[[0, 1, 4, 5]].mean(axis=0), sampler.settings.ports is not None
    if is_endoscope:
        view = sample_endoscope_view(sampler.random, sampler.settings, middle, down)
    else:
        view = _sample_free_view(sampler, down)
    if view is None:
        return None
    direction, distance = view
    tissue = _place_tissue(points, direction - down)
    optics = _sample_camera_at(sampler, middle, middle + distance * direction, distance)
    rcm_depth, tool_depth = optics.depth(np.stack([np.zeros(3), middle]))
    rcm_in_front = rcm_depth > MIN_RCM_DEPTH_RATIO * tool_depth
    return (optics, tissue) if is_endoscope or rcm_in_front else None


def _sample_free_view(sampler: SceneSampler, down: Floats) -> tuple[Floats, float]:
    """Sample the unit vector (3,) from the tool to a free camera, and their distance, mm."""
    random, settings = sampler.random, sampler.settings
    azimuth, elevation = random.uniform(-np.pi, np.pi), random.uniform(*settings.elevation)
    horizontal = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    distance = random.uniform(*settings.distance)
    return np.cos(elevation) * horizontal - np.sin(elevation) * down, distance


def _place_tissue(points: Floats, normal: Floats) -> Tissue:
    """Return tissue perpendicular to `normal` (3,), behind all `points` (N, 3) of the tool."""
    normal = normal / np.linalg.norm(normal)
    height_mm = np.min(points @ normal) - TISSUE_CLEARANCE_MM
    return Tissue(height_mm * normal, normal)


def _sample_camera_at(
    sampler: SceneSampler, middle: Floats, position: Floats, distance: float
) -> CameraModel:
    """Sample a camera at `position` that looks near the tool's `middle`, both (3,) mm."""
    random, (width, height) = sampler.random, sampler.size
    aim = middle + random.uniform(-MAX_AIM_OFFSET_RATIO, MAX_AIM_OFFSET_RATIO, 3) * distance
    rotation = compute_look_at_rotation(position, aim, random.uniform(-np.pi, np.pi))
    shift_px = random.uniform(-MAX_CENTRE_SHIFT_RATIO, MAX_CENTRE_SHIFT_RATIO, 2) * width
    centre = np.array([width - 1.0, height - 1.0]) / 2.0 + shift_px
    focal = random.uniform(*sampler.settings.focal)
    distortion = np.array(sampler.settings.distortion)
    return CameraModel(width, height, focal, centre, distortion, rotation, position)
