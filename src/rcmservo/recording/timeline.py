"""Timeline of a recorded run: consecutive phases and causes, and its result."""

import math
from bisect import bisect_right
from collections import Counter
from dataclasses import dataclass, replace
from itertools import pairwise
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcmservo.config.former_names import with_present_names
from rcmservo.config.servo_json import rebuild_part
from rcmservo.config.toml_json_parsing import is_table
from rcmservo.errors import BadInput
from rcmservo.geometry.kinematics import compute_position
from rcmservo.interfaces import DropReason, Floats
from rcmservo.loop.run_result import (
    ExplorationCost,
    FrameCounts,
    JacobianError,
    LoopTiming,
    RunResult,
    finite_or_none,
    time_spread,
)
from rcmservo.recording.outcome import judge_run
from rcmservo.recording.reader import Record
from rcmservo.safety.causes import Action, Cause
from rcmservo.safety.state_machine import Mode, Phase, Request
from rcmservo.safety.thresholds import Thresholds

DEFAULT_RATE_HZ = 100.0

END_TOLERANCE_S = 0.1
"""Largest time from a run's last tick to its planned end; a loop in wall time may miss ticks."""


@dataclass(frozen=True)
class Span:
    """Consecutive ticks with one phase and one cause.

    A tick with a new request of the operator always begins a span.

    Parameters
    ----------
    start : float
        Time of its first tick, s.
    end : float
        Time at which its last tick ends, s.
    phase : Phase
        Phase of the servo.
    cause : Cause
        Cause of a stop or slowdown; NONE if there is none.
    detail : str
        Detail of the cause for the operator, such as the joint.
    action : Action
        Action that was taken.
    request : Request
        Request of the operator at its first tick.
    stage : int
        Number of the stage within the record.
    """

    start: float
    end: float
    phase: Phase
    cause: Cause
    detail: str
    action: Action
    request: Request
    stage: int

    @property
    def why(self) -> str:
        """Cause and detail in words."""
        return f"{self.cause.value}: {self.detail}" if self.detail else self.cause.value

    @property
    def duration(self) -> float:
        """Duration in s."""
        return self.end - self.start


def list_spans(record: Record) -> list[Span]:
    """Return the spans of the whole record; a stage always begins a span of its own."""
    count = len(record.time)
    rows = list(zip(record.phase, record.cause, number_stages(record).tolist(), strict=True))
    starts = [
        i for i in range(count) if i == 0 or rows[i] != rows[i - 1] or _has_new_request(record, i)
    ]
    return [
        Span(
            start=float(record.time[i]),
            end=float(record.time[j]) if j < count else find_end_time(record),
            phase=record.enum_at(Phase, "phase", i),
            cause=record.enum_at(Cause, "cause", i),
            detail=_detail(record, i),
            action=record.enum_at(Action, "action", i),
            request=record.enum_at(Request, "request", i),
            stage=int(rows[i][2]),
        )
        for i, j in pairwise([*starts, count])
    ]


def _has_new_request(record: Record, i: int) -> bool:
    """Return True if the operator's request at tick i is not that of the previous tick."""
    request, previous = record.words["request"][i], record.words["request"][i - 1]
    return request not in (Request.NONE.name, previous)


def _detail(record: Record, i: int) -> str:
    """Return the detail of the cause at tick i, from the text of the operating state.

    It is the part of that text between the cause and the way out.
    """
    cause = record.enum_at(Cause, "cause", i)
    index = bisect_right(record.operating, i, key=itemgetter(0))
    text = record.operating[index - 1][1] if index else ""
    _, separator, rest = text.partition(f": {cause.value}: ")
    return rest.removesuffix(f" ({cause.remedy})") if separator else ""


def number_stages(record: Record) -> NDArray[np.intp]:
    """Return the number (N,) of every tick's stage."""
    firsts = [stage.first for stage in record.stages]
    return np.maximum(np.searchsorted(firsts, np.arange(len(record.time)), side="right") - 1, 0)


def find_end_time(record: Record) -> float:
    """Return the time (s) at which the last tick ends."""
    return float(record.time[-1]) + 1.0 / read_rate(record) if len(record.time) else 0.0


def read_rate(record: Record) -> float:
    """Return the servo's setting of the ticks per second."""
    value = _setting(record, "rate")
    return value if value > 0.0 else DEFAULT_RATE_HZ


def _late_fraction(record: Record) -> float:
    """Return the fraction of the period by which a tick may be late and still count as punctual."""
    value = _setting(record, "thresholds", "late_tick_fraction")
    return value if value > 0.0 else Thresholds.late_tick_fraction


