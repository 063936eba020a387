"""What a simulated arm did, millisecond by millisecond, in memory that its camera and its judge
share with it.

It is no `SharedRing`: readers index rows by time and take tens of thousands as one array, which
copies and checksums of single entries would make slow.
"""

from multiprocessing.context import BaseContext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcmservo.interfaces import Floats
from rcmservo.sim.rig import RigSettings
from rcmservo.sim.tool_body import Body

ROWS = 1 << 15

ROW = np.dtype(
    [
        ("time", "i8"),
        ("wall", "i8"),
        ("number", "i8"),
        ("enabled", "i8"),
        ("applied", "f8", (3,)),
        ("q", "f8", (3,)),
    ]
)
"""The arm's time and the wall clock's when it got there, ns; the newest valid command's number;
whether the drive is on; the rates (3,) it was told; the true joints (3,)."""

Rows = NDArray[Any]


def stopped(rows: Rows) -> tuple[int, int] | None:
    """The rows in which the newest valid command was taken and, later, its drive was off; None
    where it is still on."""
    changes = np.flatnonzero(np.diff(rows["number"]))
    taken = int(changes[-1]) + 1 if len(changes) else 0
    off = np.flatnonzero(rows["enabled"][taken:] == 0)
    return (taken, taken + int(off[0])) if len(off) else None


class MotionLog:
    """The last rows of one arm, one per step of its physics. One writer; handed to a process when
    that is started."""

    def __init__(self, context: BaseContext) -> None:
        self._memory: Any = context.RawArray("B", ROWS * ROW.itemsize)
        self._count: Any = context.RawValue("q", 0)
        self._rows: Rows | None = None

    def __getstate__(self) -> object:
        return {**self.__dict__, "_rows": None}

    @property
    def rows(self) -> Rows:
        """The ring as it lies in memory."""
        if self._rows is None:
            self._rows = np.frombuffer(self._memory, ROW)
        return self._rows

    @property
    def count(self) -> int:
        """Rows written so far."""
        return self._count.value

    def add(
        self, time: int, wall: int, number: int, enabled: bool, applied: Floats, q: Floats
    ) -> None:
        self.rows[self.count % ROWS] = (time, wall, number, enabled, applied, q)
        self._count.value += 1

    def last(self) -> Any:
        """The newest row."""
        return self.rows[(self.count - 1) % ROWS].copy()

    def since(self, count: int) -> Rows:
        """The rows from the `count`-th on, as far as they are still there."""
        end = self.count
        return self.rows[np.arange(max(count, end - ROWS + 1), end) % ROWS]


class TrueError:
    """‖p₂ − p_d‖ mm for the joints (3,) that the arm told while a target was shown. It is handed to
    a process when that is started."""

    def __init__(self, settings: RigSettings, log: MotionLog) -> None:
        self._body, self._log = Body(settings.mechanism, settings.tool), log
        self._drive = settings.drive

    def __call__(self, shown: Floats) -> float:
        now, there = (
            self._body.points(q)[1] for q in (self._log.last()["q"], self._drive.true(shown))
        )
        away: Floats = now - there
        return float(np.linalg.norm(away))
