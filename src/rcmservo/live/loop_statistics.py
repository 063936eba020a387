"""Reports of a live run while it runs, and the timing of its result, collected by a thread."""

import contextlib
import queue
import threading
from dataclasses import dataclass
from multiprocessing.connection import Connection
from types import TracebackType

import numpy as np

from rcmservo.interfaces import Floats, Target
from rcmservo.live.realtime import Realtime
from rcmservo.loop.run_result import LoopTiming, finite_or_none, time_spread
from rcmservo.loop.tick import Tick
from rcmservo.recording.outcome import OutcomeCollector
from rcmservo.servo.servo import Servo

TICKS_PER_REPORT = 10
"""Number of ticks from one report to the next."""


@dataclass(frozen=True, eq=False)
class Report:
    """State of a live run at one tick.

    Parameters
    ----------
    time : int
        Time since the start of the run, ns.
    words : str
        Phase, cause and remedy.
    delta : Floats
        Feature error Δy (3,) in rad, px, px.
    condition : float
        Condition number of the scaled Ĵ.
    """

    time: int
    words: str
    delta: Floats
    condition: float


class ReportThread:
    """Thread that collects data for the result from the ticks, and sends reports.

    Parameters
    ----------
    servo : Servo
        Servo of the run.
    target : Target
        Its target.
    listener : Connection
        Pipe to the receiver of the reports.
    """

    def __init__(self, servo: Servo, target: Target, listener: Connection) -> None:
        self.judge = OutcomeCollector(servo, target)
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
            if len(self._times) % TICKS_PER_REPORT == 1:
                self._report(tick)

    def _collect(self, tick: Tick) -> None:
        self.judge.add(tick)
        self._moments.append(tick.observation.now)
        self._times.append(tick.time)
        if tick.observation.frame > self._frame:
            self._frame = tick.observation.frame
            self._latencies.append(tick.state.monitor.latency)

    def _report(self, tick: Tick) -> None:
        state = tick.state
        with contextlib.suppress(OSError):
            self._listener.send(Report(tick.time, state.text, state.delta, state.condition))

    def timing(self, lateness: Floats, system: Realtime) -> LoopTiming:
        """Return the timing of the loop.

        Parameters
        ----------
        lateness : Floats
            Delay (N,) of each tick after its due time, ns.
        system : Realtime
            Results of the requests to the operating system.
        """
        count = len(self._times)
        span = self._moments[-1] - self._moments[0] if count > 1 else np.nan
        return LoopTiming(
            ticks=count,
            missed=round(self._times[-1] * self._rate * 1e-9) + 1 - count if count else 0,
            rate_hz=finite_or_none((count - 1) / span * 1e9),
            lateness_ms=time_spread(lateness[:count]),
            latency_ms=time_spread(np.array(self._latencies, dtype=float)),
            collections=system.collections,
            refused=system.refused,
        )
