"""Time series of the page: samples of the servo loop's last 30 s.

A sample holds the values of one tick and the largest lateness of all ticks since the previous
sample. The lateness of a tick, in ms, is relative to the earliest tick of the session, whose own
lateness is unknown.
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
"""Fields of a sample, in s, rad, px, px, mm/s, 1, rad/s, px/s, px/s, rad/s, px/s, px/s, ms."""

TickColumns = dict[str, Any]
"""Values of a tick by their names in a record, and its due time `time` in ns."""


@dataclass
class Curves:
    """Newest samples.

    Parameters
    ----------
    count : int
        Number of samples since the start of the page.
    samples : deque[list[float]]
        Newest samples, each with the fields `SAMPLE_FIELDS`.
    _start_ns : int or None
        Start of the loop in ns on its clock, if its earliest tick was not late.
    _due_ns : int
        Due time of the newest tick in ns from the start.
    _lateness_ns : int
        Largest lateness since the last sample in ns.
    _next_sample_ns : int
        Time in ns of the next sample.
    _previous : TickColumns or None
        Tick of the last sample.
    """

    count: int = 0
    samples: deque[list[float]] = field(
        default_factory=lambda: deque[list[float]](maxlen=MAX_SAMPLES)
    )
    _start_ns: int | None = None
    _due_ns: int = 0
    _lateness_ns: int = 0
    _next_sample_ns: int = 0
    _previous: TickColumns | None = None

    def restart(self) -> None:
        """Prepare for another session, which has another schedule."""
        self._start_ns, self._lateness_ns, self._next_sample_ns = None, 0, 0
        self._previous = None

    def add(self, tick: TickColumns) -> None:
        """Add a tick. It becomes a sample if the last sample is `SAMPLE_PERIOD_NS` old."""
        now_ns, due_ns = int(tick["now"][0]), int(tick["time"])
        if due_ns < self._due_ns:  # another loop, such as the wait for Enable before it
            self._start_ns = None
        self._due_ns = due_ns
        start_ns = now_ns - due_ns
        self._start_ns = start_ns if self._start_ns is None else min(start_ns, self._start_ns)
        self._lateness_ns = max(self._lateness_ns, start_ns - self._start_ns)
        if now_ns < self._next_sample_ns:
            return
        self._next_sample_ns = now_ns + SAMPLE_PERIOD_NS
        v: Floats = tick["v"]
        speed = float(np.linalg.norm(v))
        numbers = speed, tick["condition"][0], *self._compute_rates(tick), self._lateness_ns * 1e-6
        self.samples.append([now_ns * 1e-9, *tick["delta"], *map(float, numbers)])
        self.count, self._lateness_ns, self._previous = self.count + 1, 0, tick

    def _compute_rates(self, tick: TickColumns) -> Floats:
        """Return ẏ = Ĵ ṗ₁ as predicted from the motion of marker 1, and ẏ as measured, (6,).

        Both are computed about the same imaged RCM, so that a change of its estimate is not a
        motion. They are NaN without an earlier sample.
        """
        previous = self._previous
        if previous is None:
            return np.full(6, np.nan)
        elapsed_ns = int(tick["exposure"][0] - previous["exposure"][0])
        if elapsed_ns < MIN_EXPOSURE_GAP_NS:
            return np.full(6, np.nan)
        J_hat = np.reshape(previous["J_hat"], (3, 3))
        points, earlier = (np.reshape(row["points"], (2, 2)) for row in (tick, previous))
        measured: Floats = compute_features_and_error(points, earlier, tick["o_c"])[1]
        change = np.concatenate([J_hat @ (tick["p1"] - previous["p1"]), measured])
        return change / (elapsed_ns * 1e-9)

    def after(self, count: int) -> list[list[float]]:
        """Return the stored samples after the first `count` ones since the start of the page."""
        new_count = min(max(self.count - count, 0), len(self.samples))
        return list(self.samples)[len(self.samples) - new_count :]
