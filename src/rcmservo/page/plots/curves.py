"""What the page draws over time: the loop's last seconds, thinned.

A sample tells the newest tick of its interval. How late the loop is counts from the earliest tick
of the session, whose own lateness nobody tells; of it a sample holds the interval's worst.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rcmservo.geometry.features import measured
from rcmservo.interfaces import Floats

SAMPLE_PERIOD_NS = 100_000_000
"""ns from sample to sample."""
MAX_SAMPLES = 300
"""Samples that are kept."""
MIN_EXPOSURE_GAP_NS = 20_000_000
"""ns between two exposures from which on a rate is told by their difference."""

SAMPLE_FIELDS = (
    "t",
    "delta_s",
    "delta_r",
    "delta_d",
    "speed",
    "condition",
    "predicted_s",
    "predicted_r",
    "predicted_d",
    "measured_s",
    "measured_r",
    "measured_d",
    "late",
)
"""Of a sample's numbers: s, rad, px, mm/s, 1, rad/s, px/s, ms."""

TickColumns = dict[str, Any]


@dataclass
class Curves:
    """The samples there are.

    Parameters
    ----------
    count : int
        How many there have been.
    samples : deque[list[float]]
        The last of them, each as `NAMES` has it.
    _start : int or None
        ns on the loop's clock of its time 0, were its earliest tick not late at all.
    _due : int
        ns from the start to when the newest tick was due.
    _late : int
        ns, the worst lateness since the last sample.
    _next : int
        ns from which on the next sample is taken.
    _before : Tick or None
        The tick of the last sample.
    """

    count: int = 0
    samples: deque[list[float]] = field(
        default_factory=lambda: deque[list[float]](maxlen=MAX_SAMPLES)
    )
    _start: int | None = None
    _due: int = 0
    _late: int = 0
    _next: int = 0
    _previous: TickColumns | None = None

    def restart(self) -> None:
        """Another session: its schedule is another one."""
        self._start, self._late, self._next, self._previous = None, 0, 0, None

    def add(self, tick: TickColumns) -> None:
        """A tick, with the `time` at which it was due."""
        now = int(tick["now"][0])
        if tick["time"] < self._due:  # another loop, such as the wait for the drive before it
            self._start = None
        self._due = tick["time"]
        begun = now - tick["time"]
        self._start = begun if self._start is None else min(begun, self._start)
        self._late = max(self._late, begun - self._start)
        if now < self._next:
            return
        self._next = now + SAMPLE_PERIOD_NS
        rates = np.concatenate(self._rates(tick))
        v: Floats = tick["v"]
        numbers = [np.linalg.norm(v), tick["condition"][0], *rates, self._late * 1e-6]
        self.samples.append([now * 1e-9, *tick["delta"], *map(float, numbers)])
        self.count, self._late, self._previous = self.count + 1, 0, tick

    def _rates(self, tick: TickColumns) -> tuple[Floats, Floats]:
        """ẏ as Ĵ tells it of marker 1's motion since the sample before, and as it was seen: both
        times about the same imaged RCM, whose own changes are no motion.
        """
        previous, unknown = self._previous, np.full(3, np.nan)
        elapsed = 0 if previous is None else int(tick["exposure"][0] - previous["exposure"][0])
        if previous is None or elapsed < MIN_EXPOSURE_GAP_NS:
            return unknown, unknown
        predicted: Floats = np.reshape(previous["J_hat"], (3, 3)) @ (tick["p1"] - previous["p1"])
        points, previous_points = (
            np.reshape(tick["points"], (2, 2)),
            np.reshape(previous["points"], (2, 2)),
        )
        measured_change: Floats = measured(points, previous_points, tick["o_c"])[1]
        return predicted / (elapsed * 1e-9), measured_change / (elapsed * 1e-9)

    def after(self, count: int) -> list[list[float]]:
        """The samples after the `count`-th that are still there."""
        new = min(max(self.count - count, 0), len(self.samples))
        return list(self.samples)[len(self.samples) - new :]
