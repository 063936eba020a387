"""Detection of disturbances with plausible frames, before the tool deviates by millimetres.

    python benchmarks/unnoticed.py [ROW ...] [--runs 50] [--first 0] [--estimator projection]
        [--arm good] [--processes N]

Each run has its own scene, a camera of points with 0.3 px of noise and a target taught from 300
frames, and lasts 20 s. There is no operator: a pause ends the run. The rows, with the times at
which their disturbances start, are in unnoticed_rows.py; `one(row, seed)` performs one run.

An observer knows the camera at the time of teaching, the true joints, and the noise
(rcmservo.sim.disturbances.oracle). A disturbance is visible as soon as the largest coordinate of
the innovation (delivered markers minus their true projection) has been at least 5 times the noise
in each delivered frame for 0.3 s. By this rule, an error in every second frame, a lag of the drives
and late frames are never visible; the final pose error counts for them. A target with wrong pixels
counts as visible as soon as the exploration ends.

    settled  runs that end as settled: in SERVO, feature errors (rms) within the tolerance in the
             last second, joints within 5 mm of the taught ones
    wrong    settled runs with a pose error above 2.5 mm (requirement: 0)
    worst    largest pose error (mm) of the settled runs
    visible  runs in which the disturbance became visible
    grown    largest increase (mm) of the true error after that, without a cause reported by the
             servo (requirement: 5)
    stops    stops with an expected cause, of all stops; a rejected target counts as a stop
    silent   runs without a stop

The true error is that of marker 2. Rows:

{rows}
"""

import argparse
import signal
import sys
from collections import Counter
from collections.abc import Generator, Iterator
from dataclasses import astuple, dataclass, field, replace
from multiprocessing import Pool

import numpy as np
from changed_frames import ChangedCamera
from unnoticed_rows import FIRST, MOVED, ROWS, RUN, SHOWING, TWO_RUNS, Trouble

import rcmservo as rs
from rcmservo.cli.servo_options import ServoOptions
from rcmservo.config.rig_file import RigDescription
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.teach import TeachingFailed
from rcmservo.recording.outcome import (
    MAX_SAME_POSE_DISTANCE_MM,
    SETTLED_TOLERANCE,
    OutcomeCollector,
)
from rcmservo.servo.state import State
from rcmservo.sim import Disturbance, Drive
from rcmservo.sim.disturbances import expected_causes
from rcmservo.sim.disturbances.oracle import STOPPED_PHASES, Oracle, UnnoticedGrowth
from rcmservo.sim.imperfections import ARMS
from rcmservo.sim.rig_file import read_rig_settings
from rcmservo.tracking import PointMarkers

DURATION = 20.0
FRAMES = 300
NOISE = 0.3
WRONG = 2.5
"""Pose error (mm) above which a run must not count as settled."""

UNREADY = "the first run did not settle"
"""End of runs that the table excludes."""

GROWN = 5.0
"""Largest undetected growth (mm) of the true error."""


@dataclass
class Run:
    """Result of one run, with times in s and lengths in mm; ``grown`` is that of the oracle."""

    row: str
    seed: int
    disturbances: list[str]
    end: str = ""
    settled: bool = False
    error: float = np.nan
    visible: float = np.nan
    grown: float = 0.0
    stops: list[tuple[float, str, str, bool]] = field(default_factory=list)

    @property
    def wrong(self) -> bool:
        return self.settled and not self.error <= WRONG


