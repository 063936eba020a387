"""Accuracy and time of the tracker for the two balls in rendered images.

Each scene has a random camera, tool and pose; the reference is the centroid of the unoccluded
silhouette.

    python benchmarks/tracking.py [scenes]

With the default rig (tracking_measures.py) follow: the variation of the error along a path of 5 mm,
the consistency of the reported covariance with the scatter, the detection of a third ball, and the
tracking of a tool that moves by 15 px per frame.
"""

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np
from tracking_measures import (
    PERIOD,
    about_trend,
    bad_of,
    errors_on_path,
    from_rest,
    lost_or_wrong,
    rms,
    surprise,
    third_ball,
)

from rcmservo.interfaces import Floats, Frame, Image
from rcmservo.sim.camera_model import CameraModel, compute_look_at_rotation
from rcmservo.sim.rendering import Appearance, Renderer, Tissue
from rcmservo.tracking import ColourMarkers, MarkerAppearance

SIZE = 640, 480
SPACING = 30.0  # mm
COLOURS = ((60.0, 185.0, 30.0), (205.0, 80.0, 25.0))  # green and blue, in blue-green-red


@dataclass(frozen=True, eq=False)
class Scene:
    """One image with the reference centres (2, 2) in px, NaN for a ball not completely in it."""

    image: Image
    truth: Floats
    radius: Floats


def scenes(count: int, seed: int, shaft_radius: float) -> Iterator[Scene]:
    """Yield random scenes; a `shaft_radius` of 0 mm does not occlude the balls."""
    random = np.random.default_rng(seed)
    for number in range(count):
        yield _scene(random, number, shaft_radius)


def _scene(random: np.random.Generator, number: int, shaft_radius: float) -> Scene:
    """Return a scene with a camera above a tool that is inclined by up to 60° in any direction."""
    distance, focal = random.uniform(120, 300), random.uniform(500, 900)
    optics = CameraModel(
        *SIZE,
        focal=focal,
        centre=np.array(SIZE) / 2 + random.uniform(-20, 20, 2),
        distortion=np.zeros(2),
        rotation=compute_look_at_rotation(
            np.array([0.0, 0.0, distance]), np.zeros(3), random.uniform(0, 2 * np.pi)
        ),
        position=np.array([0.0, 0.0, distance]),
    )
    radii = tuple(random.uniform(3, 4, 2))
    poses, points = _tool(random, distance, focal)
    look = Appearance(
        marker_radii=radii, shaft_radius=shaft_radius, jaw_radius=0.0, marker_colours=COLOURS
    )
    tissue = Tissue(np.array([0.0, 0.0, -random.uniform(40, 60)]), np.array([0.0, 0.0, 1.0]))
    image = Renderer(optics, look, tissue, seed=number).render(poses[None], number)
    truth = np.array([optics.silhouette_centre(p, r) for p, r in zip(points, radii, strict=True)])
    radius = np.array([optics.silhouette_radius(p, r) for p, r in zip(points, radii, strict=True)])
    whole = (truth > radius[:, None] + 2).all(1) & (
        truth < np.array(SIZE) - radius[:, None] - 3
    ).all(1)
    truth[~whole] = np.nan
    return Scene(image, truth, radius)


def _tool(random: np.random.Generator, distance: float, focal: float) -> tuple[Floats, Floats]:
    """Return the four points (4, 3) of the tool and the two balls (2, 3) in mm, near the centre."""
    slope, turn = random.uniform(-np.pi / 3, np.pi / 3), random.uniform(0, 2 * np.pi)
    along = np.array([np.cos(slope) * np.cos(turn), np.cos(slope) * np.sin(turn), np.sin(slope)])
    view = distance / focal * np.array(SIZE) / 2
    middle = np.array([*random.uniform(-0.7 * view, 0.7 * view), random.uniform(-10, 10)])
    m1, m2 = middle - along * SPACING / 2, middle + along * SPACING / 2
    return np.array([m1, m2, m1 - 80 * along, m2 + 15 * along]), np.array([m1, m2])


def errors(count: int, seed: int, shaft_radius: float) -> tuple[Floats, Floats, float]:
    """Return errors (px) and qualities of all visible markers, and the time (ms) per frame.

    The time is that of a frame in which the tracker follows known markers.
    """
    look = MarkerAppearance("green", "blue", 3.5, 3.5)
    missed, quality, spent = [], [], []
    for scene in scenes(count, seed, shaft_radius):
        tracker = ColourMarkers(look)
        frame = Frame(0, 0, 0, scene.image)
        tracker.find(frame)
        start = time.perf_counter()
        seen = tracker.find(frame)
        spent.append(1e3 * (time.perf_counter() - start))
        due = np.isfinite(scene.truth).all(1)
        missed.extend(np.linalg.norm(seen.points - scene.truth, axis=1)[due])
        quality.extend(seen.quality[due])
    return np.array(missed), np.array(quality), float(np.median(spent))


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    print(f"{count} scenes    markers   lost   rms px   median    99 %   worst   ms/frame (median)")
    for name, shaft_radius in (("whole balls", 0.0), ("on a shaft", 2.0)):
        missed, _, spent = errors(count, 1, shaft_radius)
        seen = missed[np.isfinite(missed)]
        rms, middle, high = np.sqrt(np.mean(seen**2)), np.median(seen), np.quantile(seen, 0.99)
        lost = len(missed) - len(seen)
        print(
            f"{name:14}{len(missed):8}{lost:7}{rms:9.3f}{middle:9.3f}{high:8.3f}{seen.max():8.2f}{spent:10.3f}"
        )
    default_rig(max(count // 10, 2))


def default_rig(count: int) -> None:
    """Print the rows of the default rig, with `count` scenes each."""
    paths = np.array([errors_on_path(seed) for seed in range(count)])
    left = np.array([about_trend(one) for one in paths])
    whole = np.isfinite(paths).all(axis=(1, 2, 3))
    error = rms(np.linalg.norm(paths[whole][..., :2], axis=-1))
    print(f"along 5 mm, {whole.sum()} of {count} complete: {error:.3f} px rms,", end=" ")
    radius = rms(paths[whole][..., 2])
    print(f"{rms(left[whole][..., :2]):.4f} about the trend; radius {radius:.3f}")
    ratio = np.array([surprise(seed, 25) for seed in range(count)])
    limits = f"{ratio.min():.2f}-{ratio.max():.2f}"
    print(f"squared scatter relative to the covariance: mean {ratio.mean():.2f}, {limits}")
    frames = [third_ball(seed) for seed in range(5 * count)]
    silent = [np.isnan(ColourMarkers().find(one).points).any() for one in frames]
    words = ["can be the markers" in ColourMarkers().explain_failure(one) for one in frames]
    print(f"a third ball: rejected in {sum(silent)}, reported in {sum(words)} of {len(frames)}")
    for px in (5.0, 15.0):
        bad, due = np.sum([lost_or_wrong(seed, px) for seed in range(count)], axis=0)
        print(f"{px:g} px per frame: {bad} of {due} lost or mistracked ({bad / due:.1%})")
    for exposure in (0.008, 0.015, PERIOD):
        runs = (from_rest(seed, 15.0, 12, exposure) for seed in range(count))
        found = list(chain.from_iterable(runs))
        (bad, due), (far, _) = bad_of(found), bad_of(found, 8.0)
        print(
            f"from rest, motion-blurred by {15.0 * exposure / PERIOD:.1f} px: {bad} of {due}",
            end=" ",
        )
        print(f"lost or with errors above 3 px, {far} above 8 px")


if __name__ == "__main__":
    main()
