"""How well the tracker finds the two balls in rendered pictures: the centres' error and the time.

Every scene has a camera, a tool and a pose of its own; the truth is the centroid of the unhidden
silhouette.

    python benchmarks/tracking.py [scenes]

Then, at the default rig (tracking_measures.py): how the error varies along a path of 5 mm, whether
the covariance that is told explains the scatter, whether a third ball is told, and how a tool is
followed that moves by 15 px a frame.
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
from rcmservo.sim.rendering import Look, Renderer, Tissue
from rcmservo.tracking import ColourMarkers, MarkerAppearance

SIZE = 640, 480
SPACING = 30.0  # mm
COLOURS = ((60.0, 185.0, 30.0), (205.0, 80.0, 25.0))  # green and blue, in blue-green-red


@dataclass(frozen=True, eq=False)
class Scene:
    """One picture, and where a perfect tracker would see the markers (2, 2) px, NaN where not
    wholly in it.
    """

    image: Image
    truth: Floats
    radius: Floats


def scenes(count: int, seed: int, shaft_radius: float) -> Iterator[Scene]:
    """Random scenes; a `shaft_radius` of 0 mm leaves the balls whole, unless one hides the
    other.
    """
    random = np.random.default_rng(seed)
    for number in range(count):
        yield _scene(random, number, shaft_radius)


def _scene(random: np.random.Generator, number: int, shaft_radius: float) -> Scene:
    """A camera looking down at a tool inclined to it by up to 60 degrees, towards it or away from
    it.
    """
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
    look = Look(
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
    """The tool's four points, and of them the two balls', (4, 3) and (2, 3) mm, near the centre of
    the view.
    """
    slope, turn = random.uniform(-np.pi / 3, np.pi / 3), random.uniform(0, 2 * np.pi)
    along = np.array([np.cos(slope) * np.cos(turn), np.cos(slope) * np.sin(turn), np.sin(slope)])
    view = distance / focal * np.array(SIZE) / 2
    middle = np.array([*random.uniform(-0.7 * view, 0.7 * view), random.uniform(-10, 10)])
    m1, m2 = middle - along * SPACING / 2, middle + along * SPACING / 2
    return np.array([m1, m2, m1 - 80 * along, m2 + 15 * along]), np.array([m1, m2])


def errors(count: int, seed: int, shaft_radius: float) -> tuple[Floats, Floats, float]:
    """Distances to the truth [px] and qualities, of every marker that should be seen; ms a frame
    once followed.
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
    print(
        f"{count} scenes    markers   lost   rms px   median    99 %   worst   ms a frame (median)"
    )
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
    """The rows at the default rig, on `count` scenes each."""
    paths = np.array([errors_on_path(seed) for seed in range(count)])
    left = np.array([about_trend(one) for one in paths])
    kept = np.isfinite(paths).all(axis=(1, 2, 3))
    off = rms(np.linalg.norm(paths[kept][..., :2], axis=-1))
    print(f"along 5 mm, {kept.sum()} of {count} unbroken: {off:.3f} px rms,", end=" ")
    print(f"{rms(left[kept][..., :2]):.4f} about the trend; radius {rms(paths[kept][..., 2]):.3f}")
    told = np.array([surprise(seed, 25) for seed in range(count)])
    print(
        f"squared scatter by covariance: mean {told.mean():.2f}, {told.min():.2f}-{told.max():.2f}"
    )
    frames = [third_ball(seed) for seed in range(5 * count)]
    silent = [np.isnan(ColourMarkers().find(one).points).any() for one in frames]
    words = ["can be the markers" in ColourMarkers().why(one) for one in frames]
    print(f"a third ball: not chosen in {sum(silent)}, told in {sum(words)} of {len(frames)}")
    for px in (5.0, 15.0):
        bad, due = np.sum([lost_or_wrong(seed, px) for seed in range(count)], axis=0)
        print(f"{px:g} px a frame: {bad} of {due} lost or wrong ({bad / due:.1%})")
    for exposure in (0.008, 0.015, PERIOD):
        runs = (from_rest(seed, 15.0, 12, exposure) for seed in range(count))
        found = list(chain.from_iterable(runs))
        (bad, due), (far, _) = bad_of(found), bad_of(found, 8.0)
        print(
            f"the same from rest, smeared by {15.0 * exposure / PERIOD:.1f} px: {bad} of {due}",
            end=" ",
        )
        print(f"lost or more than 3 px off, {far} more than 8")


if __name__ == "__main__":
    main()
