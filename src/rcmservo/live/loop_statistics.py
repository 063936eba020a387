"""Reports of a live run while it runs, and statistics of its loop, both made by one thread."""

import contextlib
import queue
import threading
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Self

import numpy as np

from rcmservo.interfaces import Floats, Target
from rcmservo.live.realtime import Realtime
from rcmservo.loop.pixel_precision import describe_precision
from rcmservo.loop.run_result import LoopTiming, finite_or_none, time_spread
from rcmservo.loop.tick import Tick
from rcmservo.recording.outcome import OutcomeCollector
from rcmservo.safety.state_machine import Phase
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
    text : str
        Phase, cause and remedy as one text; while servoing the precision of the image as well.
    delta : Floats
        Feature error Δy (3,) in rad, px, px.
    condition : float
        Condition number of the scaled Ĵ.
    """

    time: int
    text: str
    delta: Floats
    condition: float


class ReportThread:
    """Thread that collects the ticks of a run, sends reports, and computes the loop's timing.

    Parameters
    ----------
    servo : Servo
        Servo of the run.
    target : Target
        Target of the run.
    receiver : Connection
        Pipe to the receiver of the reports.
    """

    def __init__(self, servo: Servo, target: Target, receiver: Connection) -> None:
        self.outcome = OutcomeCollector(servo, target)
        self._rate, self._receiver = servo.rate, receiver
        self._observed_ns: list[int] = []
        self._times_ns: list[int] = []
        self._latencies_ns: list[int] = []
        self._newest_frame = -1
        self._tool, self._precision = servo.tool, ""
        self._ticks: queue.SimpleQueue[Tick | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._process_ticks, name="reports", daemon=True)
        self.put = self._ticks.put
        """Function that adds a tick. It does not wait."""

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._ticks.put(None)
        self._thread.join()

    def _process_ticks(self) -> None:
        for tick in iter(self._ticks.get, None):
            self._collect(tick)
            if len(self._times_ns) % TICKS_PER_REPORT == 1:
                state = tick.state
                text = self._describe_tick(tick)
                report = Report(tick.time, text, state.delta, state.condition)
                with contextlib.suppress(OSError):  # the receiver may be gone
                    self._receiver.send(report)

    def _describe_tick(self, tick: Tick) -> str:
        """Return phase, cause and remedy, and the precision of the image while servoing."""
        state = tick.state
        if state.explored and not self._precision:
            self._precision = describe_precision(state, self._tool)
        is_servoing = state.phase is Phase.SERVO and self._precision
        return f"{state.text}; {self._precision}" if is_servoing else state.text

    def _collect(self, tick: Tick) -> None:
        self.outcome.add(tick)
        self._observed_ns.append(tick.observation.now)
        self._times_ns.append(tick.time)
        if tick.observation.frame > self._newest_frame:
            self._newest_frame = tick.observation.frame
            self._latencies_ns.append(tick.state.monitor.latency)

    def compute_timing(self, lateness_ns: Floats, system: Realtime) -> LoopTiming:
        """Return the timing of the loop.

        Parameters
        ----------
        lateness_ns : Floats
            Delay (N,) of each tick after its due time, ns.
        system : Realtime
            Results of the requests to the operating system.
        """
        count = len(self._times_ns)
        span_ns = self._observed_ns[-1] - self._observed_ns[0] if count > 1 else np.nan
        due_count = round(self._times_ns[-1] * self._rate * 1e-9) + 1 if count else 0
        return LoopTiming(
            ticks=count,
            missed=due_count - count,
            rate_hz=finite_or_none((count - 1) / span_ns * 1e9),
            lateness_ms=time_spread(lateness_ns[:count]),
            latency_ms=time_spread(np.array(self._latencies_ns, dtype=float)),
            collections=system.collections,
            refused=system.refused,
        )
