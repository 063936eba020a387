"""Pictures of the tool over the tissue: a ray-caster for one still camera, a plane, and four round
bodies.

The camera and the tissue stand still, so the lit tissue is painted once. A picture is then made in
four passes: the tool's soft shadow on the tissue; which body each pixel sees; the bodies' colours;
the sensor's noise. Only tiles that a body or its shadow may touch are visited, and only pixels on
an outline are sampled more than once, at places and moments spread over the pixel and the exposure:
coverage is integrated over both.

All four bodies (shaft, jaw, two balls) are capsules; a ball is one without length. Inside,
everything is in camera axes, in mm, and a ray is (x, y, 1) t, so that t is depth. Light is linear,
in grey levels (255 saturates); colours are blue, green, red as in OpenCV.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from rcmservo.compiled import compiled
from rcmservo.errors import require
from rcmservo.interfaces import Floats, Image
from rcmservo.sim.optics import Optics

Light = NDArray[np.float32]
Between = Callable[[Light], None]
Colour = tuple[float, float, float]
Vector = tuple[float, float, float]
Lamp = tuple[
    Vector, float, float, float, float
]  # place, radius, reach, ambient, exponent: as in Look

TILE = 16  # px
STEP = 4  # px between the nodes at which the shadow is worked out
SAMPLES = 16  # on a pixel at an outline
MOMENTS = (1, 2, 4, 8, 16)  # per exposure, that share those samples evenly
NEAR = 1.0  # mm before the camera at which bodies are cut off
NORMALS = 1 << 21
TEXELS = 512
BUMP = 0.05  # of the texture's period
WETNESS = 0.3  # how strongly tissue shines, as a share of the tool
HORIZON = 3.0  # times the lamp's reach: from here to twice as far the tissue fades into the dark
TINY = 1e-12


@dataclass(frozen=True)
class Look:
    """How the scene looks: the tool's thickness, the colours, the light, the sensor.

    Radii in mm, 0 for a body that is not there. `light` is the lamp's place in camera axes, mm;
    what faces it from `reach` mm has its nominal colour, however near never more than twice as
    bright. `ambient` is the share of light that comes from everywhere; `specular` and `exponent`
    are the strength and sharpness of highlights. The tissue's texture repeats every `texture` mm;
    its `contrast` is the spread of its brightness, its `relief` the spread of its height in mm.
    `full_well` is the number of electrons at grey level 255, which sets the shot noise;
    `read_noise` is in grey levels.
    """

    marker_radii: tuple[float, float] = (3.5, 3.5)
    shaft_radius: float = 2.5
    jaw_radius: float = 1.2
    marker_colours: tuple[Colour, Colour] = ((60.0, 185.0, 30.0), (205.0, 80.0, 25.0))
    shaft_colour: Colour = (46.0, 44.0, 42.0)
    jaw_colour: Colour = (150.0, 150.0, 150.0)
    tissue_colour: Colour = (128.0, 132.0, 215.0)
    texture: float = 150.0
    contrast: float = 0.1
    relief: float = 0.45
    light: Vector = (35.0, -45.0, 0.0)
    lamp_radius: float = 4.0
    reach: float = 200.0
    ambient: float = 0.2
    specular: float = 0.8
    exponent: float = 50.0
    full_well: float = 12000.0
    read_noise: float = 1.0

    def __post_init__(self) -> None:
        for name in (
            "marker_radii",
            "shaft_radius",
            "jaw_radius",
            "contrast",
            "relief",
            "specular",
            "read_noise",
        ):
            value = np.array(getattr(self, name))
            require(
                bool(((value >= 0) & (value < np.inf)).all()),
                name,
                value,
                "finite and not negative",
            )
        for name in ("texture", "lamp_radius", "reach", "exponent", "full_well"):
            require(getattr(self, name) > 0, name, getattr(self, name), "positive")
        for name in ("light", "marker_colours", "shaft_colour", "jaw_colour", "tissue_colour"):
            require(
                bool(np.isfinite(getattr(self, name)).all()), name, getattr(self, name), "finite"
            )
        require(0 <= self.ambient <= 1, "ambient", self.ambient, "between 0 and 1")


@dataclass(frozen=True, eq=False)
class Tissue:
    """The plane behind the tool: a `point` (3,) mm on it and its `normal` (3,), in the world,
    either way up."""

    point: Floats
    normal: Floats

    def __post_init__(self) -> None:
        require(bool(np.linalg.norm(self.normal) > 0), "normal", self.normal, "a direction")


class Renderer:
    """A camera that makes pictures. The same seed, number and poses give the same picture, bit for
    bit."""

    def __init__(self, optics: Optics, look: Look, tissue: Tissue, seed: int) -> None:
        require(seed >= 0, "seed", seed, "at least 0")
        self.optics, self.look, self.seed = optics, look, seed
        noise = np.random.default_rng(seed)
        self._rays = _rays(optics)
        self._cones = _cones(optics)
        self._nodes = _nodes(optics, tissue)
        self._tissue, self._lamp_share = _lit_tissue(
            self._rays[..., :2], optics, look, tissue, noise
        )
        x, y, z, radius, reach, ambient, exponent = (
            float(value)
            for value in (*look.light, look.lamp_radius, look.reach, look.ambient, look.exponent)
        )
        self._lamp: Lamp = ((x, y, z), radius, reach, ambient, exponent)
        self._normals = noise.standard_normal(NORMALS, dtype=np.float32)
        self._canvas = np.empty_like(self._tissue)
        self._seen = np.empty((2, optics.height, optics.width), dtype=np.uint8)

    def render(self, poses: Floats, number: int, between: Between | None = None) -> Image:
        """The picture (H, W, 3) of one exposure.

        `poses` (T, 4, 3) mm: m1, m2, the shaft's start (towards the RCM) and the tool's tip, in the
        world, at T = 1, 2, 4, 8 or 16 moments spread evenly over the exposure. The shaft may start
        behind the camera. `number` of the frame, at least 0: each frame has noise of its own.
        `between` changes the light (H, W, 3) on its way to the sensor, in place.
        """
        require(
            poses.ndim == 3 and poses.shape[1:] == (4, 3), "poses' shape", poses.shape, "(T, 4, 3)"
        )
        require(len(poses) in MOMENTS, "number of poses", len(poses), f"one of {MOMENTS}")
        require(bool(np.isfinite(poses).all()), "poses", poses, "finite")
        require(number >= 0, "number", number, "at least 0")
        bodies = _bodies(np.concatenate([poses.mean(axis=0)[None], poses]), self.optics, self.look)
        np.copyto(self._canvas, self._tissue)
        cast_shadow(self._canvas, self._lamp_share, self._nodes, bodies, self._lamp)
        touched = touch(self._cones, bodies)
        identify(self._seen, touched, self._rays, bodies)
        colour(
            self._canvas, self._seen, touched, self._rays, bodies, self._lamp, _pattern(len(poses))
        )
        if between is not None:
            between(self._canvas)
        return self._expose(number)

    def _expose(self, number: int) -> Image:
        """The canvas as the sensor reads it."""
        rows = self._canvas.reshape(self.optics.height, -1)
        starts = np.random.default_rng([self.seed, number]).integers(
            NORMALS - rows.shape[1], size=len(rows)
        )
        shot, read = np.float32(255 / self.look.full_well), np.float32(self.look.read_noise**2)
        return expose(rows, self._normals, starts, shot, read).reshape(self._canvas.shape)


def _rays(optics: Optics) -> Floats:
    """For each pixel x, y of the ray through its centre, and their changes from pixel to pixel: (H,
    W, 6).

    The order is x, y, dx/du, dy/du, dx/dv, dy/dv.
    """
    slopes = optics.slopes(optics.pixels())
    return np.concatenate([slopes, *np.gradient(slopes, axis=(1, 0))], axis=2)


def _pattern(moments: int) -> Floats:
    """Where in the pixel and when each sample is taken: (SAMPLES, 3) of u, v in px from the centre,
    pose number.

    The places are Hammersley's. Up to four moments, each one's samples have their mean at the
    pixel's centre, so that blur shifts nothing.
    """
    i = np.arange(SAMPLES)
    mirrored = sum(((i >> bit) & 1) << (3 - bit) for bit in range(4))
    turn = (i // 4 + i % 4) % 4 * 4 + i // 4
    return np.stack(
        [(i + 0.5) / 16 - 0.5, (mirrored + 0.5) / 16 - 0.5, 1 + turn * moments // SAMPLES], axis=1
    )


# ---------------------------------------------------------------- the bodies


def _bodies(poses: Floats, optics: Optics, look: Look) -> Floats:
    """Shaft, jaw, m1 and m2 in each of `poses` (T, 4, 3), as the kernels want them: (4 T, 15).

    Row 4 s + k is body k in pose s; pose 0 is the exposure's mean, its moments follow. The shaft
    reaches half way from m2 to the tip, the thinner jaw from there on. Columns: one end A; the axis
    n from A to the other end B; radius r, n.n, A.n, A.A - r^2, B.B - r^2; colour; strength of the
    highlight, grey levels. A body that is absent, or wholly behind the camera, has radius 0.
    """
    m1, m2, start, tip = np.moveaxis((poses - optics.position) @ optics.rotation.T, 1, 0)
    wrist = (m2 + tip) / 2
    A = np.stack([start, wrist, m1, m2], axis=1)
    B = np.stack([wrist, tip, m1, m2], axis=1)
    radius = np.broadcast_to([look.shaft_radius, look.jaw_radius, *look.marker_radii], A.shape[:2])
    A, B = _in_front(A, B, radius + NEAR), _in_front(B, A, radius + NEAR)
    r = np.where((A[..., 2] > radius) & (B[..., 2] > radius), radius, 0.0)
    n = B - A
    products = [(n * n).sum(-1), (A * n).sum(-1), (A * A).sum(-1) - r**2, (B * B).sum(-1) - r**2]
    colours = np.broadcast_to([look.shaft_colour, look.jaw_colour, *look.marker_colours], A.shape)
    highlight = np.full_like(r, 255 * look.specular)
    columns = [A, n, np.stack([r, *products], axis=-1), colours, highlight[..., None]]
    return np.concatenate(columns, axis=-1).reshape(-1, 15)


def _in_front(end: Floats, other: Floats, near: Floats) -> Floats:
    """`end`, moved along the axis to depth `near` if it lies nearer than that and the `other` end
    does not."""
    depth, far = end[..., 2], other[..., 2]
    cut = (depth < near) & (far > near)
    share = np.where(cut, (near - depth) / np.where(cut, far - depth, 1), 0.0)
    return end + share[..., None] * (other - end)


@compiled
def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled
def times(s: float, a: Vector) -> Vector:
    return s * a[0], s * a[1], s * a[2]


@compiled
def clip(share: float) -> float:
    return min(max(share, 0.0), 1.0)


@compiled
def start(bodies: Floats, b: int) -> Vector:
    return bodies[b, 0], bodies[b, 1], bodies[b, 2]


@compiled
def axis(bodies: Floats, b: int) -> Vector:
    return bodies[b, 3], bodies[b, 4], bodies[b, 5]


@compiled
def hit(ray: Vector, bodies: Floats, b: int) -> float:
    """The depth at which a ray (x, y, 1) enters a body; inf if it passes by."""
    if bodies[b, 6] == 0.0:
        return np.inf
    nn, An, AA, BB = bodies[b, 7], bodies[b, 8], bodies[b, 9], bodies[b, 10]
    dd, dA, dn = dot(ray, ray), dot(ray, start(bodies, b)), dot(ray, axis(bodies, b))
    along = -1.0
    if nn > 0.0:  # the infinite cylinder
        a, half = nn * dd - dn * dn, An * dn - nn * dA
        h = half * half - a * (nn * AA - An * An)
        if h < 0.0:
            return np.inf
        t = -(half + np.sqrt(h)) / a
        along = t * dn - An
        if 0.0 < along < nn:
            return t if t > 0.0 else np.inf
    if along > 0.0:  # the ball at B, else the one at A
        dA, AA = dA + dn, BB
    h = dA * dA - dd * AA
    if h < 0.0:
        return np.inf
    t = (dA - np.sqrt(h)) / dd
    return t if t > 0.0 else np.inf


@compiled
def nearest(ray: Vector, bodies: Floats, pose: int, which: int) -> tuple[int, float]:
    """The first of the bodies in the bit set `which` that a ray meets in a pose, and its depth; -1
    if none."""
    body, depth = -1, np.inf
    for k in range(4):
        if which >> k & 1:
            t = hit(ray, bodies, 4 * pose + k)
            if t < depth:
                body, depth = k, t
    return body, depth


@compiled
def gap(p: Vector, u: Vector, bodies: Floats, b: int) -> tuple[float, float]:
    """How near the segment from p to p + u comes to a body's axis, mm, and where on the segment, 0
    to 1."""
    n, nn = axis(bodies, b), bodies[b, 7]
    r = minus(p, start(bodies, b))
    uu, un, ur, nr = dot(u, u), dot(u, n), dot(u, r), dot(n, r)
    twist = uu * nn - un * un
    on_u = clip((un * nr - ur * nn) / twist) if twist > 0.0 else 0.0
    on_n = clip((un * on_u + nr) / nn) if nn > 0.0 else 0.0
    on_u = clip((un * on_n - ur) / uu)
    d = minus(minus(r, times(-on_u, u)), times(on_n, n))
    return np.sqrt(dot(d, d)), on_u


# ---------------------------------------------------------------- which body each pixel sees


def _cones(optics: Optics) -> Floats:
    """For each tile the unit direction of its middle and the angle from there to its corners:
    (rows, columns, 4)."""
    v, u = (np.arange(0, size, TILE) for size in (optics.height, optics.width))
    edge = np.array([optics.width, optics.height]) - 0.5

    def ray(du: float, dv: float) -> Floats:
        pixels = np.stack(np.meshgrid(u + du, v + dv), axis=-1)
        slopes = optics.slopes(np.minimum(pixels, edge))
        rays = np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1)
        return rays / np.linalg.norm(rays, axis=-1, keepdims=True)

    low, high = -0.5, TILE - 0.5
    middle = ray(TILE / 2 - 0.5, TILE / 2 - 0.5)
    corners = [ray(low, low), ray(low, high), ray(high, low), ray(high, high)]
    chord = np.max([np.linalg.norm(corner - middle, axis=-1) for corner in corners], axis=0)
    return np.concatenate([middle, 2 * np.arcsin(chord / 2)[..., None]], axis=-1)


@compiled
def touch(cones: Floats, bodies: Floats) -> Image:
    """For each tile the set of bodies, as bits, that any of its rays may meet in any pose.

    Turning a ray by an angle brings it nearer to a body by at most that angle times the way to the
    body's far end.
    """
    rows, columns = cones.shape[:2]
    touched = np.zeros((rows, columns), dtype=np.uint8)
    for k in range(4):
        A, n = bodies[k::4, :3], bodies[k::4, 3:6]
        B = A + n
        r = bodies[k, 6]
        way = r + np.sqrt(max((A[0] ** 2).sum(), (B[0] ** 2).sum()))
        moved = np.sqrt(3.0 * max(((A - A[0]) ** 2).max(), ((B - B[0]) ** 2).max()))
        for i in range(rows):
            for j in range(columns):
                middle = (way * cones[i, j, 0], way * cones[i, j, 1], way * cones[i, j, 2])
                distance, _ = gap((0.0, 0.0, 0.0), middle, bodies, k)
                if r > 0.0 and distance < r + moved + way * cones[i, j, 3]:
                    touched[i, j] |= 1 << k
    return touched


@compiled
def identify(seen: Image, touched: Image, rays: Floats, bodies: Floats) -> None:
    """Which body (1 to 4, 0 for the tissue) every pixel sees first, and another that it sees later,
    if any."""
    last = bodies.shape[0] // 4 - 1
    between = 1 if swift(bodies) else max(last - 1, 1)
    seen[:] = 0
    for i in range(touched.shape[0]):
        for j in range(touched.shape[1]):
            which = touched[i, j]
            if which == 0:
                continue
            for y in range(i * TILE, min((i + 1) * TILE, rays.shape[0])):
                for x in range(j * TILE, min((j + 1) * TILE, rays.shape[1])):
                    ray = (rays[y, x, 0], rays[y, x, 1], 1.0)
                    first = later = nearest(ray, bodies, 1, which)[0]
                    pose = last
                    while later == first and pose > between:
                        later = nearest(ray, bodies, pose, which)[0]
                        pose -= 1
                    seen[0, y, x], seen[1, y, x] = 1 + first, 1 + later


@compiled
def swift(bodies: Floats) -> bool:
    """Whether a body moves so far in the exposure that it may pass a pixel that it covers at
    neither end."""
    for k in range(4):
        first, last = 4 + k, bodies.shape[0] - 4 + k
        at_a = minus(start(bodies, first), start(bodies, last))
        at_n = minus(axis(bodies, first), axis(bodies, last))
        if np.sqrt(dot(at_a, at_a)) + np.sqrt(dot(at_n, at_n)) > bodies[k, 6] > 0.0:
            return True
    return False


@compiled
def uniform(seen: Image, y: int, x: int) -> bool:
    """Whether pixel (y, x) and its neighbours see one body, and the same one throughout the
    exposure."""
    body = seen[0, y, x]
    for v in range(max(y - 1, 0), min(y + 2, seen.shape[1])):
        for u in range(max(x - 1, 0), min(x + 2, seen.shape[2])):
            if seen[0, v, u] != body or seen[1, v, u] != body:
                return False
    return True


# ---------------------------------------------------------------- the bodies' colours


@compiled
def colour(
    canvas: Light,
    seen: Image,
    touched: Image,
    rays: Floats,
    bodies: Floats,
    lamp: Lamp,
    pattern: Floats,
) -> None:
    """Paint the bodies over the tissue: inside an outline by one sample, on it by the pattern's
    mean."""
    for i in range(touched.shape[0]):
        for j in range(touched.shape[1]):
            if touched[i, j] == 0:
                continue
            for y in range(i * TILE, min((i + 1) * TILE, rays.shape[0])):
                for x in range(j * TILE, min((j + 1) * TILE, rays.shape[1])):
                    if not uniform(seen, y, x):
                        outline(canvas[y, x], rays[y, x], bodies, touched[i, j], lamp, pattern)
                    elif seen[0, y, x] > 0:
                        body = seen[0, y, x] - 1
                        ray = (rays[y, x, 0], rays[y, x, 1], 1.0)
                        depth = hit(ray, bodies, body)
                        if depth < np.inf:
                            blue, green, red = shade(times(depth, ray), bodies, body, lamp)
                            canvas[y, x, 0], canvas[y, x, 1], canvas[y, x, 2] = blue, green, red


@compiled
def outline(
    pixel: Light, ray: Floats, bodies: Floats, which: int, lamp: Lamp, pattern: Floats
) -> None:
    """Replace a `pixel` (3,) of tissue by the mean of what its samples see."""
    blue, green, red, tissue = 0.0, 0.0, 0.0, 0
    for n in range(SAMPLES):
        u, v, pose = pattern[n, 0], pattern[n, 1], int(pattern[n, 2])
        sample = (ray[0] + u * ray[2] + v * ray[4], ray[1] + u * ray[3] + v * ray[5], 1.0)
        k, depth = nearest(sample, bodies, pose, which)
        if k < 0:
            tissue += 1
        else:
            light = shade(times(depth, sample), bodies, 4 * pose + k, lamp)
            blue, green, red = blue + light[0], green + light[1], red + light[2]
    pixel[0] = (blue + tissue * pixel[0]) / SAMPLES
    pixel[1] = (green + tissue * pixel[1]) / SAMPLES
    pixel[2] = (red + tissue * pixel[2]) / SAMPLES


@compiled
def shade(place: Vector, bodies: Floats, b: int, lamp: Lamp) -> Vector:
    """The light from a `place` on a body: Lambert's from the lamp and from everywhere, and Blinn's
    highlight."""
    light, _, reach, ambient, exponent = lamp
    n, r, nn = axis(bodies, b), bodies[b, 6], bodies[b, 7]
    along = clip((dot(place, n) - bodies[b, 8]) / nn) if nn > 0.0 else 0.0
    outward = minus(minus(place, start(bodies, b)), times(along, n))  # of length r
    to_lamp = minus(light, place)
    distance = np.sqrt(dot(to_lamp, to_lamp))
    strength = 2.0 / (1.0 + (distance / reach) ** 2)
    facing = max(dot(outward, to_lamp), 0.0) / (r * distance)
    half = minus(times(1.0 / distance, to_lamp), times(1.0 / np.sqrt(dot(place, place)), place))
    mirror = dot(outward, half) / (r * np.sqrt(dot(half, half)))
    glint = 0.0
    if mirror > 0.0 and exponent * (mirror - 1.0) > -7.0:  # beyond, it is below a thousandth
        glint = bodies[b, 14] * strength * mirror**exponent
    bright = ambient + (1.0 - ambient) * facing * strength
    return (
        bodies[b, 11] * bright + glint,
        bodies[b, 12] * bright + glint,
        bodies[b, 13] * bright + glint,
    )


# ---------------------------------------------------------------- the tissue and the shadow on it


def _on_plane(slopes: Floats, optics: Optics, tissue: Tissue) -> Floats:
    """Where rays of `slopes` (..., 2) meet the tissue, mm in camera axes (..., 3); NaN where they
    never do."""
    rays = np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1)
    normal = optics.rotation @ tissue.normal
    height = normal @ (optics.rotation @ (tissue.point - optics.position))
    with np.errstate(divide="ignore"):
        depth = height / (rays @ normal)
    return rays * np.where((depth > 0) & (depth < np.inf), depth, np.nan)[..., None]


def _lit_tissue(
    slopes: Floats, optics: Optics, look: Look, tissue: Tissue, noise: np.random.Generator
) -> tuple[Light, Light]:
    """The tissue without the tool (H, W, 3), and the share of it (H, W) that the lamp gives and a
    shadow takes."""
    place = _on_plane(slopes, optics, tissue)
    normal = optics.rotation @ tissue.normal / np.linalg.norm(tissue.normal)
    normal *= np.sign(normal @ (optics.rotation @ (optics.position - tissue.point)))
    mottle, veins, bumpy = _texture(place, normal, look, noise)
    to_lamp, distance = _unit(np.array(look.light) - place)
    to_eye, away = _unit(-place)
    half, _ = _unit(to_lamp + to_eye)
    strength = 2 / (1 + (distance / look.reach) ** 2)
    lamp = (1 - look.ambient) * np.maximum((bumpy * to_lamp).sum(axis=-1), 0) * strength
    wet = (
        WETNESS
        * look.specular
        * np.maximum((bumpy * half).sum(axis=-1), 0) ** look.exponent
        * strength
    )
    pale = 1 + look.contrast * mottle
    red = np.stack([pale - look.contrast * veins] * 2 + [pale], axis=-1)
    lit = (
        np.array(look.tissue_colour) * np.maximum(red, 0) * (look.ambient + lamp)[..., None]
        + 255 * wet[..., None]
    )
    visible = np.clip(2 - away / (HORIZON * look.reach), 0, 1)[..., None]
    share = (lamp + wet) / (look.ambient + lamp + wet + TINY)
    return np.nan_to_num(visible * lit).astype(np.float32), np.nan_to_num(share).astype(np.float32)


def _texture(
    place: Floats, normal: Floats, look: Look, noise: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Mottle (H, W) and veins (H, W) of the tissue, and its bumpy unit normal (H, W, 3), at each
    `place`.

    All fade where a pixel spans as much as a bump: finer detail than pixels would only make false
    patterns.
    """
    across = np.linalg.svd(normal[None])[2][1:]
    texels = np.moveaxis(TEXELS / look.texture * (place @ across.T), -1, 0)
    span = np.max(
        [np.linalg.norm(change, axis=-1) for change in np.gradient(place, axis=(0, 1))], axis=0
    )
    fade = 1 / (1 + (span / (BUMP * look.texture / 4)) ** 2)

    def sample(field: Floats) -> Floats:
        return fade * np.asarray(
            ndimage.map_coordinates(field, texels, order=1, mode="grid-wrap"), dtype=np.float64
        )

    mottle, bumps, vessels = (_field(noise, size) for size in (2 * BUMP, BUMP, 4 * BUMP))
    pitch = look.texture / TEXELS
    tilts = [
        sample(look.relief * np.gradient(bumps, pitch, axis=i))[..., None] * across[i]
        for i in range(2)
    ]
    return (
        sample(mottle),
        sample(2 * np.exp(-np.abs(vessels) / 0.08)),
        _unit(normal - tilts[0] - tilts[1])[0],
    )


