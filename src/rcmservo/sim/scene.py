"""Where camera, start and target are: drawn from a seed until the scene is one that the method is
made for."""

from dataclasses import dataclass, replace

import numpy as np

from rcmservo.errors import RcmServoError, require
from rcmservo.interfaces import Floats
from rcmservo.method.controller import scaled
from rcmservo.method.exploration import CORNERS
from rcmservo.method.features import SCALE, about, difference, features
from rcmservo.method.kinematics import Kinematics
from rcmservo.sim.cameras import Body
from rcmservo.sim.optics import Optics, look_at
from rcmservo.sim.renderer import Tissue
from rcmservo.sim.truth import feature_jacobian

MAX_DRAWS = 20_000
WAY = 9
"""Places on the way from start to target at which a scene is judged."""

BORDER = 12.0
"""px that both imaged balls keep from the picture's border."""

SEPARATION = 3.0
"""Least distance of the imaged markers in units of the larger one's radius, so that neither hides
the other."""

RCM_DEPTH = 0.3
"""Least depth of the RCM in units of the tool's: the method scales depth by it, so it must be
before the camera."""

CLEARANCE = 15.0
"""mm between the tool and the tissue behind it."""


TURNED = 0.5
"""Least angle rad by which a relocated camera sees the tool turned."""


class NoScene(RcmServoError):
    """No scene within the settings could be drawn."""


@dataclass(frozen=True)
class SceneSettings:
    """What scenes are drawn from. Pairs are (least, greatest).

    ``focal`` px; ``distance`` mm from camera to tool; ``elevation`` rad of the camera above the
    tool as seen along the straight-down axis; ``distortion`` k₁, k₂; ``travel`` mm from start to
    target; ``insertion`` mm of marker 1 from the RCM; ``max_condition`` of the scaled Jacobian
    along the straight way; ``room`` mm about the start in which both markers stay in view, to
    explore. With ``errors``, the start is where Δy = y − y_d is exactly this (rad, px, px), the way
    is that of the saturated law (33), and there is ``room`` half-way too. ``start`` and ``target``
    are joints (rad, rad, mm) of your own instead of drawn ones: then only their visibility is asked
    for.
    """

    focal: tuple[float, float] = (500.0, 900.0)
    distance: tuple[float, float] = (120.0, 300.0)
    elevation: tuple[float, float] = (-0.2, 0.9)
    distortion: tuple[float, float] = (-0.08, 0.02)
    travel: tuple[float, float] = (20.0, 60.0)
    insertion: tuple[float, float] = (70.0, 150.0)
    max_condition: float = 40.0
    room: float = 10.0
    errors: tuple[float, float, float] | None = None
    start: tuple[float, float, float] | None = None
    target: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        require(
            0.0 <= self.room < np.inf,
            "scene.room",
            self.room,
            "a length in mm that is not negative",
        )
        for name in ("focal", "distance", "travel", "insertion"):
            low, high = getattr(self, name)
            require(
                0.0 < low <= high < np.inf,
                f"scene.{name}",
                (low, high),
                "two positive numbers, least first",
            )
        low, high = self.elevation
        require(
            -1.5 <= low <= high <= 1.5,
            "scene.elevation",
            self.elevation,
            "two angles from -1.5 to 1.5 rad",
        )
        finite = bool(np.all(np.isfinite(self.distortion)))
        require(finite, "scene.distortion", self.distortion, "two finite numbers k1, k2")
        good = self.errors is None or (bool(np.all(np.isfinite(self.errors))) and any(self.errors))
        require(
            good, "scene.errors", self.errors, "three finite numbers (rad, px, px), not all zero"
        )
        placed = self.errors is None or (self.start is None and self.target is None)
        require(placed, "scene.errors", self.errors, "left out where start or target are given")
        require(
            self.max_condition > 1.0, "scene.max_condition", self.max_condition, "a number above 1"
        )
        for name in ("start", "target"):
            q = getattr(self, name)
            finite = q is None or bool(np.all(np.isfinite(q)))
            require(finite, f"scene.{name}", q, "three finite joint values (rad, rad, mm)")


