"""Reaction to a broken connection between servo and emulated controller during a motion.

    python benchmarks/cable.py [--count N] [--camera gige|mjpeg]

An independent connection reads the positions of the axes and the state of the motors. Limits: axes
at rest and motors off within 100 ms, unchanged half a second later, and the servo in FAULT with an
expected cause. The exit code is 1 if a trial exceeds a limit.

    closed    both connections are closed
    silence   no bytes pass any more
    garbage   random bytes pass in both directions
    stopped   the servo process is stopped (SIGSTOP) and continues 0.3 s later (SIGCONT)
    foreign   a second host jogs the axes at a different speed
"""

import argparse
import contextlib
import os
import random
import selectors
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from pathlib import Path

import numpy as np
from emulated_lab import COUNTS, EmulatedLab, Host

import rcmservo as rs
from rcmservo.config.rig_file import RigDescription
from rcmservo.interfaces import Floats
from rcmservo.live.child_process import ChildProcess, receive_from_parent
from rcmservo.live.loop_statistics import Report
from rcmservo.live.realtime import apply_realtime_settings
from rcmservo.live.servo_process import Session
from rcmservo.live.supervisor import ServoProcess
from rcmservo.loop.run_result import RunResult
from rcmservo.recording.reader import read_record
from rcmservo.safety.state_machine import Phase

STOP_TIME_MS = 100.0
"""Largest time (ms) from the event until the axes are at rest and the motors off."""
OBSERVATION_S = 0.6
"""Time (s) after the event during which the arm is observed."""
MIN_SPEED_FRACTION = 0.1
"""Smallest speed of the fastest joint at the event, as a fraction of its limit."""
LEVER_MM = 150.0, 150.0, 1.0
"""Approximate motion (mm) of a marker per rad, rad or mm of a joint."""
DEADLINE_S = 60.0
"""Time (s) within which a trial must start."""
SILENT, OFF = "the arm has not answered", "the arm's drive is off"
CAUSES = {
    "closed": (SILENT, OFF),
    "silence": (SILENT,),
    "garbage": (SILENT, OFF),
    "stopped": (OFF, SILENT, "the loop ran late"),
    "foreign": (OFF,),
}
"""Expected causes by kind of event; a stopped process detects several at the same time."""


def pass_on(port: int, control: Connection) -> None:
    """Forward bytes in a separate process; `control` reports the port and receives events.

    The message "end" ends the process.
    """
    with apply_realtime_settings():
        cable = Cable(port)
        control.send(cable.port)
        said = ""
        while said != "end":
            cable.turn(said)
            said = receive_from_parent(control) if control.poll() else said
    cable.part()


class Cable:
    """Proxy between driver and controller that simulates faults of the connection."""

    def __init__(self, port: int) -> None:
        self._to, self._chance = port, random.Random(0)
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listening.getsockname()[1])
        self._eyes, self._other = selectors.DefaultSelector(), dict[socket.socket, socket.socket]()
        self._eyes.register(self._listening, selectors.EVENT_READ)

    def turn(self, kind: str) -> None:
        """Forward the bytes of the next 2 ms, with the fault `kind` if it is not empty."""
        if kind == "closed":
            self.part()
        for key, _ in self._eyes.select(0.002):
            wire = key.fileobj
            assert isinstance(wire, socket.socket)
            if wire is self._listening:
                self._connect(kind)
            elif wire in self._other:
                self._pass_on(wire, kind)

    def part(self) -> None:
        """Close all connections."""
        for wire in list(self._other):
            self._cut(wire)

    def _connect(self, kind: str) -> None:
        host, _ = self._listening.accept()
        if kind:
            host.close()
            return
        device = socket.create_connection(("127.0.0.1", self._to))
        for wire, other in ((host, device), (device, host)):
            wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._other[wire] = other
            self._eyes.register(wire, selectors.EVENT_READ)

    def _pass_on(self, wire: socket.socket, kind: str) -> None:
        with contextlib.suppress(OSError):
            data = wire.recv(4096)
            if data and kind != "silence":
                garbage = kind == "garbage"
                self._other[wire].sendall(self._chance.randbytes(len(data)) if garbage else data)
            if data:
                return
        self._cut(wire)

    def _cut(self, wire: socket.socket) -> None:
        for one in (wire, self._other.get(wire)):
            if one in self._other:
                del self._other[one]
                self._eyes.unregister(one)
                one.close()


@dataclass(frozen=True)
class CableTrial:
    """Result of one trial.

    Parameters
    ----------
    kind : str
        Kind of the event.
    still : float
        Time (ms) until the axes were at rest.
    off : float
        Time (ms) until the motors were off.
    speed : Floats
        Joint rates (3,) in rad/s, rad/s, mm/s at the event.
    moved : bool
        True if an axis moved or a motor was on later.
    phase : str
        Last phase of the servo.
    words : str
        Last message of the servo.
    """

    kind: str
    still: float
    off: float
    speed: Floats
    moved: bool
    phase: str
    words: str

    @property
    def passed(self) -> bool:
        is_reported = any(cause in self.words for cause in CAUSES[self.kind])
        stopped = max(self.still, self.off) <= STOP_TIME_MS and not self.moved
        return stopped and is_reported and self.phase == Phase.FAULT.name


