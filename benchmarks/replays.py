"""Bit-exact replay of a hundred recorded runs with random faults.

    python benchmarks/replays.py [COUNT]

Each run has a random scene, mechanism, tool and estimator, two stages, an operator who pauses and
resumes, and faults in the observations: markers lost, swapped or displaced, frames missing or
dropped, late ticks, a silent arm, joints that are not finite, a drive that switches off, a
recording that fails.
"""

import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import rcmservo as rs
from rcmservo.interfaces import Clock, DropReason
from rcmservo.recording import reader
from rcmservo.recording.replay import ReplayResult, replay_record
from rcmservo.recording.writer import Recorder
from rcmservo.tracking import PointMarkers

Change = Callable[[rs.Observation], rs.Observation]
NAMES = ("points", "swap", "jump", "stop", "silent", "joints", "drive", "recorded", "late")
MILD = ("points", "swap", "jump", "stop", "late")
FRAME = ("frame", "exposure", "arrival", "q_exposure", "points")


class Disturbed(rs.Plant):
    """Plant that modifies its observations."""

    change: Change = staticmethod(lambda seen: seen)

    def read(self) -> rs.Observation:
        return self.change(super().read())


def faults(random: np.random.Generator, clock: Clock, names: tuple[str, ...] = MILD) -> Change:
    """Return a change of observations: bursts of faults separated by pauses."""
    name, held, until, lost = "", None, 0, [0]

    def change(seen: rs.Observation) -> rs.Observation:
        nonlocal name, held, until, lost
        if seen.now >= until:
            quiet = name != ""
            until = seen.now + int(
                random.uniform(3e8, 1.5e9) if quiet else random.uniform(2e7, 6e8)
            )
            name, held, lost = (
                "" if quiet else str(random.choice(names)),
                seen,
                [[0], [1], [0, 1]][random.integers(3)],
            )
        return disturbed(seen, held or seen, name, lost)

    def disturbed(
        seen: rs.Observation, held: rs.Observation, name: str, lost: list[int]
    ) -> rs.Observation:
        points = seen.points.copy()
        points[lost] = np.nan
        if name == "late":
            clock.wait_until(clock.now() + int(random.uniform(1e6, 3e7)))
        changes = {
            "": {},
            "points": {"points": points},
            "swap": {"points": seen.points[::-1].copy()},
            "jump": {"points": seen.points + 30.0},
            "stop": {n: getattr(held, n) for n in FRAME}
            | {"drop_reason": list(DropReason)[held.now % 4]},
            "silent": {"q": held.q, "q_time": held.q_time},
            "joints": {"q": np.array([np.nan, 1.0, 60.0])},
            "drive": {"enabled": False},
            "recorded": {"recorded": False},
            "late": {"now": clock.now()},
        }
        return replace(seen, **changes[name])

    return change


def operator(tick: rs.Tick) -> rs.Request:
    """Operator who requests a pause after 1 s, resumes after pauses and clears faults."""
    if tick.state.phase is rs.Phase.PAUSED and not tick.state.command.rates.any():
        return rs.Request.RESUME
    if tick.state.phase is rs.Phase.FAULT:
        return rs.Request.CLEAR
    return rs.Request.PAUSE if tick.time == 1_000_000_000 else rs.Request.NONE


def recorded(folder: Path, seed: int, duration: float, names: tuple[str, ...] = MILD) -> Path:
    """Record a random run of two stages; return the path of the record."""
    random = np.random.default_rng(seed)
    mechanism = [rs.SphericalRcm(), rs.PitchYawRcm()][random.integers(2)]
    tool = [rs.RigidTool(spacing=30.0), rs.ScaledTool(scale=1.3)][random.integers(2)]
    estimator = [rs.ProjectionEstimator(), rs.FlowEstimator(gamma=0.05), rs.BroydenEstimator()][
        random.integers(3)
    ]
    rig = rs.sim.Rig(seed, replace(rs.sim.RigSettings(), mechanism=mechanism), pictures=False)
    plant = Disturbed(rig.arm, rig.camera, PointMarkers(), rig.clock)
    servo = rs.Servo(mechanism=mechanism, tool=tool, estimator=estimator)
    path, state = folder / f"{seed}.mcap", None
    with Recorder(path, {"seed": seed}) as recorder:
        for _ in range(2):
            plant.change = Disturbed.change
            rig.move_to_target()
            target = rs.teach(plant, frames=5)
            rig.go_home()
            plant.change = faults(random, rig.clock, names)
            recorder.begin(servo, target, state)
            for tick in rs.servo_ticks(
                plant, servo, target, duration, state=state, operator=operator
            ):
                recorder.write(tick)
            state = tick.state
    return path


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    causes: Counter[str] = Counter()
    other: list[ReplayResult] = []
    ticks, seconds = 0, 0.0
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(count):
            path = recorded(Path(folder), seed, 8.0, NAMES if seed % 2 else MILD)
            started = time.perf_counter()
            again = replay_record(path)
            seconds += time.perf_counter() - started
            ticks += len(again.recorded.time)
            causes.update({cause for cause in reader.read_record(path).cause if cause != "NONE"})
            if not again.same:
                other.append(again)
                print(f"seed {seed}: {again.sentence}")
    seen = ", ".join(f"{cause} {runs}" for cause, runs in causes.most_common())
    print(f"{count} records, {ticks} ticks: {count - len(other)} are equal, bit for bit")
    print(f"{seconds / ticks * 1e6:.0f} us per tick; number of runs by cause: {seen}")
    sys.exit(bool(other))


if __name__ == "__main__":
    main()
