"""Closed loops of the laboratory itself, on MuJoCo's arm, with the live servo: what batch.py tells
of its compiled twin.

    python benchmarks/laboratory.py --scenes 200
    python benchmarks/laboratory.py --scenes 20 --pictures [--hard]

The target is shown for 5 s, and each loop goes on for 15 s, with a camera that tells points (0.3 px
of noise, 20 ms delay) or with rendered pictures. The errors are those of marker 2 by the joints of
the simulated arm, whose encoders hardly err.
"""

import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import count, islice
from multiprocessing import Pool

import numpy as np
import tyro
from batch import report

import rcmservo as rs
from rcmservo.app.servo_options import ServoOptions
from rcmservo.guard.states import PHASES
from rcmservo.loop.tick import Tick
from rcmservo.method.controller import scaled
from rcmservo.sim.scene import Scene
from rcmservo.study import StudyRun

SHOWN = 300
"""Frames: 5 s."""
DURATION = 15.0
"""s."""
FRAME_RATE = rs.sim.RigSettings().timing.frame_rate
"""1/s."""
NOISE = rs.sim.RigSettings().point_noise
"""px, of the camera that tells points."""
HARD = 25.0, 40.0
"""Condition of the scaled Jacobian at the target of a hard scene. Beyond it no scene is drawn."""
FIRST_HARD = 1000
"""Seed from which on hard scenes are looked for."""


@dataclass(frozen=True)
class Options:
    """What is tried."""

    scenes: int = 200
    """How many."""
    pictures: bool = False
    """Rendered pictures."""
    hard: bool = False
    """Scenes whose target is near a singular surface, instead of seeds 0 to one less."""
    estimator: str = "dlt"
    """By its name."""


def seeds(options: Options) -> Iterable[int]:
    """Of the scenes that are tried."""
    if not options.hard:
        return range(options.scenes)
    return islice(filter(hard, count(FIRST_HARD)), options.scenes)


def hard(seed: int) -> bool:
    rig = rs.sim.Rig(seed, pictures=False)
    o_c = rig.truth.imaged_rcm()
    condition = np.linalg.cond(scaled(rig.truth.jacobian(rig.scene.target, o_c)))
    return bool(HARD[0] <= condition <= HARD[1])


def ticks(rig: rs.sim.Rig, tracker: rs.Tracker, estimator: str) -> Iterator[Tick]:
    """A person shows the target and brings the tool home; then the servo runs."""
    plant = rs.Plant(rig.arm, rig.camera, tracker, rig.clock)
    rig.show_target()
    target = rs.teach(plant, SHOWN)
    rig.go_home()
    rig.begin()
    settings = rig.settings
    servo = rs.Servo(settings.mechanism, settings.tool, ServoOptions().estimator(estimator))
    yield from rs.run(plant, servo, target, DURATION)


def course(seed: int, scene: Scene, ticks: Iterable[Tick], bound: float = 0.0) -> StudyRun:
    """How a run in a scene went; without a `bound` on its error where none is known."""
    run, there = list(ticks), scene.body.points(scene.target)[1]
    away = [np.linalg.norm(scene.body.points(tick.seen.q)[1] - there) for tick in run]
    phases = np.array([PHASES.index(tick.state.phase) for tick in run], np.int8)
    causes = np.array([tick.state.cause.place for tick in run], np.int8)
    return StudyRun(
        seed, run[0].servo.rate, np.array(away, np.float64), phases, causes, bound, scene
    )


def one(options: Options, seed: int) -> StudyRun:
    rig, frames = rs.sim.Rig(seed, pictures=options.pictures), DURATION * FRAME_RATE
    tracker = rs.tracking.ColourMarkers() if options.pictures else rs.tracking.PointMarkers()
    least = 0.0 if options.pictures else rs.bound(rig.scene, NOISE, frames, SHOWN).rms
    return course(seed, rig.scene, ticks(rig, tracker, options.estimator), least)


def main(options: Options) -> None:
    print(options)
    runs: list[StudyRun] = []
    with Pool() as pool:
        for run in pool.imap(partial(one, options), seeds(options)):
            runs.append(run)
            print(f"\r{len(runs)} of {options.scenes}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    report(runs)
    for run in runs:
        if run.stops or not run.error[-1] <= 0.5:
            stops = [(time, cause.name) for time, cause in run.stops]
            print(f"  seed {run.seed}: {run.error[-1]:.2f} mm off, stops {stops}")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
