"""What a live run tells: reports on the way, and its result at the end. A thread beside the loop
collects both."""

import contextlib
import queue
import threading
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from types import TracebackType

import numpy as np

from rcmservo.interfaces import Floats, Target
from rcmservo.live.lab import CameraAccount
from rcmservo.live.realtime import Realtime
from rcmservo.loop.tick import Tick
from rcmservo.record.verdict import Judge, Outcome
from rcmservo.servo.servo import Servo

EVERY = 10
"""Ticks from one report to the next."""


@dataclass(frozen=True, eq=False)
class Report:
    """How the loop stands."""

    time: int
    """ns since its start."""
    words: str
    """Phase, cause and way out."""
    delta: Floats
    """The error Δy (3,)."""
    condition: float
    """That of the scaled Ĵ."""


@dataclass(frozen=True)
class Spread:
    """How a time was spread over a run: NaN where it never came up."""

    median: float = np.nan
    """ms."""
    p99: float = np.nan
    """ms, 99 % were no longer."""
    max: float = np.nan
    """ms, the longest."""


@dataclass(frozen=True)
class LoopTiming:
    """How the loop kept its time."""

    ticks: int
    """How many there were."""
    missed: int
    """Those that the loop was not there to begin."""
    rate: float
    """Hz, the mean."""
    lateness: Spread
    """From when a tick was due until it began."""
    latency: Spread
    """From a frame's exposure to the command that it led to."""
    collections: int
    """How often the collection of garbage stopped the process."""
    refused: list[str] = field(default_factory=list[str])
    """What the operating system would not do, in sentences."""


@dataclass(frozen=True, eq=False)
class LiveResult:
    """What became of a live run."""

    outcome: Outcome
    """The verdict."""
    target: Target | None = None
    """What it last went to."""
    not_recorded: str = ""
    """Why the record could not be written, empty if it could."""
    timing: LoopTiming | None = None
    """How the loop kept its time; None where its process came to no end."""
    why_off: str = ""
    """Why the arm's drive went off by itself, if it did and the arm tells."""
    camera: CameraAccount | None = None
    """What became of the camera's frames, if it keeps account of them."""


class ReportThread:
    """A thread that takes the ticks from the loop, collects what the result needs, and sends
    reports."""

    def __init__(self, servo: Servo, target: Target, listener: Connection) -> None:
        self.judge, self.target = Judge(servo, target), target
        self._rate, self._listener = servo.rate, listener
        self._moments: list[int] = []
        self._times: list[int] = []
        self._latencies: list[int] = []
        self._ticks: queue.SimpleQueue[Tick | None] = queue.SimpleQueue()
        self._frame = -1
        self._thread = threading.Thread(target=self._work, name="reports", daemon=True)
        self.put = self._ticks.put

    def __enter__(self) -> "ReportThread":
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._ticks.put(None)
        self._thread.join()

    def _work(self) -> None:
        for tick in iter(self._ticks.get, None):
            self._collect(tick)
            if len(self._times) % EVERY == 1:
                self._report(tick)

    def _collect(self, tick: Tick) -> None:
        self.judge.add(tick)
        self.target = tick.state.target or self.target
        self._moments.append(tick.seen.now)
        self._times.append(tick.time)
        if tick.seen.frame > self._frame:
            self._frame = tick.seen.frame
            self._latencies.append(tick.state.watch.latency)

    def _report(self, tick: Tick) -> None:
        state = tick.state
        with contextlib.suppress(OSError):
            self._listener.send(Report(tick.time, state.words, state.delta, state.condition))

    def timing(self, lateness: Floats, system: Realtime) -> LoopTiming:
        """How the loop kept its time, given how late (ns) its waits ended."""
        count = len(self._times)
        span = self._moments[-1] - self._moments[0] if count > 1 else np.nan
        return LoopTiming(
            ticks=count,
            missed=round(self._times[-1] * self._rate * 1e-9) + 1 - count if count else 0,
            rate=(count - 1) / span * 1e9,
            lateness=_spread(lateness[:count]),
            latency=_spread(np.array(self._latencies, dtype=float)),
            collections=system.collections,
            refused=system.refused,
        )


def _spread(ns: Floats) -> Spread:
    return (
        Spread(*(float(np.percentile(ns, p)) * 1e-6 for p in (50, 99, 100)))
        if len(ns)
        else Spread()
    )
