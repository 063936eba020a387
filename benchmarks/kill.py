"""Servo processes killed and stopped at random ticks: how soon the arm stands still, and what is
left of the record.

    python benchmarks/kill.py [--count N]

One simulated arm and camera keep running; N servo processes, one after the other, are killed
(SIGKILL), stopped (SIGSTOP), or stopped and woken up again 0.2 s later (SIGCONT) with nobody
watching. All times are read from the device's own log, which has a row for every millisecond. Exit
code 1 if one trial breaks a bound.
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
from rcmservo.config.rig_file import Lab
from rcmservo.live.servo_process import Session
from rcmservo.live.supervisor import ServoProcess, supervise
from rcmservo.loop.run_result import RunResult
from rcmservo.recording import reader
from rcmservo.sim.processes.lab_processes import SimulatedLab
from rcmservo.sim.processes.motion_log import find_stop
from rcmservo.sim.rig_file import read_rig_settings
from rcmservo.tracking import ColourMarkers

BOUND = 60.0  # ms from the signal until the drive is off: the watchdog's patience and one period
STILL = np.array([1e-3, 1e-3, 0.1])  # rad/s, rad/s, mm/s below which a joint stands still
LOST = 200.0  # ms of the run's end that may be missing from its record
DEADLINE = 30.0  # s within which a trial must have begun
KINDS = ("SIGKILL", "SIGSTOP", "SIGCONT")


class NotBegun(Exception):
    """A servo that did not get as far as the tick at which it was to be struck."""


@dataclass(frozen=True)
class Trial:
    """Of one trial, ms: ``off`` from the signal, ``after`` from the newest valid command until the
    drive was off; ``still`` from the signal until the joints stood still; ``lost``, how far before
    that command the record ends. ``speed`` (3,) at the signal; ``moved``, whether a joint moved or
    the drive came on again later; ``words``.
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
    def good(self) -> bool:
        told = self.kind == "SIGCONT" or (
            "servo process was" in self.words and "drive went off" in self.words
        )
        return self.off <= BOUND and self.lost <= LOST and not self.moved and told


def prepare() -> None:
    """Load all that is compiled."""
    lab = Lab()
    rs.Servo(mechanism=lab.mechanism, tool=lab.tool, gate=lab.gate).warm_up()
    ColourMarkers(lab.markers).find(rs.Frame(0, 0, 0, image=np.zeros((480, 640, 3), np.uint8)))


def trial(bench: SimulatedLab, session: Session, record: Path, kind: str, tick: int) -> Trial:
    first = bench.log.count
    child = ServoProcess(session, get_context("forkserver"))
    try:
        until(lambda: child.beats.value >= tick - 1, child)
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


def until(good: Any, child: ServoProcess) -> None:
    """Wait for it, taking what the servo process reports meanwhile."""
    end = time.monotonic() + DEADLINE
    while not good():
        if time.monotonic() > end or child.process.exitcode is not None:
            raise NotBegun("no tick in time")
        wait([child.pipe], 0.001)
        while child.pipe.poll():
            said = child.pipe.recv()
            if isinstance(said, str | RunResult | Exception):
                raise NotBegun(said.cause if isinstance(said, RunResult) else str(said))


def awaken(child: ServoProcess) -> str:
    """What a servo process says of its run that was stopped and goes on."""
    while child.pipe.poll(DEADLINE):
        said = child.pipe.recv()
        if isinstance(said, RunResult):
            return said.cause
    raise SystemExit("the servo process that was woken up says nothing")


def judged(kind: str, tick: int, struck: int, words: str, rows: Any, path: Path) -> Trial:
    stop = find_stop(rows)
    if stop is None:
        raise SystemExit(f"trial at tick {tick}: the drive is still on")
    taken, off = (int(rows["wall"][i]) for i in stop)
    speed = np.diff(rows["q"], axis=0) / 1e-3
    moving = np.flatnonzero((np.abs(speed) > STILL).any(axis=1))
    still = int(rows["wall"][min(moving[-1] + 1, len(rows) - 1)]) if len(moving) else off
    awake = rows["enabled"][stop[1] :].any() or rows["applied"][stop[1] :].any()
    moved = bool(awake or (np.abs(speed[stop[1] + 50 :]) > STILL).any())
    kept = len(reader.read_record(path).time)
    return Trial(
        kind,
        tick,
        off=(off - struck) * 1e-6,
        after=(off - taken) * 1e-6,
        still=(still - struck) * 1e-6,
        lost=max(int(rows["number"][-1]) - kept, 0) * 10.0,
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
            print(f"  moving at the signal {sum(bool((t.speed > STILL).any()) for t in some)}")
            print(f"  e.g. {some[-1].words}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    get_context("forkserver").set_forkserver_preload(["__main__"])
    random, lab = np.random.default_rng(chosen.seed), Lab()
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
            session = bench.session(servo, lab.markers, 60.0, record, frames=30)
            try:
                trials.append(trial(bench, session, record, kind, int(random.integers(1, 300))))
            except NotBegun as why:
                print(f"not begun: {why}", flush=True)
                continue
            finally:
                record.unlink(missing_ok=True)
            if not trials[-1].good:
                print(f"trial {len(trials)}: {trials[-1]}", flush=True)
            if len(trials) % 20 == 0:
                print(f"{len(trials)} trials, load {os.getloadavg()[0]:.1f}", flush=True)
    report(trials)
    bad = sum(not t.good for t in trials)
    print(f"{len(trials)} trials, {bad} beyond a bound")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
elif __name__ == "__mp_main__":
    prepare()  # in the process that all servos are forked from