class Trial:
    """Simulated laboratory for one run of a row."""

    def __init__(
        self,
        run: Run,
        row: Trouble,
        disturbances: list[Disturbance],
        estimator: str,
        arm: str = "ideal",
    ) -> None:
        settings = read_rig_settings(RigDescription(), arm)
        if row.drive != Drive():
            settings = replace(settings, drive=row.drive)
        settings = replace(settings, point_noise=NOISE)
        self.run, self.row, self.disturbances = run, row, disturbances
        self.rig = rs.sim.Rig(run.seed, settings, False, disturbances)
        self.camera = ChangedCamera(self.rig.camera)
        self.plant = rs.Plant(self.rig.arm, self.camera, PointMarkers(), self.rig.clock)
        learner = ServoOptions().find_estimator(estimator)
        self.servo = rs.Servo(settings.mechanism, settings.tool, learner)
        self.unnoticed = UnnoticedGrowth(Oracle(self.rig.truth, NOISE))
        self.shown = self.marker_2()
        self.change_start = 0

    def change_frames(self) -> None:
        """Change the frames from now on if the row does so."""
        if self.row.frames is not None:
            random = np.random.default_rng([self.run.seed, 7])
            self.change_start = self.rig.clock.now() + round(1e9 * self.row.at(random))
            self.camera.change = self.row.frames(random, self.rig, self.change_start)

    def marker_2(self) -> Floats:
        """Return the true position (3,) of marker 2 in mm."""
        return self.rig.truth.markers(self.rig.clock.now())[1]

    def teach(self) -> Target:
        """Teach the target and return the tool to the start."""
        self.rig.move_to_target()
        self.shown = self.marker_2()
        if self.row.when == SHOWING:
            self.rig.begin()
            self.change_frames()
        target = rs.teach(self.plant, FRAMES)
        self.camera.change = None
        self.rig.go_home()
        if self.row.change is None:
            return target
        random = np.random.default_rng([self.run.seed, 6])
        return replace(target, points=self.row.change(random, target.points))

    def earlier(self, target: Target) -> State | None:
        """Perform a first run, return the tool to the start, and return the state if it settled."""
        self.rig.begin()
        began, judge = self.rig.clock.now(), OutcomeCollector(self.servo, target)
        for tick in rs.servo_ticks(self.plant, self.servo, target, FIRST):
            judge.add(tick)
            last = tick
        self.rig.advance_until(began + round((MOVED + 0.5) * 1e9))
        self.rig.go_home()
        return last.state if self.settled(last, target, judge) else None

    def judged(self, target: Target, state: State | None = None) -> None:
        """Perform the evaluated run, and store its result."""
        if self.row.when == RUN:
            self.rig.begin()
            self.change_frames()
        run, judge = self.run, OutcomeCollector(self.servo, target)
        for tick in self.watched(
            rs.servo_ticks(self.plant, self.servo, target, DURATION, state=state)
        ):
            judge.add(tick)
        run.settled = self.settled(tick, target, judge)
        run.end = judge.compute_result().cause
        run.error = float(np.linalg.norm(self.marker_2() - self.shown))
        run.grown = self.unnoticed.growth

    def settled(self, last: rs.Tick, target: Target, judge: OutcomeCollector) -> bool:
        """Return whether a run ends as settled."""
        marker_1 = self.servo.position_of_marker_1
        distance = np.linalg.norm(marker_1(last.observation.q) - marker_1(target.q))
        error = np.array(astuple(judge.compute_result().feature_error), float)
        is_settled = bool(
            (error < SETTLED_TOLERANCE).all() and distance <= MAX_SAME_POSE_DISTANCE_MM
        )
        return is_settled and last.state.phase is rs.Phase.SERVO

    def watched(self, ticks: Iterator[rs.Tick]) -> Generator[rs.Tick]:
        """Yield the ticks; record when the disturbance became visible, and each stop."""
        phase, events = None, self.rig.schedule.events
        began = max((event.start for event in events), default=self.change_start)
        for tick in ticks:
            self.unnoticed.update(tick, float(np.linalg.norm(self.marker_2() - self.shown)))
            if self.row.change is not None and tick.state.explored:
                self.unnoticed.oracle.visible_since = tick.observation.now
            visible = self.unnoticed.oracle.visible_since
            if visible is not None and np.isnan(self.run.visible):
                self.run.visible = tick.time * 1e-9
            state = tick.state
            if state.phase in STOPPED_PHASES and phase not in STOPPED_PHASES:
                right = tick.observation.now >= began and state.cause in self.expected_causes_of_row
                name = state.cause.name
                self.run.stops.append((tick.time * 1e-9, state.phase.name, name, right))
            phase = state.phase
            yield tick

    @property
    def expected_causes_of_row(self) -> set[rs.Cause]:
        """Causes that identify the disturbance."""
        return set(self.row.causes).union(*(expected_causes(one.kind) for one in self.disturbances))


