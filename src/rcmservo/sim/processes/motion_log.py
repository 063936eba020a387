"""Log of a simulated arm's motion in shared memory, and the true error computed from it.

It has one row per ms. It is not a `SharedRing`, the ring buffer of the live package: readers need
tens of thousands of rows as one array, which copies and checksums of single rows would make slow.
"""

from multiprocessing.context import BaseContext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcmservo.interfaces import Floats
from rcmservo.sim.rig import RigSettings

LOG_ROWS = 1 << 15
"""Number of rows that the log stores: the last half minute."""

LOG_FIELDS = "time", "wall", "number", "enabled", "applied", "q"
LOG_ROW = np.dtype({"names": LOG_FIELDS, "formats": ["i8"] * 4 + ["(3,)f8"] * 2})
"""Row: the arm's time and the wall time of the step (ns), the number of the newest valid command,
the drive's state, the applied rates (3,) and the true joints (3,)."""

Rows = NDArray[Any]


def find_stop(rows: Rows) -> tuple[int, int] | None:
    """Return the row of the newest valid command and the row in which the drive is off after it.

    None if the drive is still on.
    """
    changes = np.flatnonzero(np.diff(rows["number"]))
    accepted = int(changes[-1]) + 1 if len(changes) else 0
    is_off = np.flatnonzero(rows["enabled"][accepted:] == 0)
    return (accepted, accepted + int(is_off[0])) if len(is_off) else None


class MotionLog:
    """Log of one arm, with one row per physics step.

    It has one writer; child processes can inherit it.

    Parameters
    ----------
    context : multiprocessing.context.BaseContext
        Context in which the processes start.
    """

    def __init__(self, context: BaseContext) -> None:
        self._memory: Any = context.RawArray("B", LOG_ROWS * LOG_ROW.itemsize)
        self._count: Any = context.RawValue("q", 0)
        self._rows: Rows | None = None

    def __getstate__(self) -> object:
        return {**self.__dict__, "_rows": None}

    @property
    def rows(self) -> Rows:
        """Ring buffer as it lies in memory."""
        if self._rows is None:
            self._rows = np.frombuffer(self._memory, LOG_ROW)
        return self._rows

    @property
    def count(self) -> int:
        """Number of rows written so far."""
        return self._count.value

    def add(
        self, time: int, wall: int, number: int, enabled: bool, applied: Floats, q: Floats
    ) -> None:
        """Write a row with the fields of `LOG_ROW`."""
        self.rows[self.count % LOG_ROWS] = (time, wall, number, enabled, applied, q)
        self._count.value += 1

    def last(self) -> Any:
        """Return the newest row."""
        return self.rows[(self.count - 1) % LOG_ROWS].copy()

    def since(self, count: int) -> Rows:
        """Return the rows from the `count`-th on that are still stored."""
        end = self.count
        return self.rows[np.arange(max(count, end - LOG_ROWS + 1), end) % LOG_ROWS]


class TruePositionError:
    """True distance ‖p₂ − p_d‖ (mm) of the tool from a target. Child processes can inherit it.

    Parameters
    ----------
    settings : RigSettings
        Parts of the laboratory.
    seed : int
        Seed of the laboratory.
    log : MotionLog
        Log of the arm's motion.
    """

    def __init__(self, settings: RigSettings, seed: int, log: MotionLog) -> None:
        self._body, self._log = settings.make_body(seed), log
        self._drive = settings.drive

    def __call__(self, q_measured: Floats) -> float:
        """Return the error (mm) for the joints (3,) measured while the target was taught."""
        p2: Floats = self._body.points(self._log.last()["q"])[1]
        p_d: Floats = self._body.points(self._drive.true(q_measured))[1]
        return float(np.linalg.norm(p2 - p_d))