def _setting(record: Record, *names: str) -> float:
    """Return a setting of the last stage's servo; NaN if it is not recorded as a number."""
    value: Any = record.stages[-1].servo if record.stages else None
    for name in names:
        value = with_present_names(value, names).get(name) if is_table(value) else None
    return float(value) if isinstance(value, float) else math.nan


def summarise(record: Record) -> RunResult:
    """Return the outcome of a recorded run with all numbers of its record."""
    cost, jacobian = _exploration(record)
    return replace(
        outcome(record),
        duration_s=find_end_time(record),
        loop=_loop_timing(record),
        frames=_frame_counts(record),
        explore=cost,
        jacobian_error=jacobian,
    )


def _loop_timing(record: Record) -> LoopTiming:
    """Return the punctuality of the loop, without the times between its stages."""
    ticks, stage = record.ticks, number_stages(record)
    gaps = (np.diff(ticks["now"][:, 0]) * 1e-9)[np.diff(stage) == 0]
    return LoopTiming(
        ticks=len(record.time),
        late=int((gaps > (1.0 + _late_fraction(record)) / read_rate(record)).sum()),
        longest_ms=1e3 * float(gaps.max()) if len(gaps) else None,
        latency_ms=time_spread(ticks["latency"][record.new_frames(), 0]),
    )


def _frame_counts(record: Record) -> FrameCounts:
    """Return the numbers of used, skipped, rejected and dropped frames."""
    number, new, stage = record.ticks["frame"][:, 0], record.new_frames(), number_stages(record)
    steps = np.diff(number[new])[np.diff(stage[new]) == 0]
    dropped = Counter(record.enum_at(DropReason, "dropped", i) for i in range(len(record.time)))
    return FrameCounts(
        used=len(new),
        skipped=int((steps[steps > 0] - 1).sum()),
        rejected=int((record.ticks["accepted_frame"][new, 0] != number[new]).sum()),
        dropped={why.text: n for why, n in dropped.items() if why is not DropReason.NONE},
    )


def _exploration(record: Record) -> tuple[ExplorationCost, JacobianError]:
    """Return the cost of the first exploration, and the errors of Ĵ after it and at the end."""
    explored_ticks = np.flatnonzero(record.ticks["explored"][:, 0])
    explored = int(explored_ticks[0]) if len(explored_ticks) else None
    time = None if explored is None else float(record.time[explored])
    positions, errors = record.truth["p1"], record.truth["jacobian_error"][:, 0]
    if not len(positions):
        return ExplorationCost(time), JacobianError()
    after = None if explored is None else finite_or_none(errors[explored])
    path: Floats = positions if explored is None else positions[: explored + 1]
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    excursion = float(np.linalg.norm(path - path[0], axis=1).max())
    return ExplorationCost(time, length, excursion), JacobianError(
        after, finite_or_none(errors[-1])
    )


def outcome(record: Record) -> RunResult:
    """Return the outcome of the record's last run, judged as during the run.

    A record that ends early gives an unsettled result.
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
    result = judge_run(
        time, record.ticks["delta"][first:], explored_at, mode, _distance_from_target(record)
    )
    return _unless_short(record, result, mode)


def _unless_short(record: Record, result: RunResult, mode: Mode) -> RunResult:
    """Return the result, or an unsettled one if the record ends before its run.

    The result stays if the mode at the end of the record explains the end.
    """
    planned, last = record.planned, find_end_time(record)
    is_complete = record.complete if planned is None else last > planned - END_TOLERANCE_S
    is_explained = bool(mode.cause.stop_sentence) or (
        mode.phase is Phase.DISABLED and record.complete
    )
    if is_complete or is_explained:
        return result
    until = f"{last:.2f} s" if planned is None else f"{last:.2f} s of {planned:.2f} s"
    return result.unsettled(f"the record ends at {until}: what came after is not in it")


def _distance_from_target(record: Record) -> float:
    """Return the distance (mm) of marker 1 at the end from its taught position; 0 if unknown."""
    final, taught = _marker_1_position(record, record.ticks["q"][-1]), find_taught_position(record)
    return 0.0 if final is None or taught is None else float(np.linalg.norm(final - taught))


def find_taught_position(record: Record) -> Floats | None:
    """Return marker 1's last taught position (3,) mm by the joints; None if it is not recorded."""
    return _marker_1_position(record, record.stages[-1].target.q) if record.stages else None


def _marker_1_position(record: Record, q: Floats) -> Floats | None:
    """Return p₁ (3,) mm at the joints q; None if the record does not describe the arm."""
    if not record.stages:
        return None
    try:
        parts = (rebuild_part(record.stages[-1].servo, part) for part in ("mechanism", "tool"))
        mechanism, tool = parts
    except BadInput:
        return None
    return compute_position(mechanism.to_struct(tool.offset), q)
