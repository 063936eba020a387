"""Random faults in closed loops in simulated time: commands, stopping times and causes.

    python benchmarks/campaign.py [faults|none|short] [RUNS [FIRST_SEED]]

    faults   1 to 3 random disturbances in 30 s; an operator resumes after pauses (2000 runs)
    none     no disturbance: nothing may stop the tool (500 runs)
    short    1 to 3 disturbances that require HOLD at most, each shorter than 0.5 s (500 runs)

The camera delivers points with 0.1 px of noise, about the error of tracking in rendered frames.
The arm checks each command. The undetected growth is the increase of the true error in mm after an
observer with the true camera could detect a disturbance (rcmservo.sim.disturbances.oracle) while
the servo reports no cause. Conspicuous runs are listed with seed and disturbances; `rcmservo run
--seed N --disturb ...` (with images) or `one(seed, kind)` repeats them.
"""

import argparse
import signal
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import astuple, dataclass, field
from functools import partial
from multiprocessing import Pool
from typing import Any

import numpy as np

import rcmservo as rs
from rcmservo.interfaces import Floats
from rcmservo.loop.plant import NotEnabled
from rcmservo.recording.outcome import SETTLED_TOLERANCE, OutcomeCollector
from rcmservo.servo.servo import Servo
from rcmservo.sim import Disturbance, Killed, RigSettings
from rcmservo.sim.disturbances import DISTURBANCE_KINDS, expected_causes, sample_disturbances
from rcmservo.sim.disturbances.oracle import Oracle, UnnoticedGrowth
from rcmservo.sim.scripted_operator import ScriptedOperator, run_attended
from rcmservo.tracking import PointMarkers

DURATION = 30.0
NOISE = 0.1
FAULTS_UNTIL = 20.0
PATIENCE = 5
STOP_TIME_S = 0.1
"""Largest time (s) from HOLD or PAUSE to zero rates."""

CAUSE_WINDOW_S = 1.0
"""Time (s) before a stop within which a fault counts as its cause."""

MAX_UNDETECTED_MM = 5.0
"""Largest undetected growth (mm) of the true error."""

SHORT = (
    "occlusion",
    "nan_points",
    "frame_drop",
    "frame_order",
    "camera_clock",
    "latency",
)
"""Kinds of disturbances that require HOLD at most."""

STOPS = {rs.Phase.HOLD, rs.Phase.PAUSED, rs.Phase.FAULT}


@dataclass
class Run:
    """Result of one run; ``resumed`` counts the requests to resume that the servo accepted."""

    seed: int
    disturbances: list[str]
    end: str = ""
    wrong_commands: list[str] = field(default_factory=list)
    too_slow: list[str] = field(default_factory=list)
    stops: list[tuple[float, str, str, bool]] = field(default_factory=list)
    resumed: int = 0
    shown: int = 0
    pose_error: float = np.nan
    unnoticed: float = 0.0
    words: str = ""


class CheckedArm:
    """Arm that checks each command: finite, bounded, slew-limited, with an increasing number."""

    def __init__(self, arm: Any, servo: Servo, found: list[str]) -> None:
        self._arm, self._gate, self._found = arm, servo.gate, found
        self._last = servo.gate.rest()

    def enable(self) -> None:
        self._last = self._gate.rest()
        self._arm.enable()

    def measure(self) -> Any:
        return self._arm.measure()

    def apply(self, command: rs.Command) -> Floats:
        speed, slew = np.array(self._gate.speed), np.array(self._gate.slew)
        change = np.abs(command.rates - self._last.rates)
        dt = min((command.time - self._last.time) * 1e-9, self._gate.max_period)
        checks = {
            "not finite": np.isfinite(command.rates).all(),
            "too fast": np.all(np.abs(command.rates) <= speed * (1 + 1e-9)),
            "over-slewed": np.all(change <= slew * dt * (1 + 1e-9))
            if command.enabled
            else not command.rates.any(),
            "number does not rise": command.number > self._last.number,
        }
        self._found += [f"{command.time}: {name}" for name, passed in checks.items() if not passed]
        self._last = command
        return self._arm.apply(command)


