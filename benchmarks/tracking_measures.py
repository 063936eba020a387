"""Measurements of the tracker on images of the default rig, for benchmarks and tests.

They cover a short path, noise, a third ball in the image, and fast motion.
"""

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from rcmservo.interfaces import Floats, Frame, Image, Markers
from rcmservo.sim import Rig, RigSettings
from rcmservo.sim.rendering import Appearance, Light, Renderer
from rcmservo.tracking import ColourMarkers

NOISELESS = Appearance(full_well=1e12, read_noise=0.0)
PERIOD, EXPOSURE, MOMENTS = 1 / 60, 0.004, 8  # s, s, and poses in an exposure
GAINING = 6  # frames in which a tool accelerates


def renderer_of(rig: Rig) -> Renderer:
    return Renderer(rig.scene.optics, rig.settings.appearance, rig.scene.tissue, rig.seed)


def truth(rig: Rig, points: Floats) -> Floats:
    """Return centres and radii (2, 3) in px of the unoccluded silhouettes."""
    optics, radii = rig.scene.optics, rig.settings.appearance.marker_radii
    return np.array(
        [
            [*optics.silhouette_centre(p, r), optics.silhouette_radius(p, r)]
            for p, r in zip(points[:2], radii, strict=True)
        ]
    )


def measured(seen: Markers) -> Floats:
    """Return u, v and radius of both markers (2, 3) in px."""
    return np.column_stack([seen.points, seen.radius])


def errors_on_path(seed: int, length: float = 5.0, step: float = 0.1) -> Floats:
    """Return errors (n, 2, 3) in px of u, v and radius along a noiseless path to the target."""
    rig = Rig(seed, RigSettings(appearance=NOISELESS))
    renderer, tracker = renderer_of(rig), ColourMarkers()
    end, path = rig.scene.target, rig.scene.start - rig.scene.target
    mm = np.linalg.norm(rig.body.points(end + path)[0] - rig.body.points(end)[0])
    errors = []
    for number, along in enumerate(np.arange(0.0, length + 1e-9, step) / mm):
        points = rig.body.points(end + along * path)
        seen = tracker.find(Frame(number, 0, 0, renderer.render(points[None], number)))
        errors.append(measured(seen) - truth(rig, points))
    return np.array(errors)


def about_trend(errors: Floats) -> Floats:
    """Return the residuals of errors (n, ...) about a quadratic trend along the path."""
    along = np.linspace(-1.0, 1.0, len(errors))
    flat = errors.reshape(len(errors), -1)
    basis = np.vander(along, 3)
    return (flat - basis @ np.linalg.lstsq(basis, flat, rcond=None)[0]).reshape(errors.shape)


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def surprise(seed: int, frames: int) -> Floats:
    """Return the squared scatter of u, v, radius relative to the reported covariance (2,).

    The ratio is 1 for each marker if the covariance is consistent.
    """
    rig, tracker = Rig(seed), ColourMarkers()
    renderer, points = renderer_of(rig), rig.body.points(rig.scene.target)[None]
    seen = [tracker.find(Frame(i, 0, 0, renderer.render(points, i))) for i in range(frames)]
    values = np.array([measured(one) for one in seen])
    information = np.linalg.inv(np.array([one.covariance for one in seen]))
    error = values - values.mean(axis=0)
    squares = np.einsum("tki,tkij,tkj->k", error, information, error)
    return squares / (3 * (frames - 1))


def third_ball(seed: int) -> Frame:
    """Return a frame of the target with a third ball, similar to one marker, apart from both."""
    rig, random = Rig(seed), np.random.default_rng(seed)
    points = rig.body.points(rig.scene.target)
    known, k = truth(rig, points), int(random.integers(2))
    radius = known[k, 2] * random.uniform(0.85, 1.15)
    size = np.array([rig.settings.width, rig.settings.height])
    while True:
        place = random.uniform(radius + 5.0, size - radius - 5.0)
        if np.linalg.norm(known[:, :2] - place, axis=1).min() > 4.0 * known[:, 2].max():
            break
    between = painted_ball(place, radius, np.array(rig.settings.appearance.marker_colours[k]))
    return Frame(0, 0, 0, renderer_of(rig).render(points[None], 0, between))


def painted_ball(place: Floats, radius: float, colour: Floats) -> Callable[[Light], None]:
    """Return a function that paints a ball with light from the camera."""

    def paint(light: Light) -> None:
        rows, columns = np.mgrid[: light.shape[0], : light.shape[1]]
        distance = np.hypot(columns - place[0], rows - place[1])
        cover = np.clip(radius + 0.5 - distance, 0.0, 1.0)[..., None]
        facing = np.sqrt(np.clip(1.0 - (distance / radius) ** 2, 0.0, 1.0))[..., None]
        light += (cover * ((0.35 + 0.65 * facing) * colour - light)).astype(np.float32)

    return paint


def swift(seed: int, px: float, frames: int) -> tuple[list[Image], Floats]:
    """Return images of an oscillating tool, and its markers (frames, 2, 3) in px.

    The tool moves across the image by `px` per frame; the exposure blurs it.
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
    """Return a direction (3,) across the view, and the mm along it that move the image by `px`."""
    optics, points = rig.scene.optics, rig.body.points(rig.scene.target)[:1]
    aside = optics.rotation.T @ np.array([np.cos(rig.seed), np.sin(rig.seed), 0.0])
    return aside, float(
        px / np.linalg.norm(optics.project(points + aside) - optics.project(points))
    )


def from_rest(
    seed: int, px: float, frames: int, exposure: float
) -> Iterator[tuple[Markers, Floats]]:
    """Yield tracked and true markers (2, 3) in px of a tool that accelerates from rest.

    It moves by `px` per frame after `GAINING` frames, and each exposure lasts `exposure` s. Only
    later frames with both markers completely in the image count.
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
    """Return the numbers of markers that are lost or have errors above `wrong` px, and of all."""
    errors = [np.linalg.norm(seen.points - balls[:, :2], axis=1) for seen, balls in found]
    return int((~(np.array(errors) < wrong)).sum()), 2 * len(errors)


def gained(time: float) -> float:
    """Return the position at a time of a motion with constant acceleration to speed 1.

    The acceleration takes `GAINING` frames.
    """
    ramp = min(max(time, 0.0), GAINING)
    return 0.5 * ramp**2 / GAINING + max(time - GAINING, 0.0) - GAINING


def turned(time: float, half: float = 5.0) -> float:
    """Return the position at `time` of a triangular oscillation with speed 1, period 4 `half`."""
    return half - abs((time + half) % (4.0 * half) - 2.0 * half)


def lost_or_wrong(seed: int, px: float, frames: int = 40) -> tuple[int, int]:
    """Return the number of lost or mistracked markers in fast motion, and the number of all.

    A marker is mistracked if its error is above 3 px. The first three frames and markers at the
    border do not count.
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
            error = np.linalg.norm(seen - balls[:, :2], axis=1)
            bad, due = bad + int((~(error < 3.0)).sum()), due + 2
    return bad, due
