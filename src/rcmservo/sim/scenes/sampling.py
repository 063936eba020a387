"""Scenes are drawn from a seed until one suits."""

from dataclasses import dataclass, replace

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.method.features import features, wrapped
from rcmservo.sim.camera_model import Optics, look_at
from rcmservo.sim.rendering import Tissue
from rcmservo.sim.scene import NoScene, Scene, SceneSettings
from rcmservo.sim.scenes.endoscope import through_port
from rcmservo.sim.scenes.feasibility import Fitness
from rcmservo.sim.scenes.joint_paths import straight, with_errors
from rcmservo.sim.tool_body import Body

MAX_DRAWS = 20_000

RCM_DEPTH = 0.3
"""Least depth of the RCM, in units of the tool's. The method scales depth by the RCM's, so the RCM
must be before the camera."""

CLEARANCE = 15.0
"""mm between the tool and the tissue behind it."""

TURNED = 0.5
"""Least angle rad by which a relocated camera sees the tool turned."""


@dataclass(frozen=True, eq=False)
class Draws:
    """What scenes are drawn with."""

    settings: SceneSettings
    """What they are drawn from."""

    body: Body
    """The tool."""

    size: tuple[int, int]
    """px, the picture's width and height."""

    radius: float
    """mm, that of the larger ball."""

    random: np.random.Generator
    """The chance."""

    @property
    def ported(self) -> bool:
        """Whether the camera is an endoscope."""
        return self.settings.ports is not None

    @property
    def fitness(self) -> Fitness:
        return Fitness(self.settings, self.body, self.radius)


def draw(draws: Draws) -> Scene:
    """The first scene that suits."""
    for rejected in range(MAX_DRAWS):
        scene = _attempt(draws, rejected)
        if scene is not None and draws.fitness.suits(scene):
            return scene
    raise NoScene(
        f"no scene in {MAX_DRAWS} draws has both markers in view and the condition asked for: "
        "change the start and target joints, the limits, or the ranges of focal length, distance, "
        "travel and condition"
    )


def relocated(draws: Draws, scene: Scene) -> Scene:
    """The same start and target, and the same camera elsewhere, rolled by at least TURNED.

    Its place is drawn as that of any scene is.
    """
    for rejected in range(MAX_DRAWS):
        camera = _camera(draws, scene.start, scene.target)
        if camera is None:
            continue
        new, tissue = camera
        optics = replace(scene.optics, rotation=new.rotation, position=new.position)
        if _differs(draws, scene, optics):
            return replace(scene, optics=optics, tissue=tissue, rejected=rejected)
    raise NoScene(f"no other place for the camera in {MAX_DRAWS} draws has both markers in view")


def _differs(draws: Draws, scene: Scene, optics: Optics) -> bool:
    """Whether the scene suits before this camera too, and is seen turned by it."""
    before, after = (_seen_angle(draws.body, one, scene.start) for one in (scene.optics, optics))
    turned = abs(wrapped(after - before)) > TURNED
    fitness = draws.fitness
    visible = fitness.visible(optics, scene.way)
    return bool(turned) and visible and fitness.regular(optics, scene.way)


def _seen_angle(body: Body, optics: Optics, q: Floats) -> float:
    """That of the imaged tool, s of eq. (7), rad; it needs no imaged RCM."""
    m = optics.project(body.points(q)[:2])
    return float(features(m.ravel())[0])


def _attempt(draws: Draws, rejected: int) -> Scene | None:
    """A scene, which may not suit; None where not even one could be made."""
    s = draws.settings
    start = np.array(s.start) if s.start else _configuration(draws)
    target = np.array(s.target) if s.target else _near(draws, start)
    if target is None:
        return None
    camera = _camera(draws, start, target)
    if camera is None:
        return None
    optics, tissue = camera
    ways = _ways(draws, optics, start, target)
    return None if ways is None else Scene(optics, draws.body, *ways, tissue, rejected)