def disturbances_of(seed: int, kind: str) -> list[Disturbance]:
    """Return the disturbances of a run."""
    random = np.random.default_rng([seed, 4])
    if kind == "none":
        return []
    if kind == "faults":
        return sample_disturbances(random, FAULTS_UNTIL)
    chosen = random.choice(SHORT, size=random.integers(1, 4), replace=False).tolist()
    at, last = (
        random.uniform(0.0, FAULTS_UNTIL, len(chosen)),
        random.uniform(0.02, 0.5, len(chosen)),
    )
    return [
        Disturbance(name, round(a, 3), round(b, 3))
        for name, a, b in zip(chosen, at, last, strict=True)
    ]


def one(seed: int, kind: str) -> Run:
    """Run one seed of a kind; return its result."""
    return disturbed(seed, disturbances_of(seed, kind))


def disturbed(seed: int, disturbances: list[Disturbance]) -> Run:
    """Run one seed with certain disturbances; return its result."""
    run = Run(seed, [str(disturbance) for disturbance in disturbances])
    rig = rs.sim.Rig(
        seed, RigSettings(point_noise=NOISE), pictures=False, disturbances=disturbances
    )
    servo = rs.Servo(rig.settings.mechanism, rig.settings.tool)
    plant = rs.Plant(
        CheckedArm(rig.arm, servo, run.wrong_commands), rig.camera, PointMarkers(), rig.clock
    )
    plant.recorded = lambda: not rig.disk_full()
    rig.move_to_target()
    target = rs.teach(plant, frames=30)
    p_d = rig.truth.markers(rig.clock.now())[1]
    rig.go_home()
    rig.begin()
    operator, judge = (
        ScriptedOperator(rig, plant, PATIENCE, frames=30),
        OutcomeCollector(servo, target),
    )
    start, unnoticed = rig.clock.now(), UnnoticedGrowth(Oracle(rig.truth, NOISE))
    ticks = run_attended(
        rig, plant, servo, target, DURATION, operator, lambda *begins: unnoticed.oracle.restart()
    )
    try:
        for tick in watched(run, ticks, disturbances, start):
            judge.add(tick)
            unnoticed.update(
                tick, float(np.linalg.norm(rig.truth.markers(tick.observation.now)[1] - p_d))
            )
    except Killed:
        run.end = "killed"
    except NotEnabled as why:
        run.end, run.words = "not enabled", str(why)
    run.resumed, run.shown, run.unnoticed = operator.resumed, operator.taught, unnoticed.growth
    run.pose_error = float(np.linalg.norm(rig.truth.markers(rig.clock.now())[1] - p_d))
    if not run.end:
        run.end, run.words = ended(tick, judge)
    return run


def ended(last: rs.Tick, judge: OutcomeCollector) -> tuple[str, str]:
    """Return the end of a run in one word, and its cause."""
    result, phase = judge.compute_result(), last.state.phase
    error = np.array(astuple(result.feature_error), float)
    there = phase is rs.Phase.SERVO and bool((error < SETTLED_TOLERANCE).all())
    end = "settled" if there else phase.name if phase in STOPS else "under way"
    return end, result.cause


def watched(
    run: Run, ticks: Iterator[rs.Tick], disturbances: list[Disturbance], start: int
) -> Iterator[rs.Tick]:
    """Yield the ticks; record each stop, whether its cause is expected, and late zero rates."""
    phase, since = None, 0
    for tick in ticks:
        state, now = tick.state, tick.observation.now
        if state.phase is not phase:
            since = since if phase in STOPS and state.phase in STOPS else now
            if state.phase in STOPS and not (
                phase is rs.Phase.HOLD and state.phase is rs.Phase.PAUSED
            ):
                right = state.cause in accepted(disturbances, (now - start) * 1e-9)
                run.stops.append(((now - start) * 1e-9, state.phase.name, state.cause.name, right))
            phase = state.phase
        late = (now - since) * 1e-9 > STOP_TIME_S - 0.5e-2 or phase is rs.Phase.FAULT
        if phase in STOPS and late and state.command.rates.any():
            run.too_slow.append(f"{(now - start) * 1e-9:.2f} s: {state.text}")
        yield tick


