"""What the tracker is measured by, on pictures of the default rig: along a short path, over noise,
with a third ball in view, and in swift motion. benchmarks/tracking.py prints it; tests ask a part.
"""

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from rcmservo.interfaces import Floats, Frame, Image, Markers
from rcmservo.sim.rendering import Light, Look, Renderer
from rcmservo.sim.rig import Rig, RigSettings
from rcmservo.tracking import ColourMarkers

NOISELESS = Look(full_well=1e12, read_noise=0.0)
PERIOD, EXPOSURE, MOMENTS = 1 / 60, 0.004, 8  # s, s, and poses in an exposure
GAINING = 6  # frames in which a tool gains its speed


def renderer_of(rig: Rig) -> Renderer:
    return Renderer(rig.scene.optics, rig.settings.look, rig.scene.tissue, rig.seed)


def truth(rig: Rig, points: Floats) -> Floats:
    """Where whole silhouettes have their centres, and their radii: (2, 3) px."""
    optics, radii = rig.scene.optics, rig.settings.look.marker_radii
    return np.array(
        [
            [*optics.silhouette_centre(p, r), optics.silhouette_radius(p, r)]
            for p, r in zip(points[:2], radii, strict=True)
        ]
    )


def measured(seen: Markers) -> Floats:
    """u, v and radius of both markers, (2, 3) px."""
    return np.column_stack([seen.points, seen.radius])


def errors_on_path(seed: int, length: float = 5.0, step: float = 0.1) -> Floats:
    """What the tracker errs in u, v and radius at each place of a path that ends at the target, in
    pictures without noise: (n, 2, 3) px.
    """
    rig = Rig(seed, RigSettings(look=NOISELESS))
    renderer, tracker = renderer_of(rig), ColourMarkers()
    end, way = rig.scene.target, rig.scene.start - rig.scene.target
    mm = np.linalg.norm(rig.body.points(end + way)[0] - rig.body.points(end)[0])
    errors = []
    for number, along in enumerate(np.arange(0.0, length + 1e-9, step) / mm):
        points = rig.body.points(end + along * way)
        seen = tracker.find(Frame(number, 0, 0, renderer.render(points[None], number)))
        errors.append(measured(seen) - truth(rig, points))
    return np.array(errors)


def about_trend(errors: Floats) -> Floats:
    """What a quadratic along the path leaves of errors (n, ...)."""
    along = np.linspace(-1.0, 1.0, len(errors))
    flat = errors.reshape(len(errors), -1)
    basis = np.vander(along, 3)
    return (flat - basis @ np.linalg.lstsq(basis, flat, rcond=None)[0]).reshape(errors.shape)


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def surprise(seed: int, frames: int) -> Floats:
    """The squared scatter of u, v, radius over noise by the covariance that was told, for each
    marker (2,): 1 where it is told rightly.
    """
    rig, tracker = Rig(seed), ColourMarkers()
    renderer, points = renderer_of(rig), rig.body.points(rig.scene.target)[None]
    seen = [tracker.find(Frame(i, 0, 0, renderer.render(points, i))) for i in range(frames)]
    values = np.array([measured(one) for one in seen])
    told = np.linalg.inv(np.array([one.covariance for one in seen]))
    away = values - values.mean(axis=0)
    squares = np.einsum("tki,tkij,tkj->k", away, told, away)
    return squares / (3 * (frames - 1))


def third_ball(seed: int) -> Frame:
    """The target, with a third ball of one marker's colour and about its size, away from both."""
    rig, random = Rig(seed), np.random.default_rng(seed)
    points = rig.body.points(rig.scene.target)
    known, k = truth(rig, points), int(random.integers(2))
    radius = known[k, 2] * random.uniform(0.85, 1.15)
    size = np.array([rig.settings.width, rig.settings.height])
    while True:
        place = random.uniform(radius + 5.0, size - radius - 5.0)
        if np.linalg.norm(known[:, :2] - place, axis=1).min() > 4.0 * known[:, 2].max():
            break
    between = painted_ball(place, radius, np.array(rig.settings.look.marker_colours[k]))
    return Frame(0, 0, 0, renderer_of(rig).render(points[None], 0, between))


def painted_ball(place: Floats, radius: float, colour: Floats) -> Callable[[Light], None]:
    """Paints a ball lit from the camera."""

    def paint(light: Light) -> None:
        rows, columns = np.mgrid[: light.shape[0], : light.shape[1]]
        away = np.hypot(columns - place[0], rows - place[1])
        cover = np.clip(radius + 0.5 - away, 0.0, 1.0)[..., None]
        facing = np.sqrt(np.clip(1.0 - (away / radius) ** 2, 0.0, 1.0))[..., None]
        light += (cover * ((0.35 + 0.65 * facing) * colour - light)).astype(np.float32)

    return paint


