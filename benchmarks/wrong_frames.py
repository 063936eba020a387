"""Frames with one marker 30 to 100 px from its place, from the start of a run.

    python benchmarks/wrong_frames.py [--share 0.05] [--estimator dlt correntropy kalman]
        [--without-checks] [--single] [--runs 200] [--first 7000] [--processes N]

Each run has its own scene, a camera of points with 0.3 px of noise, a target taught from 300 right
frames, and no operator; it lasts 15 s. A frame is wrong with the probability `--share`, or with
`--single` just one of the first 60 frames is. `--without-checks` removes the thresholds that reject
a frame or stop the tool for what it sees, so that the estimators alone have to ignore wrong frames.
A marker is shifted in a random direction by a random distance.

The table has the runs that end within 1 mm and 3 mm of the taught pose by the joints, those that
stop, and the causes of the stops.
"""

import argparse
from collections import Counter
from collections.abc import Iterator
from functools import partial
from multiprocessing import Pool

import numpy as np
from changed_frames import ChangedCamera, ChangeFrame, change_fraction, misplace_marker

import rcmservo as rs
from rcmservo.cli.servo_options import ServoOptions
from rcmservo.interfaces import Frame
from rcmservo.sim import RigSettings
from rcmservo.sim.disturbances.oracle import STOPPED_PHASES
from rcmservo.tracking import PointMarkers

DURATION = 15.0
FRAMES = 300
NOISE = 0.3
SINGLE_AMONG = 60

NO_CHECKS = rs.Thresholds(
    max_innovation=1e9,
    model_error=1e9,
    max_jump_px=1e6,
    max_drift_px=1e6,
    max_contradictions=1000,
    max_target_mismatch=np.inf,
    max_residual_px=1e9,
    min_camera_distance=1e-3,
    max_rejected_frames=1000,
    max_jacobian_entry=1e9,
    moved_camera_frames=1000,
    stuck_marker_px=1e-9,
)
"""Thresholds that no frame exceeds."""


def misplace_one(random: np.random.Generator, rig: rs.sim.Rig, start: int) -> ChangeFrame:
    """Return a change of just one of the first frames."""
    changed, seen = int(random.integers(SINGLE_AMONG)), list[int]()

    def act(frame: Frame, _: Frame | None) -> Frame:
        seen.append(frame.number)
        return misplace_marker(frame, random) if len(seen) == changed + 1 else frame

    return act


def one(seed: int, estimator: str, share: float | None, checks: bool) -> tuple[float, set[str]]:
    """Perform one run; return its final error in mm and the causes of its stops."""
    settings = RigSettings(point_noise=NOISE)
    rig = rs.sim.Rig(seed, settings, False)
    plant = rs.Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    rig.move_to_target()
    target = rs.teach(plant, FRAMES)
    rig.go_home()
    make = misplace_one if share is None else change_fraction(share, misplace_marker)
    change = make(np.random.default_rng([seed, 7]), rig, 0)
    camera = ChangedCamera(rig.camera, change)
    plant = rs.Plant(rig.arm, camera, PointMarkers(), rig.clock)
    servo = rs.Servo(
        settings.mechanism,
        settings.tool,
        ServoOptions().find_estimator(estimator),
        thresholds=rs.Thresholds() if checks else NO_CHECKS,
    )
    ticks = list(rs.servo_ticks(plant, servo, target, DURATION))
    stops = {tick.state.cause.name for tick in ticks if tick.state.phase in STOPPED_PHASES}
    marker_1 = servo.position_of_marker_1
    return float(np.linalg.norm(marker_1(ticks[-1].observation.q) - marker_1(target.q))), stops


def lines(arguments: argparse.Namespace) -> Iterator[str]:
    """Yield the rows of the table."""
    seeds = range(arguments.first, arguments.first + arguments.runs)
    share = None if arguments.single else arguments.share
    yield "estimator     runs  1 mm  3 mm  stopped  causes"
    with Pool(arguments.processes) as pool:
        for estimator in arguments.estimator:
            perform = partial(
                one, estimator=estimator, share=share, checks=not arguments.without_checks
            )
            ends = pool.map(perform, seeds, chunksize=2)
            within = [sum(error <= limit for error, _ in ends) for limit in (1.0, 3.0)]
            causes = Counter(cause for _, stops in ends for cause in sorted(stops))
            yield (
                f"{estimator:<12} {len(ends):5d} {within[0]:5d} {within[1]:5d} "
                f"{sum(bool(stops) for _, stops in ends):8d}  "
                f"{', '.join(f'{cause} {n}' for cause, n in causes.most_common()) or '-'}"
            )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--share", type=float, default=0.05)
    parser.add_argument("--estimator", nargs="+", default=["dlt", "correntropy", "kalman"])
    parser.add_argument("--without-checks", action="store_true")
    parser.add_argument("--single", action="store_true")
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--first", type=int, default=7000)
    parser.add_argument("--processes", type=int, help="number of processes; all cores by default")
    for line in lines(parser.parse_args()):
        print(line, flush=True)


if __name__ == "__main__":
    main()
