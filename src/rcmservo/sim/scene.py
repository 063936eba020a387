"""Where camera, start and target are: drawn from a seed until the scene is one that the method is made for."""

from dataclasses import dataclass

import numpy as np

from rcmservo.controller import scaled
from rcmservo.errors import RcmServoError, require
from rcmservo.exploration import CORNERS
from rcmservo.mechanism import Kinematics
from rcmservo.plant import Floats
from rcmservo.sim.cameras import Body
from rcmservo.sim.optics import Optics, look_at
from rcmservo.sim.renderer import Tissue
from rcmservo.sim.truth import feature_jacobian

MAX_DRAWS = 20_000
WAY = 9
"""Places on the straight way from start to target at which a scene is judged."""

BORDER = 12.0
"""px that both imaged balls keep from the picture's border."""

SEPARATION = 3.0
"""Least distance of the imaged markers in units of the larger one's radius, so that neither hides the other."""

RCM_DEPTH = 0.3
"""Least depth of the RCM in units of the tool's: the method scales depth by it, so it must be before the camera."""

CLEARANCE = 15.0
"""mm between the tool and the tissue behind it."""


class NoScene(RcmServoError):
    """No scene within the settings could be drawn."""


@dataclass(frozen=True)
class SceneSettings:
    """What scenes are drawn from. Pairs are (least, greatest).

    ``focal`` px; ``distance`` mm from camera to tool; ``elevation`` rad of the camera above the tool as seen along the
    straight-down axis; ``distortion`` k₁, k₂; ``travel`` mm from start to target; ``insertion`` mm of marker 1 from
    the RCM; ``max_condition`` of the scaled Jacobian along the straight way; ``room`` mm about
    the start in which both markers stay in view, to explore. ``start`` and ``target`` are joints
    (rad, rad, mm) of your own instead of drawn ones: then only their visibility is asked for.
    """

    focal: tuple[float, float] = (500.0, 900.0)
    distance: tuple[float, float] = (120.0, 300.0)
    elevation: tuple[float, float] = (-0.2, 0.9)
    distortion: tuple[float, float] = (-0.08, 0.02)
    travel: tuple[float, float] = (20.0, 60.0)
    insertion: tuple[float, float] = (70.0, 150.0)
    max_condition: float = 40.0
    room: float = 10.0
    start: tuple[float, float, float] | None = None
    target: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        require(0.0 <= self.room < np.inf, "scene.room", self.room, "a length in mm that is not negative")
        for name in ("focal", "distance", "travel", "insertion"):
            low, high = getattr(self, name)
            require(0.0 < low <= high < np.inf, f"scene.{name}", (low, high), "two positive numbers, least first")
        low, high = self.elevation
        require(-1.5 <= low <= high <= 1.5, "scene.elevation", self.elevation, "two angles from -1.5 to 1.5 rad")
        finite = bool(np.all(np.isfinite(self.distortion)))
        require(finite, "scene.distortion", self.distortion, "two finite numbers k1, k2")
        require(self.max_condition > 1.0, "scene.max_condition", self.max_condition, "a number above 1")
        for name in ("start", "target"):
            q = getattr(self, name)
            finite = q is None or bool(np.all(np.isfinite(q)))
            require(finite, f"scene.{name}", q, "three finite joint values (rad, rad, mm)")


@dataclass(frozen=True, eq=False)
class Scene:
    """A drawn scene: the true ``optics``, ``start`` and ``target`` joints (3,), the ``tissue``, and rejected draws."""

    optics: Optics
    start: Floats
    target: Floats
    tissue: Tissue
    rejected: int


def draw(
    settings: SceneSettings, body: Body, size: tuple[int, int], radius: float, random: np.random.Generator
) -> Scene:
    """The first scene that suits, of as many as it takes. `size` px of the picture, `radius` mm of the larger ball."""
    for rejected in range(MAX_DRAWS):
        scene = _attempt(settings, body, size, radius, random, rejected)
        if scene is not None:
            return scene
    raise NoScene(
        f"no scene in {MAX_DRAWS} draws has both markers in view: change the start and target joints, the limits, "
        "or the ranges of focal length, distance and travel"
    )


def _attempt(
    settings: SceneSettings,
    body: Body,
    size: tuple[int, int],
    radius: float,
    random: np.random.Generator,
    rejected: int,
) -> Scene | None:
    kinematics = body.kinematics
    start = np.array(settings.start) if settings.start else _configuration(settings, body, random)
    target = np.array(settings.target) if settings.target else _near(settings, body, start, random)
    if target is None:
        return None
    optics, tissue = _camera(settings, body, (start, target), size, random)
    if optics is None:
        return None
    free = not (settings.start and settings.target)
    way = _way(body, start, target) if free else np.stack([start, target])
    if free and not _inside(kinematics, way):
        return None
    if not all(_visible(body, optics, q, radius) for q in way):
        return None
    if free and not (_room(body, optics, start, settings.room) and _regular(settings, body, optics, way)):
        return None
    return Scene(optics, start, target, tissue, rejected)