@dataclass(frozen=True, eq=False)
class Scene:
    """A drawn scene: the true ``optics``, the ``way`` of joints (n, 3) from the start to the
    target, the joints (3,) ``half_way``, the ``tissue``, and how many draws were rejected."""

    optics: Optics
    way: Floats
    half_way: Floats
    tissue: Tissue
    rejected: int

    @property
    def start(self) -> Floats:
        return self.way[0]

    @property
    def target(self) -> Floats:
        return self.way[-1]


def draw(
    settings: SceneSettings,
    body: Body,
    size: tuple[int, int],
    radius: float,
    random: np.random.Generator,
) -> Scene:
    """The first scene that suits, of as many as it takes. `size` px of the picture, `radius` mm of
    the larger ball."""
    for rejected in range(MAX_DRAWS):
        scene = _attempt(settings, body, size, radius, random, rejected)
        if scene is not None:
            return scene
    raise NoScene(
        f"no scene in {MAX_DRAWS} draws has both markers in view: change the start and target "
        f"joints, the limits, "
        "or the ranges of focal length, distance and travel"
    )


def relocated(
    scene: Scene, body: Body, settings: SceneSettings, radius: float, random: np.random.Generator
) -> Scene:
    """The same start and target before the same camera elsewhere, drawn as scenes are, rolled by at
    least TURNED."""
    old = scene.optics
    for rejected in range(MAX_DRAWS):
        new, tissue = _camera(
            settings, body, (scene.start, scene.target), (old.width, old.height), random
        )
        if new is None:
            continue
        optics = replace(old, rotation=new.rotation, position=new.position)
        rolled = abs(
            difference(_features(body, optics, scene.start), _features(body, old, scene.start))[0]
        )
        visible = all(_visible(body, optics, q, radius) for q in scene.way)
        if rolled > TURNED and visible and _regular(settings, body, optics, scene.way):
            return replace(scene, optics=optics, tissue=tissue, rejected=rejected)
    raise NoScene(f"no other place for the camera in {MAX_DRAWS} draws has both markers in view")


def _features(body: Body, optics: Optics, q: Floats) -> Floats:
    """y (3,) about the true imaged RCM at the joints q (3,)."""
    o_c = optics.project(np.zeros((1, 3)))[0]
    return features(about(optics.project(body.points(q)[:2]), o_c))


def _attempt(
    settings: SceneSettings,
    body: Body,
    size: tuple[int, int],
    radius: float,
    random: np.random.Generator,
    rejected: int,
) -> Scene | None:
    start = np.array(settings.start) if settings.start else _configuration(settings, body, random)
    target = np.array(settings.target) if settings.target else _near(settings, body, start, random)
    if target is None:
        return None
    optics, tissue = _camera(settings, body, (start, target), size, random)
    if optics is None:
        return None
    ways = _ways(settings, body, optics, start, target)
    if ways is None:
        return None
    scene = Scene(optics, *ways, tissue, rejected)
    return scene if _suits(scene, settings, body, radius) else None


