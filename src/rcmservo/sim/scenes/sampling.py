"""Rejection sampling of scenes from a seed."""

from dataclasses import dataclass, replace

import numpy as np

from rcmservo.geometry.features import compute_features, wrap_angle
from rcmservo.interfaces import Floats
from rcmservo.sim.camera_model import CameraModel, compute_look_at_rotation
from rcmservo.sim.rendering import Tissue
from rcmservo.sim.scene import NoScene, Scene, SceneSettings
from rcmservo.sim.scenes.endoscope import sample_through_port
from rcmservo.sim.scenes.feasibility import SceneFeasibility
from rcmservo.sim.scenes.joint_paths import plan_saturated_path, plan_straight_path
from rcmservo.sim.tool_body import ToolBody

MAX_DRAWS = 20_000
"""Samples after which no scene is expected any more."""

MIN_RCM_DEPTH_RATIO = 0.3
"""Least ratio of the RCM's depth to the tool's. The method scales depth by the RCM's, so the RCM
must be in front of the camera."""

TISSUE_CLEARANCE_MM = 15.0
"""Distance (mm) of the tissue from the tool."""

MIN_RELOCATION_ROLL_RAD = 0.5
"""Least angle (rad) by which a relocated camera sees the tool rotated."""


@dataclass(frozen=True, eq=False)
class SceneSampler:
    """Settings and random generator of the sampling.

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
    def is_endoscope(self) -> bool:
        """True if the camera is an endoscope."""
        return self.settings.ports is not None

    @property
    def feasibility(self) -> SceneFeasibility:
        """Test of the scenes."""
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
    """Return the scene with its camera and tissue elsewhere.

    The camera's new pose is drawn as for a new scene, until it shows the tool rotated by at least
    `MIN_RELOCATION_ROLL_RAD`.

    Raises
    ------
    NoScene
        If `MAX_DRAWS` samples are infeasible.
    """
    for rejected in range(MAX_DRAWS):
        camera = _sample_camera(sampler, scene.start, scene.target)
        if camera is None:
            continue
        new, tissue = camera
        optics = replace(scene.optics, rotation=new.rotation, position=new.position)
        if _is_valid_relocation(sampler, scene, optics):
            return replace(scene, optics=optics, tissue=tissue, rejected=rejected)
    raise NoScene(f"no other camera pose in {MAX_DRAWS} draws has both markers in view")


def _is_valid_relocation(sampler: SceneSampler, scene: Scene, optics: CameraModel) -> bool:
    """Return True if the scene is feasible with this camera and the tool appears rotated."""
    s_before, s_after = (
        _imaged_tool_angle(sampler.body, camera, scene.start) for camera in (scene.optics, optics)
    )
    turned = abs(wrap_angle(s_after - s_before)) > MIN_RELOCATION_ROLL_RAD
    feasibility = sampler.feasibility
    markers_visible = feasibility.markers_visible(optics, scene.path)
    return bool(turned) and markers_visible and feasibility.is_well_conditioned(optics, scene.path)


def _imaged_tool_angle(body: ToolBody, optics: CameraModel, q: Floats) -> float:
    """Return the angle s (rad) of the imaged tool, eq. (7), which needs no imaged RCM."""
    m = optics.project(body.points(q)[:2])
    return float(compute_features(m.ravel())[0])


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
    path = (
        plan_straight_path(body, start, target)
        if settings.is_sampled
        else np.stack([start, target])
    )
    return path, path[len(path) // 2]


def _sample_joints(sampler: SceneSampler) -> Floats:
    """Sample joints (3,) within their limits, with the insertion that the settings require."""
    body = sampler.body
    q = sampler.random.uniform(body.mechanism.limits.lower, body.mechanism.limits.upper)
    insertion = sampler.random.uniform(*sampler.settings.insertion)
    q[2] = insertion - body.mechanism.insertion_zero - body.tool.offset
    return q


def _sample_target(sampler: SceneSampler, start: Floats) -> Floats | None:
    """Sample joints that hold marker 1 at a sampled distance and direction from its start.

    None if that is outside the arm's reach.
    """
    p1: Floats = sampler.body.points(start)[0]
    direction = sampler.random.standard_normal(3)
    p1 = p1 + sampler.random.uniform(*sampler.settings.travel) * direction / np.linalg.norm(
        direction
    )
    rho, offset = float(np.linalg.norm(p1)), sampler.body.tool.offset
    return sampler.body.mechanism.joints(p1 * (1.0 - offset / rho)) if rho > offset else None


def _sample_camera(
    sampler: SceneSampler, start: Floats, target: Floats
) -> tuple[CameraModel, Tissue] | None:
    """Sample a camera that looks at the tool, and tissue behind the tool.

    The normal of the tissue bisects the vertical and the viewing direction. Return None if the
    camera is impossible: an endoscope outside its port, or a free camera with the RCM behind it.
    """
    points = np.concatenate([sampler.body.points(q) for q in (start, target)])
    down = np.array([0.0, 0.0, 1.0 if points[:, 2].sum() > 0.0 else -1.0])
    middle = (points[[0, 1, 4, 5]]).mean(axis=0)
    view = _sample_view(sampler, middle, down)
    if view is None:
        return None
    direction, distance = view
    tissue = _place_tissue(points, direction - down)
    optics = _sample_camera_at(sampler, middle, middle + distance * direction, distance)
    rcm_in_front = (
        optics.depth(np.zeros((1, 3)))[0] > MIN_RCM_DEPTH_RATIO * optics.depth(middle[None])[0]
    )
    return (optics, tissue) if sampler.is_endoscope or rcm_in_front else None


def _sample_view(
    sampler: SceneSampler, middle: Floats, down: Floats
) -> tuple[Floats, float] | None:
    """Sample the unit vector (3,) from the tool's `middle` to the camera, and the distance, mm."""
    if sampler.is_endoscope:
        return sample_through_port(sampler.random, sampler.settings, middle, down)
    return _sample_free_view(sampler, down)


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
    return Tissue((np.min(points @ normal) - TISSUE_CLEARANCE_MM) * normal, normal)


def _sample_camera_at(
    sampler: SceneSampler, middle: Floats, position: Floats, distance: float
) -> CameraModel:
    """Sample a camera at `position` that looks near the tool's `middle`, both (3,) mm."""
    random, (width, height) = sampler.random, sampler.size
    aim = middle + random.uniform(-0.05, 0.05, 3) * distance
    rotation = compute_look_at_rotation(position, aim, random.uniform(-np.pi, np.pi))
    shift = random.uniform(-0.02, 0.02, 2) * width
    centre = np.array([width - 1.0, height - 1.0]) / 2.0 + shift
    focal = random.uniform(*sampler.settings.focal)
    distortion = np.array(sampler.settings.distortion)
    return CameraModel(width, height, focal, centre, distortion, rotation, position)