def swift(seed: int, px: float, frames: int) -> tuple[list[Image], Floats]:
    """Pictures of a tool that moves across the picture by `px` in each frame, to and fro, blurred
    over the exposure, and where its markers are (frames, 2, 3).
    """
    rig = Rig(seed)
    renderer, points = renderer_of(rig), rig.body.points(rig.scene.target)
    aside, scale = across(rig, px)
    images, true = [], []
    for number in range(frames):
        times = number + EXPOSURE / PERIOD * ((np.arange(MOMENTS) + 0.5) / MOMENTS - 0.5)
        shifts = [points + scale * turned(t) * aside for t in times]
        images.append(renderer.render(np.array(shifts), number))
        true.append(truth(rig, points + scale * turned(number) * aside))
    return images, np.array(true)


def across(rig: Rig, px: float) -> tuple[Floats, float]:
    """A direction (3,) across the view, and the mm along it that move the tool by `px`."""
    optics, points = rig.scene.optics, rig.body.points(rig.scene.target)[:1]
    aside = optics.rotation.T @ np.array([np.cos(rig.seed), np.sin(rig.seed), 0.0])
    return aside, float(
        px / np.linalg.norm(optics.project(points + aside) - optics.project(points))
    )


def from_rest(
    seed: int, px: float, frames: int, exposure: float
) -> Iterator[tuple[Markers, Floats]]:
    """Of a tool that starts from rest, is as fast as `px` in each frame after GAINING frames and
    goes on so, in exposures of so many seconds: what is found, and where the markers are (2, 3) px,
    in the frames from then on that show both whole.
    """
    rig, tracker = Rig(seed), ColourMarkers()
    renderer, points = renderer_of(rig), rig.body.points(rig.scene.target)
    aside, scale = across(rig, px)
    height, width = rig.settings.height, rig.settings.width
    for number in range(frames):
        times = number + exposure / PERIOD * ((np.arange(MOMENTS) + 0.5) / MOMENTS - 0.5)
        poses = np.array([points + scale * gained(t) * aside for t in times])
        time = round(number * PERIOD * 1e9)
        seen = tracker.find(Frame(number, time, time, renderer.render(poses, number)))
        balls = truth(rig, poses.mean(axis=0))
        margin = (balls[:, 2] + px)[:, None]
        inside = (balls[:, :2] > margin) & (balls[:, :2] < np.array([width, height]) - 1 - margin)
        if number >= GAINING and inside.all():
            yield seen, balls


def bad_of(found: Iterable[tuple[Markers, Floats]], wrong: float = 3.0) -> tuple[int, int]:
    """How many markers are lost or more than `wrong` px off, of how many."""
    away = [np.linalg.norm(seen.points - balls[:, :2], axis=1) for seen, balls in found]
    return int((~(np.array(away) < wrong)).sum()), 2 * len(away)


def gained(time: float) -> float:
    """How far something is that comes to a speed of 1 in GAINING frames, evenly; 0 half way."""
    ramp = min(max(time, 0.0), GAINING)
    return 0.5 * ramp**2 / GAINING + max(time - GAINING, 0.0) - GAINING


def turned(time: float, half: float = 5.0) -> float:
    """How far something is that goes to and fro at a speed of 1, turning every 2 `half`."""
    return half - abs((time + half) % (4.0 * half) - 2.0 * half)


def lost_or_wrong(seed: int, px: float, frames: int = 40) -> tuple[int, int]:
    """Of the markers that are whole in swift pictures, how many are lost or more than 3 px off,
    after the first three frames; and how many there are.
    """
    images, true = swift(seed, px, frames)
    tracker, bad, due = ColourMarkers(), 0, 0
    height, width = images[0].shape[:2]
    for number, (image, balls) in enumerate(zip(images, true, strict=True)):
        time = round(number * PERIOD * 1e9)
        seen = tracker.find(Frame(number, time, time, image)).points
        margin = balls[:, 2] + px
        inside = (balls[:, :2] > margin[:, None]).all() and (
            balls[:, :2] < np.array([width, height]) - 1 - margin[:, None]
        ).all()
        if inside and number >= 3:
            away = np.linalg.norm(seen - balls[:, :2], axis=1)
            bad, due = bad + int((~(away < 3.0)).sum()), due + 2
    return bad, due
