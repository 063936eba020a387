"""Runs with imperfect arms: arrivals, stops, and the truth of the reported bound.

    python benchmarks/imperfect_arms.py [ROW ...] [--target zoom] [--estimator dlt] [--runs 200]
        [--first 7000] [--processes N]

Each run has its own scene, a camera of points with 0.3 px of noise and a target taught from 300
frames; it lasts 15 s on the compiled plant. There is no operator: a pause ends the run.

The rows ideal, good and worn are the arms of `rcmservo run --arm`; each other row has one
imperfection. With `--target` the target contradicts the arm or the camera:

    zoom       the focal length is 3 % shorter than while teaching
    insertion  the insertion has been reported 3 mm wrong since teaching
    marker     a marker was 8 px wrong throughout teaching

    near       runs that end within 1 mm without a stop, with 95 % interval
    1.5 mm     the same within 1.5 mm
    median     median error at the end, mm
    far        runs that rest more than 1.5 mm from the target without a stop
    bound      runs without a stop whose error is within the bound that the servo reports for 95 %
    of         median of this bound, mm
    stops      causes of the stops

The error is the true distance of marker 2 from its taught position. Rows:

{rows}
"""

import argparse
from collections import Counter
from functools import cache, partial
from math import radians
from multiprocessing import Pool

import numpy as np

import rcmservo as rs
from rcmservo.config.class_registry import ESTIMATORS
from rcmservo.config.rig_file import RigDescription
from rcmservo.safety.causes import Cause
from rcmservo.sim import Drive, Imperfections, RigSettings
from rcmservo.sim.camera_kernels import CameraStruct
from rcmservo.sim.imperfections import ARMS
from rcmservo.sim.rig_file import read_rig_settings
from rcmservo.study.compiled_engine import CompiledEngine
from rcmservo.study.kernel_engine import StudyGoal
from rcmservo.study.report.statistics import estimate_fraction
from rcmservo.study.run_outcome import StudyRun

DURATION_S = 15.0
TEACHING_FRAMES = 300


def imperfect(**sizes: object) -> RigSettings:
    return RigSettings(imperfections=Imperfections(**sizes))  # type: ignore[arg-type]


def driven(gain: float = 1.0, lag: float = Drive().lag + Drive().delay) -> RigSettings:
    """Return the settings of drives with a gain, and a lag that contains the delay."""
    delay, error = Drive().delay, gain - 1.0
    return RigSettings(drive=Drive(delay, lag - delay, rate_error=(error, error, error)))


def resting(**rates_mm_s: float) -> RigSettings:
    """Return the settings of drives that rest at small rates: mm/s, and as many 0.01 rad/s."""
    rates = {name: (0.01 * rate, 0.01 * rate, rate) for name, rate in rates_mm_s.items()}
    return RigSettings(drive=Drive(**rates))  # type: ignore[arg-type]


ROWS: dict[str, tuple[str, RigSettings]] = {
    "backlash": (
        "backlash of 0.25° and 0.2 mm",
        imperfect(backlash=(radians(0.25), radians(0.25), 0.2)),
    ),
    "backlash_2": (
        "backlash of 0.5° and 0.3 mm",
        imperfect(backlash=(radians(0.5), radians(0.5), 0.3)),
    ),
    "friction": ("the trocar bends the shaft by 0.02 mm per mm/s", imperfect(friction_bend=0.02)),
    "markers_1": ("markers 1 mm off the axis", imperfect(marker_distance=1.0)),
    "markers_2": ("markers 2 mm off the axis", imperfect(marker_distance=2.0)),
    "markers_3": (
        "markers 3 mm off the axis, with a roll that follows",
        imperfect(marker_distance=3.0, roll=1.0),
    ),
    "axes": ("axes 2 mm apart", imperfect(axis_distance=2.0)),
    "insertion": ("insertion 2 mm from the RCM", imperfect(insertion_distance=2.0)),
    "joints_50": ("joints at 50 Hz", imperfect(report_period=0.02)),
    "port_1": ("the port breathes by 1 mm", imperfect(port_motion=1.0)),
    "port_5": ("the port breathes by 5 mm", imperfect(port_motion=5.0)),
    "dead_1": ("joints do not move below 1 mm/s, 0.01 rad/s", resting(deadband=1.0)),
    "dead_2": ("joints do not move below 2 mm/s, 0.02 rad/s", resting(deadband=2.0)),
    "spacing_110": ("markers 10 % farther apart", imperfect(spacing_error=0.1)),
    "spacing_90": ("markers 10 % nearer to each other", imperfect(spacing_error=-0.1)),
    "zero": ("insertion 10 mm more than reported", imperfect(insertion_error=10.0)),
    "tissue": ("tissue on one side bends the tool by 10 %", imperfect(tissue_bend=0.1)),
    "stiction": ("joints do not start below 2 mm/s, 0.02 rad/s", resting(stiction=2.0)),
    **{f"gain_{p}": (f"drives follow by {p} %", driven(p / 100)) for p in (70, 90, 95, 98, 130)},
    **{f"lag_{t}": (f"drives lag by {t} ms", driven(lag=t / 1e3)) for t in (50, 80, 100, 150)},
}
"""Description and settings of each imperfection."""