def _ways(
    settings: SceneSettings, body: Body, optics: Optics, start: Floats, target: Floats
) -> tuple[Floats, Floats] | None:
    """Joints of the way from start to target, and half-way; None where no start has the `errors`
    asked for."""
    if settings.errors is not None:
        return _way_of_errors(body, optics, target, np.array(settings.errors))
    way = _way(body, start, target) if _free(settings) else np.stack([start, target])
    return way, way[len(way) // 2]


def _free(settings: SceneSettings) -> bool:
    return not (settings.start and settings.target)


def _suits(scene: Scene, settings: SceneSettings, body: Body, radius: float) -> bool:
    """Whether the scene is one that the method is made for; of a scene of the user's own only
    visibility is asked."""
    if _free(settings) and not _inside(body.kinematics, scene.way):
        return False
    if not all(_visible(body, scene.optics, q, radius) for q in (*scene.way, scene.half_way)):
        return False
    if not _free(settings):
        return True
    explored = [scene.start] if settings.errors is None else [scene.start, scene.half_way]
    room = all(_room(body, scene.optics, q, settings.room) for q in explored)
    return room and _regular(settings, body, scene.optics, scene.way)


def _configuration(settings: SceneSettings, body: Body, random: np.random.Generator) -> Floats:
    limits = body.kinematics.limits
    q = random.uniform(limits.lower, limits.upper)
    q[2] = random.uniform(*settings.insertion) - body.kinematics.insertion_zero - body.tool.offset
    return q


def _near(
    settings: SceneSettings, body: Body, start: Floats, random: np.random.Generator
) -> Floats | None:
    """Joints that hold marker 1 a drawn distance from where it starts, in any direction."""
    p1 = body.points(start)[0]
    way = random.standard_normal(3)
    p1 = p1 + random.uniform(*settings.travel) * way / np.linalg.norm(way)
    rho = float(np.linalg.norm(p1))
    return (
        body.kinematics.joints(p1 * (1.0 - body.tool.offset / rho))
        if rho > body.tool.offset
        else None
    )


def _way(body: Body, start: Floats, target: Floats) -> Floats:
    a, b = (body.kinematics.position(q) for q in (start, target))
    return np.stack(
        [body.kinematics.joints(a + share * (b - a)) for share in np.linspace(0.0, 1.0, WAY)]
    )


def _way_of_errors(
    body: Body, optics: Optics, target: Floats, errors: Floats
) -> tuple[Floats, Floats] | None:
    """Joints (WAY, 3) on the way of the saturated law (33) from Δy = `errors` (rad, px, px), and
    where half of them is left; None where there are none."""
    y_d = _features(body, optics, target)
    way = [target]
    longest = np.max(np.abs(errors) / SCALE)
    for share in np.linspace(1.0, 0.0, WAY)[1:]:
        left = np.sign(errors) * np.maximum(np.abs(errors) - share * longest * SCALE, 0.0)
        q = _with_error(body, optics, way[-1], y_d, left)
        if q is None:
            return None
        way.append(q)
    half_way = _with_error(body, optics, way[WAY // 2], y_d, 0.5 * errors)
    return None if half_way is None else (np.stack(way[::-1]), half_way)


def _with_error(body: Body, optics: Optics, q: Floats, y_d: Floats, error: Floats) -> Floats | None:
    """Joints (3,) at which y − y_d is `error`, by Newton's method from q; None where it finds
    none."""
    for _ in range(10):
        left = difference(error, difference(_features(body, optics, q), y_d))
        if np.max(np.abs(left) / SCALE) < 1e-9:
            return q
        J = scaled(feature_jacobian(body, optics, q, optics.project(np.zeros((1, 3)))[0]))
        if not (np.isfinite(J).all() and np.linalg.cond(J) < 1e6):
            return None
        p1 = body.points(q)[0] + np.linalg.solve(J, left / SCALE)
        near = body.kinematics.joints(p1 * (1.0 - body.tool.offset / np.linalg.norm(p1)))
        near[:2] += 2.0 * np.pi * np.round((q[:2] - near[:2]) / (2.0 * np.pi))
        q = near
    return None


def _camera(
    settings: SceneSettings,
    body: Body,
    ends: tuple[Floats, Floats],
    size: tuple[int, int],
    random: np.random.Generator,
) -> tuple[Optics | None, Tissue]:
    """A camera that looks at the tool from anywhere around it, and tissue behind the tool, half
    facing the camera."""
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


def _room(body: Body, optics: Optics, q: Floats, room: float) -> bool:
    """Whether both markers stay in the picture about the joints q (3,)."""
    p1 = body.points(q)[0]
    around = p1 + room * np.concatenate([CORNERS, -CORNERS])
    m = optics.project(np.concatenate([around, [body.tool.second_marker(p) for p in around]]))
    return bool(((m > BORDER) & (m < np.array([optics.width, optics.height]) - BORDER)).all())


def _regular(settings: SceneSettings, body: Body, optics: Optics, way: Floats) -> bool:
    """Whether the scaled Jacobian is well conditioned along the way."""
    o_c = optics.project(np.zeros((1, 3)))[0]
    if not np.isfinite(o_c).all():
        return False
    return all(
        np.linalg.cond(scaled(feature_jacobian(body, optics, q, o_c))) <= settings.max_condition
        for q in way
    )