def _configuration(settings: SceneSettings, body: Body, random: np.random.Generator) -> Floats:
    limits = body.kinematics.limits
    q = random.uniform(limits.lower, limits.upper)
    q[2] = random.uniform(*settings.insertion) - body.kinematics.insertion_zero - body.tool.offset
    return q


def _near(settings: SceneSettings, body: Body, start: Floats, random: np.random.Generator) -> Floats | None:
    """Joints that hold marker 1 a drawn distance from where it starts, in any direction."""
    p1 = body.points(start)[0]
    way = random.standard_normal(3)
    p1 = p1 + random.uniform(*settings.travel) * way / np.linalg.norm(way)
    rho = float(np.linalg.norm(p1))
    return body.kinematics.joints(p1 * (1.0 - body.tool.offset / rho)) if rho > body.tool.offset else None


def _way(body: Body, start: Floats, target: Floats) -> Floats:
    a, b = (body.kinematics.position(q) for q in (start, target))
    return np.stack([body.kinematics.joints(a + share * (b - a)) for share in np.linspace(0.0, 1.0, WAY)])


def _camera(
    settings: SceneSettings, body: Body, ends: tuple[Floats, Floats], size: tuple[int, int], random: np.random.Generator
) -> tuple[Optics | None, Tissue]:
    """A camera that looks at the tool from anywhere around it, and tissue behind the tool, half facing the camera."""
    points = np.concatenate([body.points(q) for q in ends])
    down = np.array([0.0, 0.0, 1.0 if points[:, 2].sum() > 0.0 else -1.0])
    middle = (points[[0, 1, 4, 5]]).mean(axis=0)
    azimuth, elevation = random.uniform(-np.pi, np.pi), random.uniform(*settings.elevation)
    across = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    distance = random.uniform(*settings.distance)
    towards = np.cos(elevation) * across - np.sin(elevation) * down
    position = middle + distance * towards
    normal = (towards - down) / np.linalg.norm(towards - down)
    tissue = Tissue((np.min(points @ normal) - CLEARANCE) * normal, normal)
    aim = middle + random.uniform(-0.05, 0.05, 3) * distance
    rotation = look_at(position, aim, random.uniform(-np.pi, np.pi))
    width, height = size
    centre = np.array([width - 1.0, height - 1.0]) / 2.0 + random.uniform(-0.02, 0.02, 2) * width
    focal = random.uniform(*settings.focal)
    optics = Optics(width, height, focal, centre, np.array(settings.distortion), rotation, position)
    before = optics.depth(np.zeros((1, 3)))[0] > RCM_DEPTH * optics.depth(middle[None])[0]
    return (optics if before else None), tissue


def _inside(kinematics: Kinematics, way: Floats) -> bool:
    """Whether the way keeps 3 % of each joint's range from its limits."""
    lower, upper = np.array(kinematics.limits.lower), np.array(kinematics.limits.upper)
    margin = 0.03 * (upper - lower)
    return bool(((way > lower + margin) & (way < upper - margin)).all())


def _visible(body: Body, optics: Optics, q: Floats, radius: float) -> bool:
    """Whether both balls are whole in the picture and apart from each other."""
    markers = body.points(q)[:2]
    depth = optics.depth(markers)
    if not (depth > 5.0 * radius).all():
        return False
    m = optics.project(markers)
    r = float(np.max(optics.focal * radius / depth)) * 1.2
    inside = ((m > r + BORDER) & (m < np.array([optics.width, optics.height]) - r - BORDER)).all()
    return bool(inside and np.linalg.norm(m[1] - m[0]) > SEPARATION * r)


def _room(body: Body, optics: Optics, start: Floats, room: float) -> bool:
    """Whether both markers stay in the picture about the start."""
    p1 = body.points(start)[0]
    around = p1 + room * np.concatenate([CORNERS, -CORNERS])
    m = optics.project(np.concatenate([around, [body.tool.second_marker(p) for p in around]]))
    return bool(((m > BORDER) & (m < np.array([optics.width, optics.height]) - BORDER)).all())


def _regular(settings: SceneSettings, body: Body, optics: Optics, way: Floats) -> bool:
    """Whether the scaled Jacobian is well conditioned along the way."""
    o_c = optics.project(np.zeros((1, 3)))[0]
    if not np.isfinite(o_c).all():
        return False
    return all(np.linalg.cond(scaled(feature_jacobian(body, optics, q, o_c))) <= settings.max_condition for q in way)