class Words:
    """Messages of the servo process, read in the background of a trial."""

    def __init__(self, child: ServoProcess) -> None:
        self.child, self.last, self.ended = child, "", False

    def hear(self, seconds: float = 0.0) -> None:
        wait([self.child.pipe], seconds)
        while not self.ended and self.child.pipe.poll():
            try:
                said = self.child.pipe.recv()
            except (EOFError, OSError):
                self.ended = True
                return
            if isinstance(said, Report):
                self.last = said.text
            else:
                self.ended = True
                self.last = said.cause if isinstance(said, RunResult) else str(said)


def trigger(kind: str, cable: ChildProcess, child: ServoProcess, port: int) -> Callable[[], None]:
    """Trigger an event; return the function that ends it."""
    if kind == "stopped":
        assert child.process.pid is not None
        os.kill(child.process.pid, signal.SIGSTOP)
        return lambda: os.kill(child.process.pid or 0, signal.SIGCONT)
    if kind == "foreign":
        other = Host(port)
        other.ask("JG 12000,-12000,3000")
        return other.close
    cable.send(kind)
    return lambda: None


def trial(
    lab: EmulatedLab, session: Session, record: Path, cable: ChildProcess, kind: str, tick: int
) -> CableTrial:
    child = ServoProcess(session)
    words, moving = Words(child), Host(lab.port)
    try:
        speed = until_moving(words, moving, tick)
        struck = time.monotonic()
        end = trigger(kind, cable, child, lab.port)
        rows: list[tuple[float, Floats, bool]] = []
        ended = False
        while (now := time.monotonic()) < struck + OBSERVATION_S:
            rows.append((now - struck, moving.places(), moving.off()))
            if not ended and now > struck + 0.3:
                ended = True
                end()
        while not words.ended and time.monotonic() < struck + DEADLINE_S:
            words.hear(0.05)
        rows.append((OBSERVATION_S, moving.places(), moving.off()))
    finally:
        child.process.kill()
        child.end()
        moving.close()
    return judged(kind, speed, rows, read_record(record).phase[-1], words.last)


def until_moving(words: Words, host: Host, tick: int) -> Floats:
    """Wait for the tick and for a moving tool; return the joint rates (3,)."""
    begun, fast = time.monotonic(), np.array(RigDescription().gate.speed)
    while time.monotonic() < begun + DEADLINE_S:
        words.hear(0.005)
        if words.ended:
            raise RuntimeError(f"the run ended before the event: {words.last}")
        if words.child.heartbeat.value >= tick:
            speed = host.numbers("TV ABC") / COUNTS
            if (np.abs(speed) > MIN_SPEED_FRACTION * fast).any():
                return speed
    raise RuntimeError(f"the tool did not move within {DEADLINE_S:g} s")


def judged(
    kind: str, speed: Floats, rows: list[tuple[float, Floats, bool]], phase: str, words: str
) -> CableTrial:
    times = [row[0] * 1e3 for row in rows]
    moves = [(np.abs(b[1] - a[1]) > 2.0).any() for a, b in pairwise(rows)]
    still = times[max((k for k, moved in enumerate(moves) if moved), default=-1) + 1]
    off = next((t for t, row in zip(times, rows, strict=True) if row[2]), np.inf)
    later = [row for t, row in zip(times, rows, strict=True) if t > STOP_TIME_MS]
    moved = any(not row[2] or (np.abs(row[1] - later[0][1]) > 2.0).any() for row in later)
    return CableTrial(kind, still, off, speed, bool(moved), phase, words)


def report(trials: list[CableTrial]) -> None:
    for kind in CAUSES:
        some = [t for t in trials if t.kind == kind]
        if some:
            still, off = ([getattr(t, name) for t in some] for name in ("still", "off"))
            speeds = np.abs([t.speed for t in some]) * LEVER_MM
            print(
                f"{kind:8} {len(some):3d} trials, speed {np.median(speeds.max(axis=1)):.0f} mm/s "
                f"(median), {speeds.max():.0f} (max); at rest after {np.median(still):5.1f} ms "
                f"(median), {max(still):5.1f} (max); off after {np.median(off):5.1f} ms (median), "
                f"{max(off):5.1f} (max); e.g. {some[-1].words[:70]}"
            )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--camera", choices=("gige", "mjpeg"), default="gige")
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    chance, lab = np.random.default_rng(chosen.seed), RigDescription()
    servo = rs.Servo(mechanism=lab.mechanism, tool=lab.tool, gate=lab.gate)
    servo.warm_up()
    trials: list[CableTrial] = []
    with (
        tempfile.TemporaryDirectory() as folder,
        EmulatedLab(chosen.seed, chosen.camera) as emulated,
        contextlib.suppress(KeyboardInterrupt),
    ):
        while len(trials) < chosen.count:
            kind = list(CAUSES)[len(trials) % len(CAUSES)]
            record = Path(folder) / f"{time.monotonic_ns()}.mcap"
            cable = ChildProcess(get_context("spawn"), pass_on, emulated.port)
            try:
                session = emulated.session(servo, 60.0, record, cable.receive())
                tick = int(chance.integers(20, 230))
                one = trial(emulated, session, record, cable, kind, tick)
            except RuntimeError as why:
                print(f"not started: {why}", flush=True)
                continue
            finally:
                cable.end()
            trials.append(one)
            if not one.passed:
                print(f"trial {len(trials)}: {one}", flush=True)
            if len(trials) % 10 == 0:
                print(f"{len(trials)} trials", flush=True)
    report(trials)
    bad = sum(not t.passed for t in trials)
    print(f"{len(trials)} trials, {bad} exceed a limit")
    return 1 if bad or len(trials) < chosen.count else 0


if __name__ == "__main__":
    sys.exit(main())