def _ways(
    draws: Draws, optics: Optics, start: Floats, target: Floats
) -> tuple[Floats, Floats] | None:
    """Joints of the way from start to target, and half-way. None where no start has the `errors`
    asked for."""
    settings, body = draws.settings, draws.body
    if settings.errors is not None:
        return with_errors(body, optics, target, np.array(settings.errors))
    way = straight(body, start, target) if settings.free else np.stack([start, target])
    return way, way[len(way) // 2]


def _configuration(draws: Draws) -> Floats:
    """Joints (3,) anywhere, with marker 1 inserted as far as the settings say."""
    body = draws.body
    q = draws.random.uniform(body.mechanism.limits.lower, body.mechanism.limits.upper)
    inserted = draws.random.uniform(*draws.settings.insertion)
    q[2] = inserted - body.mechanism.insertion_zero - body.tool.offset
    return q


def _near(draws: Draws, start: Floats) -> Floats | None:
    """Joints that hold marker 1 a drawn distance from where it starts, in any direction."""
    p1: Floats = draws.body.points(start)[0]
    way = draws.random.standard_normal(3)
    p1 = p1 + draws.random.uniform(*draws.settings.travel) * way / np.linalg.norm(way)
    rho, offset = float(np.linalg.norm(p1)), draws.body.tool.offset
    return draws.body.mechanism.joints(p1 * (1.0 - offset / rho)) if rho > offset else None


def _camera(draws: Draws, start: Floats, target: Floats) -> tuple[Optics, Tissue] | None:
    """A camera that looks at the tool, and tissue behind the tool, half facing the camera. None
    where there cannot be that camera: through a port, or anywhere with the RCM before it."""
    points = np.concatenate([draws.body.points(q) for q in (start, target)])
    down = np.array([0.0, 0.0, 1.0 if points[:, 2].sum() > 0.0 else -1.0])
    middle = (points[[0, 1, 4, 5]]).mean(axis=0)
    place = _place(draws, middle, down)
    if place is None:
        return None
    towards, distance = place
    tissue = _tissue(points, towards - down)
    optics = _looking(draws, middle, middle + distance * towards, distance)
    before = optics.depth(np.zeros((1, 3)))[0] > RCM_DEPTH * optics.depth(middle[None])[0]
    return (optics, tissue) if draws.ported or before else None


def _place(draws: Draws, middle: Floats, down: Floats) -> tuple[Floats, float] | None:
    """The unit direction (3,) from the tool's `middle` to the camera, and how far it is, mm."""
    if draws.ported:
        return through_port(draws.random, draws.settings, middle, down)
    return _towards_camera(draws, down)


def _towards_camera(draws: Draws, down: Floats) -> tuple[Floats, float]:
    """The unit direction (3,) from the tool to the camera, and how far it is, mm."""
    random, settings = draws.random, draws.settings
    azimuth, elevation = random.uniform(-np.pi, np.pi), random.uniform(*settings.elevation)
    across = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    distance = random.uniform(*settings.distance)
    return np.cos(elevation) * across - np.sin(elevation) * down, distance


def _tissue(points: Floats, normal: Floats) -> Tissue:
    """Tissue across `normal` (3,), behind all `points` (N, 3) of the tool."""
    normal = normal / np.linalg.norm(normal)
    return Tissue((np.min(points @ normal) - CLEARANCE) * normal, normal)


def _looking(draws: Draws, middle: Floats, position: Floats, distance: float) -> Optics:
    """A camera at `position` that looks at about the tool's `middle`, both (3,) mm."""
    random, (width, height) = draws.random, draws.size
    aim = middle + random.uniform(-0.05, 0.05, 3) * distance
    rotation = look_at(position, aim, random.uniform(-np.pi, np.pi))
    aside = random.uniform(-0.02, 0.02, 2) * width
    centre = np.array([width - 1.0, height - 1.0]) / 2.0 + aside
    focal = random.uniform(*draws.settings.focal)
    distortion = np.array(draws.settings.distortion)
    return Optics(width, height, focal, centre, distortion, rotation, position)
