"""Time of one servo step with a new frame per estimator, relative to a NumPy 3x3 solve-and-clip.

    python benchmarks/step_time.py

A step computes features, imaged RCM, estimate, law and gate. Absolute times depend on the machine,
the ratio to the reference less so. Step and reference are timed in turn, with the processor in the
same state: hot, one call after the other; right after the simulation of the arm; and after 3 ms of
sleep, as in a live loop.
"""

import platform
import time
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

import rcmservo as rs
from rcmservo.cli.servo_options import ServoOptions
from rcmservo.estimation.base import Estimator
from rcmservo.tracking import PointMarkers

SEEDS = range(3)
LAST = 200
"""Number of steps of each run that are timed again."""

Pairs = list[tuple[float, float]]
"""Times (us) of steps and of the reference."""


class Run(NamedTuple):
    """Timing of a run of 10 s, and its last steps with a new frame."""

    pairs: Pairs
    """Times of the steps with a new frame, right after the simulation of the arm."""
    steps: list[Callable[[], object]]
    """Last steps, to be repeated."""


def solve_and_clip() -> None:
    """Reference: the simplest law, with NumPy."""
    np.clip(-np.linalg.solve(J, ERROR), -1.0, 1.0)


J, ERROR = np.diag([1.0, 2.0, 3.0]) + 0.1, np.array([1.0, 2.0, 3.0])


def timed(call: Callable[[], object]) -> float:
    """Return the time (us) of a call."""
    start = time.perf_counter()
    call()
    return (time.perf_counter() - start) * 1e6


def run(estimator: Estimator, seed: int) -> Run:
    """Run after a warm-up; time the reference at ticks without a new frame."""
    rig = rs.sim.Rig(seed, pictures=False)
    plant = rs.Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    servo = rs.Servo(
        mechanism=rs.SphericalRcm(), tool=rs.RigidTool(spacing=30.0), estimator=estimator
    )
    rig.move_to_target()
    target = rs.teach(plant, frames=30)
    rig.go_home()
    servo.warm_up()
    plant.enable()
    state, took, yardstick, steps = servo.init(), [], [], []
    for _ in rs.ticks(plant.clock, rate=100.0, duration=10.0):
        seen = plant.read()
        step = partial(servo.step, state, seen, target)
        if seen.frame > state.newest_frame:
            took.append(timed(step))
            steps.append(step)
        else:
            yardstick.append(timed(solve_and_clip))
        state = step()
        plant.send(state.command)
    return Run(list(zip(took, yardstick, strict=False)), steps[-LAST:])


def repeated(steps: list[Callable[[], object]], pause: float) -> Pairs:
    """Time the steps and the reference in turn, each after `pause` s of sleep or a hot call."""
    pairs = []
    for step in steps:
        both = []
        for call in (step, solve_and_clip):
            if pause > 0.0:
                time.sleep(pause)
            else:
                call()
            both.append(timed(call))
        pairs.append((both[0], both[1]))
    return pairs


def summary(name: str, pairs: Pairs) -> str:
    """Return median and 99th percentile of the steps, median of the reference, and the ratio."""
    took, yardstick = np.transpose(pairs)
    p50, p99 = np.percentile(took, [50, 99])
    plain = float(np.median(yardstick))
    both = f"{p50:6.1f} us   99 % {p99:6.1f} us   NumPy {plain:6.1f} us"
    return f"    {name:<22} {both}   {p50 / plain:5.2f} x"


def main() -> None:
    print(f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}")
    for name, estimator in ServoOptions().estimators.items():
        runs = [run(estimator, seed) for seed in SEEDS]
        steps = [step for one in runs for step in one.steps]
        print(name)
        print(summary("hot", repeated(steps, 0.0)))
        print(summary("after the simulation", [pair for one in runs for pair in one.pairs]))
        print(summary("after 3 ms of sleep", repeated(steps, 3e-3)))


if __name__ == "__main__":
    main()