def change_target(name: str, seed: int, goal: StudyGoal, centre: np.ndarray) -> StudyGoal:
    """Return the target of a run as `--target` changes it."""
    random, sign = np.random.default_rng(seed), 1.0 if seed % 2 else -1.0
    if name == "zoom":
        return goal._replace(points=centre + (goal.points - centre) / 0.97)
    if name == "insertion":
        return goal._replace(q=goal.q + np.array([0.0, 0.0, 3.0 * sign]))
    if name == "marker":
        angle, shift = random.uniform(0.0, 2.0 * np.pi), np.zeros((2, 2))
        shift[seed % 2] = 8.0 * np.cos(angle), 8.0 * np.sin(angle)
        return goal._replace(points=goal.points + shift)
    return goal


@cache
def make_engine(row: str, estimator: str) -> CompiledEngine:
    settings = read_rig_settings(RigDescription(), row) if row in ARMS else ROWS[row][1]
    servo = rs.Servo(settings.mechanism, settings.tool, estimator=ESTIMATORS[estimator]())
    return CompiledEngine(servo, settings, DURATION_S, TEACHING_FRAMES)


def run(row: str, estimator: str, target: str, seed: int) -> StudyRun:
    engine = make_engine(row, estimator)
    scene, goal, noise = engine.draw_trial(seed, 0)
    return engine.of(
        seed,
        scene,
        change_target(target, seed, goal, CameraStruct(scene.optics.lens).centre),
        noise,
    )


def describe_runs(runs: list[StudyRun]) -> str:
    """Return the row of the table for the runs of an arm."""
    errors = np.array([run.pose_error for run in runs])
    moves_on = np.array([run.held is Cause.NONE for run in runs])
    bounds = np.array([run.pose_bound for run in runs])[moves_on]
    near, nearer = int((moves_on & (errors <= 1.0)).sum()), int((moves_on & (errors <= 1.5)).sum())
    stays, far = errors[moves_on], int((errors[moves_on] > 1.5).sum())
    covered, bound = (np.mean(stays <= bounds), np.median(bounds)) if len(stays) else (0.0, np.nan)
    stops = Counter(run.held.name for run in runs if run.held is not Cause.NONE)
    return (
        f"{len(runs):4} {estimate_fraction(near, len(runs)):.1%} {nearer / len(runs):7.1%} "
        f"{np.median(errors):7.3f} {far:4} {covered:7.1%} {bound:5.2f}  "
        + ", ".join(f"{name} {count}" for name, count in stops.most_common())
    )


def main() -> None:
    rows = "\n".join(f"    {name:11}{text}" for name, (text, _) in ROWS.items())
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").format(rows=rows),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("row", nargs="*", help="rows to run; ideal, good and worn by default")
    parser.add_argument("--target", choices=("zoom", "insertion", "marker"), default="")
    parser.add_argument("--estimator", choices=("dlt", "projection"), default="dlt")
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--first", type=int, default=7000)
    parser.add_argument("--processes", type=int, help="number of processes; all cores by default")
    arguments = parser.parse_args()
    names = arguments.row or list(ARMS)
    unknown = sorted(set(names) - {*ARMS, *ROWS})
    if unknown:
        parser.error(f"no row {unknown[0]!r}: {', '.join([*ARMS, *ROWS])}")
    seeds = range(arguments.first, arguments.first + arguments.runs)
    print("row         runs near (95 %)               1.5 mm  median  far   bound    of  stops")
    with Pool(arguments.processes) as pool:
        for name in names:
            one = partial(run, name, arguments.estimator, arguments.target)
            print(f"{name:11}", describe_runs(pool.map(one, seeds, chunksize=5)), flush=True)


if __name__ == "__main__":
    main()
