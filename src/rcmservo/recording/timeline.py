"""Timeline of a recorded run, its phases and causes one after the other, and its result."""

import math
from bisect import bisect_right
from collections import Counter
from dataclasses import dataclass, replace
from itertools import pairwise
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcmservo.config.servo_json import rebuild_part
from rcmservo.errors import BadInput
from rcmservo.geometry.kinematics import position
from rcmservo.interfaces import Dropped, Floats
from rcmservo.loop.run_result import (
    ExplorationCost,
    FrameCounts,
    JacobianError,
    LoopTiming,
    RunResult,
    known,
    spread,
)
from rcmservo.recording.outcome import judged
from rcmservo.recording.reader import Record
from rcmservo.safety.causes import Action, Cause
from rcmservo.safety.state_machine import Mode, Phase, Request
from rcmservo.safety.thresholds import Thresholds

USUAL_RATE = 100.0

SLACK = 0.1
"""s before the planned end of a run within which its last tick may come: a loop in wall time may
miss some."""


@dataclass(frozen=True)
class Span:
    """A stretch of ticks with one phase and one cause.

    A tick at which a person asked for something always begins one.

    Parameters
    ----------
    start : float
        s of its first tick.
    end : float
        s at which its last tick ends.
    phase : Phase
        What the servo was doing.
    cause : Cause
        Why; NONE if all was well.
    detail : str
        What a person should know beside it, such as which joint it is.
    asks : Action
        The action that was taken in it.
    request : Request
        What a person asked for at its first tick.
    stage : int
        The number of the stage within the record.
    """

    start: float
    end: float
    phase: Phase
    cause: Cause
    detail: str
    asks: Action
    request: Request
    stage: int

    @property
    def why(self) -> str:
        """Cause and detail in words."""
        return f"{self.cause.value}: {self.detail}" if self.detail else self.cause.value

    @property
    def length(self) -> float:
        """S from start to end."""
        return self.end - self.start


def spans(record: Record) -> list[Span]:
    """The record from beginning to end; a stage always begins a span of its own."""
    count = len(record.time)
    rows = list(zip(record.phase, record.cause, stages(record).tolist(), strict=True))
    starts = [i for i in range(count) if i == 0 or rows[i] != rows[i - 1] or _asked(record, i)]
    return [
        Span(
            start=float(record.time[i]),
            end=float(record.time[j]) if j < count else end(record),
            phase=record.enum_at(Phase, "phase", i),
            cause=record.enum_at(Cause, "cause", i),
            detail=_detail(record, i),
            asks=record.enum_at(Action, "action", i),
            request=record.enum_at(Request, "request", i),
            stage=int(rows[i][2]),
        )
        for i, j in pairwise([*starts, count])
    ]


def _asked(record: Record, i: int) -> bool:
    """Whether a person asks for something at tick i that was not asked for at the one before."""
    asked, before = record.words["request"][i], record.words["request"][i - 1]
    return asked not in (Request.NONE.name, before)


def _detail(record: Record, i: int) -> str:
    """What was said beside the cause at tick i: what stands in the words of the operating state
    between it and the way out.
    """
    cause = record.enum_at(Cause, "cause", i)
    place = bisect_right(record.operating, i, key=itemgetter(0))
    words = record.operating[place - 1][1] if place else ""
    _, said, rest = words.partition(f": {cause.value}: ")
    return rest.removesuffix(f" ({cause.way_out})") if said else ""


def stages(record: Record) -> NDArray[np.intp]:
    """The number (N,) of every tick's stage."""
    firsts = [stage.first for stage in record.stages]
    return np.maximum(np.searchsorted(firsts, np.arange(len(record.time)), side="right") - 1, 0)


def end(record: Record) -> float:
    """S at which the last tick ends."""
    return float(record.time[-1]) + 1.0 / rate(record) if len(record.time) else 0.0


def rate(record: Record) -> float:
    """Ticks a second, as the servo was told."""
    value = _setting(record, "rate")
    return value if value > 0.0 else USUAL_RATE


def _late_share(record: Record) -> float:
    """Share of its period by which a tick could come late and count as in time."""
    value = _setting(record, "thresholds", "late_share")
    return value if value > 0.0 else Thresholds.late_share


def _setting(record: Record, *names: str) -> float:
    """A setting of the last stage's servo; NaN where the record does not tell it as a number."""
    told: Any = record.stages[-1].servo if record.stages else None
    for name in names:
        told = told.get(name) if isinstance(told, dict) else None  # pyright: ignore[reportUnknownVariableType, reportUnknownMemberType]
    return float(told) if isinstance(told, float) else math.nan


