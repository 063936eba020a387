"""Stopping time of the arm and completeness of the record after a servo process is killed.

    python benchmarks/kill.py [--count N]

One simulated arm and camera run throughout. N servo processes, one after the other, are killed
(SIGKILL), stopped (SIGSTOP), or stopped without a supervisor and continued 0.2 s later (SIGCONT),
each at a random tick. All times come from the log of the device, with one row per millisecond. The
exit code is 1 if a trial exceeds a limit.
"""

import argparse
import contextlib
import os
import signal
import sys
import tempfile
import time
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

import numpy as np

import rcmservo as rs
from rcmservo.config.rig_file import RigDescription
from rcmservo.hardware.device_kinds import prepare_tracker
from rcmservo.live.servo_process import Session
from rcmservo.live.supervisor import ServoProcess, supervise
from rcmservo.loop.run_result import RunResult
from rcmservo.recording import reader
from rcmservo.sim.processes.lab_processes import SimulatedLab
from rcmservo.sim.processes.motion_log import find_stop
from rcmservo.sim.rig_file import read_rig_settings
from rcmservo.tracking import ColourMarkers

OFF_TIME_MS = 60.0  # from the signal until the drive is off: timeout of the watchdog and one period
REST_RATES = np.array([1e-3, 1e-3, 0.1])  # rad/s, rad/s, mm/s below which a joint is at rest
MAX_LOST_MS = 200.0  # end of the run that may be missing in the record
DEADLINE_S = 30.0  # time within which a trial must start
KINDS = ("SIGKILL", "SIGSTOP", "SIGCONT")


class NotBegun(Exception):
    """Raised if the servo does not reach the tick of the signal."""


@dataclass(frozen=True)
class Trial:
    """Result of one trial, with times in ms.

    Parameters
    ----------
    kind : str
        Signal.
    tick : int
        Tick of the signal.
    off : float
        Time from the signal until the drive was off.
    after : float
        Time from the newest valid command until the drive was off.
    still : float
        Time from the signal until the joints were at rest.
    lost : float
        Time from the end of the record to the newest valid command.
    speed : Any
        Joint rates (3,) at the signal.
    moved : bool
        True if a joint moved or the drive was on later.
    words : str
        Cause that the supervisor or the servo reports.
    """

    kind: str
    tick: int
    off: float
    after: float
    still: float
    lost: float
    speed: Any
    moved: bool
    words: str

    @property
    def passed(self) -> bool:
        is_reported = self.kind == "SIGCONT" or (
            "servo process was" in self.words and "drive went off" in self.words
        )
        in_time = self.off <= OFF_TIME_MS and self.lost <= MAX_LOST_MS
        return in_time and not self.moved and is_reported


def prepare() -> None:
    """Load all compiled functions."""
    lab = RigDescription()
    rs.Servo(mechanism=lab.mechanism, tool=lab.tool, gate=lab.gate).warm_up()
    ColourMarkers(lab.markers).find(rs.Frame(0, 0, 0, image=np.zeros((480, 640, 3), np.uint8)))


def trial(bench: SimulatedLab, session: Session, record: Path, kind: str, tick: int) -> Trial:
    first = bench.log.count
    child = ServoProcess(session, get_context("forkserver"))
    try:
        until(lambda: child.heartbeat.value >= tick - 1, child)
        struck = time.monotonic_ns()
        os.kill(child.process.pid, signal.SIGKILL if kind == "SIGKILL" else signal.SIGSTOP)
        if kind == "SIGCONT":
            time.sleep(0.2)
            os.kill(child.process.pid, signal.SIGCONT)
            words = awaken(child)
            time.sleep(0.1)
        else:
            words = supervise(child, bench.switch_off).cause
    finally:
        child.end()
    return judged(kind, tick, struck, words, bench.log.since(first), record)