def _unit(vectors: Floats) -> tuple[Floats, Floats]:
    """Vectors (..., 3) as directions, and their lengths (...)."""
    length = np.linalg.norm(vectors, axis=-1)
    return vectors / length[..., None], length


def _field(noise: np.random.Generator, size: float) -> Floats:
    """A smooth random field (TEXELS, TEXELS) that repeats: mean 0, spread 1, features of `size` of
    its width."""
    f = np.fft.fftfreq(TEXELS, 1 / TEXELS)
    spectrum = (1 + (f[:, None] ** 2 + f**2) * size**2) ** -2.5
    field = np.fft.ifft2(np.fft.fft2(noise.standard_normal((TEXELS, TEXELS))) * spectrum).real
    return (field - field.mean()) / field.std()


def _nodes(optics: Optics, tissue: Tissue) -> Floats:
    """The tissue at every STEP-th pixel over all tiles, their far edges included, mm in camera
    axes."""
    u, v = (
        np.arange(0, -(-size // TILE) * TILE + 1, STEP) for size in (optics.width, optics.height)
    )
    return _on_plane(
        optics.slopes(np.stack(np.meshgrid(u, v), axis=-1).astype(np.float64)), optics, tissue
    )


@compiled
def cast_shadow(
    canvas: Light, lamp_share: Light, nodes: Floats, bodies: Floats, lamp: Lamp
) -> None:
    """Take from the tissue the lamp's light that the bodies hide: exact at the nodes, linear
    between."""
    cells = TILE // STEP
    blocked = np.empty((cells + 1, cells + 1))
    for i in range((nodes.shape[0] - 1) // cells):
        for j in range((nodes.shape[1] - 1) // cells):
            patch = nodes[i * cells : (i + 1) * cells + 1, j * cells : (j + 1) * cells + 1]
            which = casters(patch, bodies, lamp)
            if which == 0:
                continue
            for v in range(cells + 1):
                for u in range(cells + 1):
                    blocked[v, u] = eclipse(
                        (patch[v, u, 0], patch[v, u, 1], patch[v, u, 2]), bodies, which, lamp
                    )
            top, left = i * TILE, j * TILE
            darken(canvas[top : top + TILE, left : left + TILE], lamp_share[top:, left:], blocked)


@compiled
def casters(patch: Floats, bodies: Floats, lamp: Lamp) -> int:
    """The set of bodies, as bits, that may hide part of the lamp from part of a `patch` (n, n, 3)
    of tissue."""
    centre, end = patch.shape[0] // 2, patch.shape[0] - 1
    middle = (patch[centre, centre, 0], patch[centre, centre, 1], patch[centre, centre, 2])
    size = 0.0
    for v in (0, end):
        for u in (0, end):
            across = minus((patch[v, u, 0], patch[v, u, 1], patch[v, u, 2]), middle)
            size = max(size, np.sqrt(dot(across, across)))
    which = 0
    for k in range(4):
        distance, _ = gap(middle, minus(lamp[0], middle), bodies, k)
        if bodies[k, 6] > 0.0 and distance < bodies[k, 6] + size + lamp[1]:
            which |= 1 << k
    return which


@compiled
def eclipse(place: Vector, bodies: Floats, which: int, lamp: Lamp) -> float:
    """How much of the round lamp the bodies hide from a place on the tissue, 0 to 1.

    At the occluder the cone from there to the lamp has a radius h: half the width of the shadow's
    soft edge.
    """
    most = 0.0
    for k in range(4):
        if which >> k & 1:
            distance, on = gap(place, minus(lamp[0], place), bodies, k)
            h, r = lamp[1] * max(on, 1e-6), bodies[k, 6]
            inside = clip((r + h - distance) / (2.0 * h))
            most = max(most, inside * inside * (3.0 - 2.0 * inside) * min(r / h, 1.0))
    return most


@compiled
def darken(tile: Light, lamp_share: Light, blocked: Floats) -> None:
    """Dim one tile by the lamp's light that its nodes miss."""
    for y in range(tile.shape[0]):
        v, dv = y // STEP, y % STEP / STEP
        for x in range(tile.shape[1]):
            u, du = x // STEP, x % STEP / STEP
            above = blocked[v, u] + du * (blocked[v, u + 1] - blocked[v, u])
            below = blocked[v + 1, u] + du * (blocked[v + 1, u + 1] - blocked[v + 1, u])
            keep = 1.0 - lamp_share[y, x] * (above + dv * (below - above))
            for c in range(3):
                tile[y, x, c] *= keep


# ---------------------------------------------------------------- the sensor


@compiled
def expose(
    rows: Light, normals: Light, starts: NDArray[np.int64], shot: np.float32, read: np.float32
) -> Image:
    """Light as 8-bit grey levels with noise of variance `shot` times the light plus `read`,
    clipped.

    The noise of row y is the table of standard `normals` from `starts`[y] on.
    """
    picture = np.empty(rows.shape, dtype=np.uint8)
    half, black, white = np.float32(0.5), np.float32(0.0), np.float32(255.0)
    for y in range(rows.shape[0]):
        row, noise, grey = rows[y], normals[starts[y] : starts[y] + rows.shape[1]], picture[y]
        for x in range(rows.shape[1]):
            value = row[x] + noise[x] * np.sqrt(shot * row[x] + read) + half
            grey[x] = np.uint8(min(max(value, black), white))
    return picture