def accepted(disturbances: list[Disturbance], now: float) -> set[rs.Cause]:
    """Return the causes of faults that are active now or were within `CAUSE_WINDOW_S`."""
    causes: set[rs.Cause] = set()
    for disturbance in disturbances:
        kind = DISTURBANCE_KINDS[disturbance.kind]
        lasts = (
            np.inf
            if kind.is_permanent
            else 0.0
            if kind.default_duration is None
            else disturbance.duration_s
        )
        if disturbance.at <= now <= disturbance.at + lasts + CAUSE_WINDOW_S:
            causes |= expected_causes(disturbance.kind)
    return causes


def report(runs: list[Run], kind: str) -> None:
    """Print the numbers of the campaign, and each conspicuous run."""
    stops = [stop for run in runs for stop in run.stops]
    right = sum(stop[3] for stop in stops)
    print(
        f"{kind}: {len(runs)} runs of {DURATION:g} s; ends: "
        f"{dict(Counter(run.end for run in runs))}"
    )
    print(
        f"invalid commands (not finite, too fast, over-slewed, number not increasing): "
        f"{sum(len(run.wrong_commands) for run in runs)}"
    )
    print(
        f"stops without zero rates after {STOP_TIME_S:g} s (FAULT: at once): "
        f"{sum(len(run.too_slow) for run in runs)}"
    )
    print(
        f"stops: {len(stops)}"
        + (f", {right} with an expected cause ({right / len(stops):.2%})" if stops else "")
    )
    print(f"by cause: {dict(Counter(stop[2] for stop in stops).most_common())}")
    print(
        f"resumed {sum(run.resumed for run in runs)} times, target taught again "
        f"{sum(run.shown for run in runs)} times"
    )
    settled = np.array([run.pose_error for run in runs if run.end == "settled"])
    if len(settled):
        p50, p99 = np.percentile(settled, [50, 99])
        print(
            f"pose error of settled runs: median {p50:.3f}, 99 % {p99:.3f}, worst "
            f"{settled.max():.3f} mm"
        )
    grown = [run.unnoticed for run in runs]
    print(
        f"undetected growth: worst {max(grown, default=0.0):.2f} mm; above {MAX_UNDETECTED_MM:g} "
        f"mm in {sum(one > MAX_UNDETECTED_MM for one in grown)} runs"
    )
    for run in runs:
        wrong = [stop for stop in run.stops if not stop[3]]
        lost = run.end == "settled" and run.pose_error > 2.0
        lost = lost or run.unnoticed > MAX_UNDETECTED_MM or run.end == "under way"
        if run.wrong_commands or run.too_slow or wrong or lost:
            what = (
                run.wrong_commands[:2]
                + run.too_slow[:2]
                + [f"{t:.2f} s {p} {c}" for t, p, c, _ in wrong]
            )
            print(
                f"  seed {run.seed} ends {run.end}, {run.pose_error:.2f} mm, "
                f"{run.unnoticed:.2f} mm undetected: {what} "
                f"{run.words}\n    {run.disturbances}"
            )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kind", nargs="?", choices=("faults", "none", "short"), default="faults")
    parser.add_argument("runs", nargs="?", type=int)
    parser.add_argument("first", nargs="?", type=int, default=0)
    options = parser.parse_args()
    kind, first = options.kind, options.first
    count = options.runs or (2000 if kind == "faults" else 500)
    runs: list[Run] = []
    try:
        with Pool(initializer=signal.signal, initargs=(signal.SIGINT, signal.SIG_IGN)) as pool:
            seeds = range(first, first + count)
            for run in pool.imap(partial(one, kind=kind), seeds, chunksize=4):
                runs.append(run)
                print(f"\r{len(runs)} of {count}", end="", file=sys.stderr, flush=True)
    except KeyboardInterrupt:
        print("\nstopped; the report covers the finished runs", file=sys.stderr)
    finally:
        report(runs, kind)


if __name__ == "__main__":
    main()