def until(condition: Any, child: ServoProcess) -> None:
    """Wait for a condition, and read the messages of the servo process meanwhile."""
    end = time.monotonic() + DEADLINE_S
    while not condition():
        if time.monotonic() > end or child.process.exitcode is not None:
            raise NotBegun("no tick in time")
        wait([child.pipe], 0.001)
        while child.pipe.poll():
            said = child.pipe.recv()
            if isinstance(said, str | RunResult | Exception):
                raise NotBegun(said.cause if isinstance(said, RunResult) else str(said))


def awaken(child: ServoProcess) -> str:
    """Return the cause that a continued servo process reports."""
    while child.pipe.poll(DEADLINE_S):
        said = child.pipe.recv()
        if isinstance(said, RunResult):
            return said.cause
    raise SystemExit("the continued servo process reports no result")


def judged(kind: str, tick: int, struck: int, words: str, rows: Any, path: Path) -> Trial:
    stop = find_stop(rows)
    if stop is None:
        raise SystemExit(f"trial at tick {tick}: the drive is still on")
    taken, off = (int(rows["wall"][i]) for i in stop)
    speed = np.diff(rows["q"], axis=0) / 1e-3
    moving = np.flatnonzero((np.abs(speed) > REST_RATES).any(axis=1))
    still = int(rows["wall"][min(moving[-1] + 1, len(rows) - 1)]) if len(moving) else off
    awake = rows["enabled"][stop[1] :].any() or rows["applied"][stop[1] :].any()
    moved = bool(awake or (np.abs(speed[stop[1] + 50 :]) > REST_RATES).any())
    recorded_ticks = len(reader.read_record(path).time)
    return Trial(
        kind,
        tick,
        off=(off - struck) * 1e-6,
        after=(off - taken) * 1e-6,
        still=(still - struck) * 1e-6,
        lost=max(int(rows["number"][-1]) - recorded_ticks, 0) * 10.0,
        speed=np.abs(speed[np.searchsorted(rows["wall"], struck) - 1]),
        moved=moved,
        words=words,
    )


def report(trials: list[Trial]) -> None:
    for kind in KINDS:
        some = [t for t in trials if t.kind == kind]
        if some:
            print(f"{kind} ({len(some)} trials)")
            for name in ("off", "after", "still", "lost"):
                values = [getattr(t, name) for t in some]
                print(
                    f"  {name:<6} median {np.median(values):6.1f} ms   max {np.max(values):6.1f} ms"
                )
            moving = sum(bool((t.speed > REST_RATES).any()) for t in some)
            print(f"  in motion at the signal: {moving}")
            print(f"  e.g. {some[-1].words}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    get_context("forkserver").set_forkserver_preload(["__main__"])
    random, lab = np.random.default_rng(chosen.seed), RigDescription()
    servo = rs.Servo(mechanism=lab.mechanism, tool=lab.tool, gate=lab.gate)
    trials: list[Trial] = []
    with (
        tempfile.TemporaryDirectory() as folder,
        SimulatedLab(chosen.seed, read_rig_settings(lab)) as bench,
        contextlib.suppress(KeyboardInterrupt),
    ):
        while len(trials) < chosen.count:
            kind = KINDS[2 if len(trials) % 4 == 3 else len(trials) % 2]
            record = Path(folder) / "record.mcap"
            session = bench.session(servo, prepare_tracker(lab), 60.0, record, frames=30)
            try:
                trials.append(trial(bench, session, record, kind, int(random.integers(1, 300))))
            except NotBegun as why:
                print(f"not started: {why}", flush=True)
                continue
            finally:
                record.unlink(missing_ok=True)
            if not trials[-1].passed:
                print(f"trial {len(trials)}: {trials[-1]}", flush=True)
            if len(trials) % 20 == 0:
                print(f"{len(trials)} trials, load {os.getloadavg()[0]:.1f}", flush=True)
    report(trials)
    bad = sum(not t.passed for t in trials)
    print(f"{len(trials)} trials, {bad} exceed a limit")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
elif __name__ == "__mp_main__":
    prepare()  # in the process from which all servos are forked