def one(name: str, seed: int, estimator: str = "dlt", arm: str = "ideal") -> Run:
    """Perform one run of a row; return its result."""
    row = ROWS[name]
    disturbances = row.draw(np.random.default_rng([seed, 5]))
    run = Run(name, seed, [str(disturbance) for disturbance in disturbances])
    trial = Trial(run, row, disturbances, estimator, arm)
    try:
        target = trial.teach()
    except TeachingFailed as refused:
        run.end = str(refused)
        run.stops.append((0.0, "REFUSED", "NOT_SHOWN", row.when == SHOWING))
        return run
    state = trial.earlier(target) if row.when == TWO_RUNS else None
    if row.when == TWO_RUNS and state is None:
        run.end = UNREADY
        return run
    trial.judged(target, state)
    return run


def report(runs: list[Run]) -> None:
    """Print the table, and for each row the causes and the worst seeds."""
    print("row            runs settled wrong  worst  visible  grown  stops right  silent")
    rows = {name: [run for run in runs if run.row == name] for name in ROWS}
    ready = {name: [run for run in rows[name] if run.end != UNREADY] for name in ROWS}
    for name in ROWS:
        if ready[name]:
            print(line(name, ready[name]))
    for name in ROWS:
        if ready[name]:
            details(name, ready[name])
        if len(ready[name]) < len(rows[name]):
            print(f"  {len(rows[name]) - len(ready[name])} excluded: {UNREADY}")


def line(name: str, runs: list[Run]) -> str:
    """Return a row of the table."""
    stops = [stop for run in runs for stop in run.stops]
    worst = max((run.error for run in runs if run.settled), default=np.nan)
    return (
        f"{name:<14} {len(runs):4d} {sum(run.settled for run in runs):7d} "
        f"{sum(run.wrong for run in runs):5d} {worst:6.2f} "
        f"{sum(np.isfinite(run.visible) for run in runs):8d} "
        f"{max(run.grown for run in runs):6.2f} "
        f"{sum(stop[3] for stop in stops):5d} of {len(stops):<3d} "
        f"{sum(not run.stops for run in runs):6d}"
    )


def details(name: str, runs: list[Run]) -> None:
    """Print the causes of the stops of a row, and its worst runs."""
    causes = Counter(
        f"{cause}{'' if expected else ' (unexpected)'}"
        for run in runs
        for _, _, cause, expected in run.stops
    )
    print(f"\n{name}: {ROWS[name].says}")
    if causes:
        print(f"  stops: {', '.join(f'{cause} {n}' for cause, n in causes.most_common())}")
    odd = [run for run in runs if run.wrong or run.grown > GROWN]
    for run in sorted(odd, key=lambda run: -max(run.grown, run.error))[:5]:
        ends = "settled" if run.settled else run.end.partition(":")[0]
        print(
            f"  seed {run.seed}: error {run.error:.1f} mm, grown {run.grown:.1f} mm, visible at "
            f"{run.visible:.1f} s, ends {ends}; {' '.join(run.disturbances)}"
        )


def main() -> None:
    rows = "\n".join(f"    {name:<14} {row.says}" for name, row in ROWS.items())
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").format(rows=rows),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("row", nargs="*", help="rows to run; all by default")
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--estimator", default="dlt")
    parser.add_argument("--arm", choices=ARMS, default="ideal")
    parser.add_argument("--processes", type=int, help="number of processes; all cores by default")
    arguments = parser.parse_args()
    for name in arguments.row:
        if name not in ROWS:
            parser.error(f"no row {name!r}: {', '.join(ROWS)}")
    seeds = range(arguments.first, arguments.first + arguments.runs)
    estimator, arm = arguments.estimator, arguments.arm
    jobs = [(name, seed, estimator, arm) for name in arguments.row or ROWS for seed in seeds]
    report(measured(jobs, arguments.processes))


def measured(jobs: list[tuple[str, int, str, str]], processes: int | None) -> list[Run]:
    """Perform all runs; return the finished ones after Ctrl-C."""
    runs: list[Run] = []
    try:
        with Pool(processes, signal.signal, (signal.SIGINT, signal.SIG_IGN)) as pool:
            for run in pool.imap(of_job, jobs, chunksize=2):
                runs.append(run)
                print(f"\r{len(runs)} of {len(jobs)}", end="", file=sys.stderr, flush=True)
    except KeyboardInterrupt:
        print("\nstopped; the report covers the finished runs", end="", file=sys.stderr)
    print(file=sys.stderr)
    return runs


def of_job(job: tuple[str, int, str, str]) -> Run:
    return one(*job)


if __name__ == "__main__":
    main()
