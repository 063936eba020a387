"""Recording of closed loops for regression tests: observations and decisions of each tick.

    python benchmarks/record_loops.py       writes tests/data/loops, in 6 minutes

The loops 900 to 999 use rendered images, so that they contain sizes of markers. The estimators take
turns, and 0 to 3 random faults occur; those in tests/data are of the kinds before `old_names.py`.
`decisions.py` compares. A commit that changes decisions on purpose records the loops again and
states the reason.

Joints and markers are rounded to 2^-20 rad, 2^-14 mm and 2^-10 px before the servo receives them,
so that their differences take few bytes (packed_table.py).
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import packed_table
from decisions import recorded, servo_of
from packed_table import JOINTS, PIXELS, Table
from rich.progress import track

import rcmservo as rs
from rcmservo.config.class_registry import ESTIMATORS
from rcmservo.interfaces import Floats
from rcmservo.sim import Disturbance
from rcmservo.sim.disturbances import sample_disturbances

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "tests/data/loops"
SEEDS = range(900, 1000)
DURATION = 8.0
"""Duration (s) of a loop."""
PATIENCE = 2
"""Number of times that the simulated operator resumes or teaches again."""


class RoundedPlant(rs.Plant):
    """Plant that rounds joints and markers."""

    def read(self) -> rs.Observation:
        seen = super().read()
        return replace(
            seen,
            q=stepped(seen.q, JOINTS),
            q_exposure=stepped(seen.q_exposure, JOINTS),
            points=stepped(seen.points, PIXELS),
            sizes=stepped(seen.sizes, PIXELS),
        )


def stepped(values: Floats, steps: float | tuple[float, ...]) -> Floats:
    """Round values to the nearest step; `steps` is the number of steps per unit."""
    return np.round(values * np.asarray(steps)) / np.asarray(steps) + 0.0  # no negative zero


def chosen_in(seed: int) -> Table:
    """Return estimator and features of a loop; every second `affine` loop uses sizes too."""
    round_, number = divmod(seed, len(ESTIMATORS))
    name = list(ESTIMATORS)[number]
    sized = name == rs.AffineEstimator.name and round_ % 2 == 0
    return {"estimator": np.array(name), "features": np.array("size" if sized else "srd")}


def disturbances_of(seed: int) -> list[Disturbance]:
    """Return 0 to 3 random faults."""
    random = np.random.default_rng([seed, 5])
    drawn = sample_disturbances(random, DURATION, pictures=True)
    return drawn if random.random() < 0.75 else []


def record(seed: int) -> int:
    """Run a loop and write it; return the size of the file in bytes."""
    rig = rs.sim.Rig(seed, disturbances=disturbances_of(seed))
    chosen = chosen_in(seed)
    servo = servo_of(chosen)
    plant = RoundedPlant(rig.arm, rig.camera, rs.tracking.ColourMarkers(), rig.clock)
    run = recorded(rig, plant, servo, DURATION, PATIENCE)
    path = FOLDER / f"{seed}.npz.xz"
    packed_table.write(path, run | chosen)
    return path.stat().st_size


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(2) as pool:
        sizes = track(pool.map(record, SEEDS), "recording", total=len(SEEDS))
        print(f"{sum(sizes) / 1e6:.2f} MB in {FOLDER}")


if __name__ == "__main__":
    sys.exit(main())
