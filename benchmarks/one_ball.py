"""Accuracy of the tool position from the pixel and the radius of one ball, in images of a real arm.

    python benchmarks/one_ball.py RECORDING RIG

For example RIG is examples/davinci.toml. In each of 100 random splits, the affine estimator is
fitted to 20 images in which it observes one ball only, and predicts the position of the ball in the
others. The error is the root mean square distance to the position from the joints; the output is
its median over the splits and the interval of 95 % of them.

The radii are those of the tracker, or those of the outline at which its pixel fit starts, because
that fit does not find the same edge in all images.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rcmservo.config.rig_file import RigDescription, load_rig_file
from rcmservo.estimation.affine import AffineEstimator
from rcmservo.estimation.base import Sample
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats, Frame, Markers
from rcmservo.recording.foreign.frame_folder import iterate_frames, load_recording
from rcmservo.tracking import ColourMarkers
from rcmservo.tracking.circle_fit import find_colour_centroid, fit_outline
from rcmservo.tracking.colours import COLOURS, compute_colour_response

SPLITS, FITTED = 100, 20
AFFINE = AffineEstimator()


@dataclass(frozen=True, eq=False)
class Still:
    """One image: position of marker 1, pixels of both balls, and their radii from two methods."""

    p1: Floats
    points: Floats
    tracked: Floats
    outlined: Floats


def stills(folder: Path, lab: RigDescription) -> list[Still]:
    """Return the images of a recording with both balls."""
    poses, tracker = load_recording(folder, lab.mechanism, lab.tool), ColourMarkers(lab.markers)
    found = [(frame, tracker.find(frame)) for frame in iterate_frames(poses)]
    return [
        Still(pose.p1, markers.points, markers.radius, outlines(frame, markers, lab))
        for pose, (frame, markers) in zip(poses, found, strict=True)
        if np.isfinite(markers.points).all()
    ]


def outlines(frame: Frame, markers: Markers, lab: RigDescription) -> Floats:
    """Return the radii (2,) in px of the outlines of both balls."""
    image, sizes = np.array(frame.image), np.empty(2)
    for k, colour in enumerate((lab.markers.colour_1, lab.markers.colour_2)):
        (u, v), radius = markers.points[k], markers.radius[k]
        amounts = compute_colour_response(image, COLOURS.index(colour))
        start = find_colour_centroid(amounts, u, v, 1.2 * radius)
        sizes[k] = fit_outline(amounts, start, radius, 1.45 * radius)[0][2]
    return sizes


def errors(seen: list[Still], sizes: list[Floats], k: int, tool: Tool) -> Floats:
    """Return the rms error (mm) of each split, from ball `k` (0 or 1) alone."""
    out = np.empty(SPLITS)
    for seed in range(SPLITS):
        order = np.random.default_rng(seed).permutation(len(seen))
        memory = AFFINE.init()
        for i in order[:FITTED]:
            points = seen[i].points.copy()
            points[1 - k] = np.nan
            memory = AFFINE.update(
                memory, tool, Sample(seen[i].p1, points, np.zeros(2), 0.0, sizes[i])
            )
        squares: list[float] = []
        for i in order[FITTED:]:
            p = AFFINE.position(memory, k, seen[i].points[k], sizes[i][k])
            there = seen[i].p1 if k == 0 else tool.second_marker(seen[i].p1)
            squares.append(np.inf if p is None else float(np.sum((p - there) ** 2)))
        out[seed] = np.sqrt(np.mean(squares))
    return out


def main(folder: Path, rig: Path) -> None:
    lab = load_rig_file(rig)
    seen = stills(folder, lab)
    print(f"{len(seen)} images, {SPLITS} splits with {FITTED} images each; rms error in mm")
    for name, sizes in (
        ("as tracked", [one.tracked for one in seen]),
        ("of the outline", [one.outlined for one in seen]),
    ):
        for k in range(2):
            off = errors(seen, sizes, k, lab.tool)
            low, middle, high = np.quantile(off, [0.025, 0.5, 0.975])
            print(f"ball {k + 1}, size {name:14}  median {middle:.2f} ({low:.2f}-{high:.2f})")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
