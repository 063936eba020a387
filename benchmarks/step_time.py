"""Time of one servo step (features, imaged RCM, estimate, law, gate) on ticks with a new frame, per
estimator.

    python benchmarks/step_time.py

Absolute times depend on the machine; the ratio to a plain NumPy 3x3 solve-and-clip in the same run
does not so much.
"""

import platform
import time

import numpy as np

import rcmservo as rs
from rcmservo.app.servo_options import ServoOptions
from rcmservo.method.estimators.base import Estimator
from rcmservo.tracking import PointMarkers

SEEDS = range(3)


def step_times(estimator: Estimator, seed: int) -> list[float]:
    """Microseconds of every step with a new frame in a 10 s run, after warm-up."""
    rig = rs.sim.Rig(seed, pictures=False)
    plant = rs.Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    servo = rs.Servo(
        mechanism=rs.SphericalRcm(), tool=rs.RigidTool(spacing=30.0), estimator=estimator
    )
    rig.show_target()
    target = rs.teach(plant)
    rig.go_home()
    servo.warm_up()
    plant.enable()
    state, took = servo.init(), []
    for _ in rs.ticks(plant.clock, rate=100.0, duration=10.0):
        seen = plant.read()
        new = seen.frame > state.frame
        start = time.perf_counter()
        state = servo.step(state, seen, target)
        if new:
            took.append((time.perf_counter() - start) * 1e6)
        plant.send(state.command)
    return took


def solve_and_clip() -> float:
    """Microseconds of the plainest law, by NumPy: the yardstick."""
    J, e = np.diag([1.0, 2.0, 3.0]) + 0.1, np.array([1.0, 2.0, 3.0])
    took = []
    for _ in range(5000):
        start = time.perf_counter()
        np.clip(-np.linalg.solve(J, e), -1.0, 1.0)
        took.append((time.perf_counter() - start) * 1e6)
    return float(np.median(took))


def main() -> None:
    print(f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}")
    yardstick = solve_and_clip()
    print(f"NumPy 3x3 solve and clip: {yardstick:.1f} us (median)")
    for name, estimator in ServoOptions().estimators.items():
        took = np.concatenate([step_times(estimator, seed) for seed in SEEDS])
        p50, p99 = np.percentile(took, [50, 99])
        print(
            f"{name:<20} median {p50:6.1f} us   99 % {p99:6.1f} us   {p50 / yardstick:5.1f} x "
            f"the yardstick"
        )


if __name__ == "__main__":
    main()