def summary(record: Record) -> RunResult:
    """Return the outcome of a recorded run, with all numbers that its record holds."""
    cost, jacobian = _exploration(record)
    return replace(
        outcome(record),
        duration_s=end(record),
        loop=_loop_timing(record),
        frames=_frame_counts(record),
        explore=cost,
        jacobian_error=jacobian,
    )


def _loop_timing(record: Record) -> LoopTiming:
    """Return the punctuality of the loop, apart from the times between its stages."""
    ticks, stage = record.ticks, stages(record)
    gaps = (np.diff(ticks["now"][:, 0]) * 1e-9)[np.diff(stage) == 0]
    return LoopTiming(
        ticks=len(record.time),
        late=int((gaps > (1.0 + _late_share(record)) / rate(record)).sum()),
        longest_ms=1e3 * float(gaps.max()) if len(gaps) else None,
        latency_ms=spread(ticks["latency"][record.new_frames(), 0]),
    )


def _frame_counts(record: Record) -> FrameCounts:
    """Return how the frames were used."""
    number, new, stage = record.ticks["frame"][:, 0], record.new_frames(), stages(record)
    steps = np.diff(number[new])[np.diff(stage[new]) == 0]
    dropped = Counter(record.enum_at(Dropped, "dropped", i) for i in range(len(record.time)))
    return FrameCounts(
        used=len(new),
        skipped=int((steps[steps > 0] - 1).sum()),
        rejected=int((record.ticks["accepted_frame"][new, 0] != number[new]).sum()),
        dropped={why.words: n for why, n in dropped.items() if why is not Dropped.NONE},
    )


def _exploration(record: Record) -> tuple[ExplorationCost, JacobianError]:
    """Return the cost of the first exploration, and the errors of Ĵ after it and at the end."""
    found = np.flatnonzero(record.ticks["explored"][:, 0])
    explored = int(found[0]) if len(found) else None
    time = None if explored is None else float(record.time[explored])
    places, errors = record.truth["p1"], record.truth["jacobian_error"][:, 0]
    if not len(places):
        return ExplorationCost(time), JacobianError()
    after = None if explored is None else known(errors[explored])
    path: Floats = places if explored is None else places[: explored + 1]
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    excursion = float(np.linalg.norm(path - path[0], axis=1).max())
    return ExplorationCost(time, length, excursion), JacobianError(after, known(errors[-1]))


def outcome(record: Record) -> RunResult:
    """Return the verdict on the record's last run, judged as a run is while it happens, if the
    record goes to its end.
    """
    first = max((stage.first for stage in record.stages if not stage.mid_run), default=0)
    time = record.time[first:]
    if not len(time):
        return _unless_short(record, RunResult(), Mode())
    last = len(record.time) - 1
    phase, cause = record.enum_at(Phase, "phase", last), record.enum_at(Cause, "cause", last)
    mode = Mode(phase, cause, detail=_detail(record, last))
    explored = np.flatnonzero(record.ticks["explored"][first:, 0])
    explored_at = float(time[explored[0]]) if len(explored) else None
    result = judged(time, record.ticks["delta"][first:], explored_at, mode, _apart(record))
    return _unless_short(record, result, mode)


def _unless_short(record: Record, result: RunResult, mode: Mode) -> RunResult:
    """Return the result, not settled if the record ends before its run did, and in a mode that does
    not tell why.
    """
    planned, last = record.planned, end(record)
    whole = record.complete if planned is None else last > planned - SLACK
    over = bool(mode.cause.stopping) or (mode.phase is Phase.DISABLED and record.complete)
    if whole or over:
        return result
    until = f"{last:.2f} s" if planned is None else f"{last:.2f} s of {planned:.2f} s"
    return result.unsettled(f"the record ends at {until}: what came after is not in it")


def _apart(record: Record) -> float:
    """Mm at the end between marker 1 and where it was shown; 0 where the record does not tell the
    arm.
    """
    place, shown = _place(record, record.ticks["q"][-1]), shown_place(record)
    return 0.0 if place is None or shown is None else float(np.linalg.norm(place - shown))


def shown_place(record: Record) -> Floats | None:
    """Where marker 1 was shown last, (3,) mm by the joints; None where the record does not tell."""
    return _place(record, record.stages[-1].target.q) if record.stages else None


def _place(record: Record, q: Floats) -> Floats | None:
    """p₁ (3,) mm at the joints q, if the record tells the arm."""
    if not record.stages:
        return None
    try:
        parts = (rebuild_part(record.stages[-1].servo, part) for part in ("mechanism", "tool"))
        mechanism, tool = parts
    except BadInput:
        return None
    return position(mechanism.rcm(tool.offset), q)
