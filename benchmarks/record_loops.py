"""Closed loops to compare a rebuilt servo with: what it saw at every tick, and what it decided.

    python benchmarks/record_loops.py       writes tests/data/loops, in 6 minutes

Loops 900 to 999, of rendered pictures, so that they hold sizes of markers; the estimators take
turns; 0 to 3 faults by chance: those in tests/data were drawn from the kinds of before
`old_names.py`. `decisions.py` compares. Whoever changes a decision on purpose records them again,
in the commit that says why.

What the servo is told of joints and markers is rounded to 2^-20 rad, 2^-14 mm and 2^-10 px before
it sees them: whole steps, whose differences take few bytes (packed_table.py).
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
from rcmservo.config.registry import ESTIMATORS
from rcmservo.interfaces import Floats
from rcmservo.sim import Disturbance
from rcmservo.sim.disturbances import sample_disturbances

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "tests/data/loops"
SEEDS = range(900, 1000)
DURATION = 8.0
"""s of a loop."""
PATIENCE = 2
"""How often the simulated person resumes or teaches again."""


class RoundedPlant(rs.Plant):
    """A plant that tells joints and markers in steps."""

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
    """The nearest whole steps."""
    return np.round(values * np.asarray(steps)) / np.asarray(steps) + 0.0  # no negative zero


def chosen_in(seed: int) -> Table:
    """What the servo of a loop is made of. Every second `affine` one acts on sizes too."""
    round_, number = divmod(seed, len(ESTIMATORS))
    name = list(ESTIMATORS)[number]
    sized = name == rs.AffineEstimator.name and round_ % 2 == 0
    return {"estimator": np.array(name), "features": np.array("size" if sized else "srd")}


def disturbances_of(seed: int) -> list[Disturbance]:
    """What goes wrong: 0 to 3 faults."""
    random = np.random.default_rng([seed, 5])
    drawn = sample_disturbances(random, DURATION, pictures=True)
    return drawn if random.random() < 0.75 else []


def record(seed: int) -> int:
    """Run a loop and keep it; how many bytes that takes."""
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
