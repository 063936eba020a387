"""Time series of the page: samples of the loop's last seconds.

A sample holds the values of the newest tick of its interval. The lateness of the loop is relative
to the earliest tick of the session, whose own lateness is unknown; a sample holds the largest
lateness of its interval.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rcmservo.geometry.features import compute_features_and_error
from rcmservo.interfaces import Floats

SAMPLE_PERIOD_NS = 100_000_000
"""Time between samples in ns."""
MAX_SAMPLES = 300
"""Number of samples that are stored."""
MIN_EXPOSURE_GAP_NS = 20_000_000
"""Shortest time (ns) between two exposures for which a rate is computed from their difference."""

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
"""Fields of a sample: s, rad, px, px, mm/s, 1, rad/s, px/s, px/s, rad/s, px/s, px/s, ms."""

TickColumns = dict[str, Any]


@dataclass
class Curves:
    """Newest samples.

    Parameters
    ----------
    count : int
        Number of samples since the start of the page.
    samples : deque[list[float]]
        Newest samples, each with the fields `SAMPLE_FIELDS`.
    _start : int or None
        Time 0 of the loop in ns on its clock, if its earliest tick was not late.
    _due : int
        Due time of the newest tick in ns from the start.
    _late : int
        Largest lateness since the last sample in ns.
    _next : int
        Time in ns of the next sample.
    _previous : TickColumns or None
        Tick of the last sample.
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
        """Prepare for another session, which has another schedule."""
        self._start, self._late, self._next, self._previous = None, 0, 0, None

    def add(self, tick: TickColumns) -> None:
        """Add a tick with its due time `time`."""
        now = int(tick["now"][0])
        if tick["time"] < self._due:  # another loop, such as the wait for Enable before it
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
        """Return ẏ as Ĵ predicts it from the motion of marker 1, and as it is measured, each (3,).

        Both are computed about the same imaged RCM, so that a change of its estimate is not a
        motion. They are NaN without an earlier sample.
        """
        previous, unknown = self._previous, np.full(3, np.nan)
        elapsed = 0 if previous is None else int(tick["exposure"][0] - previous["exposure"][0])
        if previous is None or elapsed < MIN_EXPOSURE_GAP_NS:
            return unknown, unknown
        predicted: Floats = np.reshape(previous["J_hat"], (3, 3)) @ (tick["p1"] - previous["p1"])
        points, earlier = np.reshape(tick["points"], (2, 2)), np.reshape(previous["points"], (2, 2))
        measured_change: Floats = compute_features_and_error(points, earlier, tick["o_c"])[1]
        return predicted / (elapsed * 1e-9), measured_change / (elapsed * 1e-9)

    def after(self, count: int) -> list[list[float]]:
        """Return the stored samples after the sample with index `count`."""
        new = min(max(self.count - count, 0), len(self.samples))
        return list(self.samples)[len(self.samples) - new :]
