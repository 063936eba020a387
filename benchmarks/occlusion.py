"""Occlusion by smoke and blood in rendered frames: the tool must stop, and arrive afterwards.

    python benchmarks/occlusion.py [SEEDS [FIRST]]

Each run of 20 s has one cloud of smoke and one splash of blood at random times between 1 and 11 s,
each for 0.3 to 3 s. A scripted operator resumes after pauses. Requirements: at least 95 of 100 runs
end within 1 mm of the taught pose, and the tool does not move without markers, after the time for
stopping (0.1 s for the ramp and 0.1 s for the drives).
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

import numpy as np

import rcmservo as rs
from rcmservo.config.rig_file import make_default_markers
from rcmservo.interfaces import Floats
from rcmservo.safety.innovation import find_lost_markers
from rcmservo.sim import Disturbance
from rcmservo.sim.scripted_operator import ScriptedOperator, run_attended
from rcmservo.tracking import ColourMarkers

DURATION = 20.0
STOPPED = 200_000_000
"""Time (ns) after the first tick without markers until the tool must be at rest."""


class Run(NamedTuple):
    """Result of one run: pose error (mm), motion (mm) and time (s) without markers, message."""

    seed: int
    error: float
    moved: float
    blind: float
    resumed: int
    shown: int
    words: str


def one(seed: int) -> Run:
    """Run one seed with smoke and blood."""
    random = np.random.default_rng([seed, 3])
    at, lasts = random.uniform(1.0, 8.0, 2), random.uniform(0.3, 3.0, 2)
    disturbances = [
        Disturbance("occlusion", round(a, 2), round(b, 2), {"by": by})
        for by, a, b in zip(("smoke", "blood"), at, lasts, strict=True)
    ]
    rig = rs.sim.Rig(seed, disturbances=disturbances)
    plant = rs.Plant(rig.arm, rig.camera, ColourMarkers(make_default_markers()), rig.clock)
    servo = rs.Servo(rig.settings.mechanism, rig.settings.tool)
    rig.move_to_target()
    target = rs.teach(plant, frames=30)
    p_d = rig.truth.markers(rig.clock.now())[1]
    rig.go_home()
    rig.begin()
    operator, gone, blind, moved = ScriptedOperator(rig, plant, 20, frames=30), -1, 0, 0.0
    stood: Floats | None = None
    for tick in run_attended(rig, plant, servo, target, DURATION, operator):
        now, p2 = tick.observation.now, rig.truth.markers(rig.clock.now())[1]
        if any(find_lost_markers(tick.observation.points)):
            gone = now if gone < 0 else gone
            blind += 1
            if now - gone > STOPPED:
                stood = p2 if stood is None else stood
                moved = max(moved, float(np.linalg.norm(p2 - stood)))
        else:
            gone, stood = -1, None
    error = float(np.linalg.norm(rig.truth.markers(rig.clock.now())[1] - p_d))
    return Run(
        seed, error, moved, blind / 100.0, operator.resumed, operator.taught, tick.state.text
    )


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    with ProcessPoolExecutor() as pool:
        runs = list(pool.map(one, range(first, first + count)))
    errors, moved = np.array([run.error for run in runs]), max(run.moved for run in runs)
    print(
        f"{count} seeds: {np.sum(errors <= 1.0)} within 1 mm, median {np.median(errors):.3f}, "
        f"worst {errors.max():.2f}"
    )
    blind = np.median([run.blind for run in runs])
    print(f"without markers for {blind:.1f} s (median); motion meanwhile at most {moved:.4f} mm")
    print(
        f"resumed {sum(run.resumed for run in runs)} times, target taught again "
        f"{sum(run.shown for run in runs)} times"
    )
    for run in runs:
        if not (run.error <= 1.0 and run.moved <= 0.02 and not run.shown):
            print(" ", run)


if __name__ == "__main__":
    main()
