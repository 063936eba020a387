"""Timeline of a recorded run: its spans of one phase and cause, and its result."""

import math
from bisect import bisect_right
from collections import Counter
from dataclasses import dataclass, replace
from itertools import pairwise
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcmservo.config.former_names import replace_former_names
from rcmservo.config.servo_json import rebuild_part
from rcmservo.config.toml_json_parsing import is_table
from rcmservo.errors import BadInput
from rcmservo.geometry.kinematics import Kinematics, compute_position
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import DropReason, Floats
from rcmservo.loop.run_result import (
    ExplorationCost,
    FinalPose,
    FrameCounts,
    JacobianError,
    LoopTiming,
    RunResult,
    finite_or_none,
    time_spread,
)
from rcmservo.recording.final_pose import (
    RunCourse,
    convert_to_mm,
    measure_backlash,
    measure_distances,
    measure_final_pose,
)
from rcmservo.recording.outcome import judge_run
from rcmservo.recording.reader import Record
from rcmservo.safety.causes import Action, Cause
from rcmservo.safety.state_machine import Mode, Phase, Request
from rcmservo.safety.thresholds import Thresholds

DEFAULT_RATE_HZ = 100.0
"""Ticks per second of a record that does not state them."""

END_TOLERANCE_S = 0.1
"""Largest time in s from the end of a complete run to its planned end: a loop in wall time may skip
its last ticks."""


@dataclass(frozen=True)
class Span:
    """Consecutive ticks with one phase and one cause.

    A tick with a new request of the operator always begins a span, and so does a new stage.

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
        Number of the stage within the record, from 0.
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
        """Cause and its detail as one text."""
        return f"{self.cause.value}: {self.detail}" if self.detail else self.cause.value

    @property
    def duration(self) -> float:
        """Duration in s."""
        return self.end - self.start


def list_spans(record: Record) -> list[Span]:
    """Return the spans of the whole record; a stage always begins a span of its own."""
    count, stage_numbers = len(record.time), number_stages(record).tolist()
    states = list(zip(record.phase, record.cause, stage_numbers, strict=True))
    starts = [
        i
        for i in range(count)
        if i == 0 or states[i] != states[i - 1] or _has_new_request(record, i)
    ]
    return [
        Span(
            start=float(record.time[start]),
            end=float(record.time[end]) if end < count else find_end_time(record),
            phase=record.enum_at(Phase, "phase", start),
            cause=record.enum_at(Cause, "cause", start),
            detail=_find_cause_detail(record, start),
            action=record.enum_at(Action, "action", start),
            request=record.enum_at(Request, "request", start),
            stage=stage_numbers[start],
        )
        for start, end in pairwise([*starts, count])
    ]


def _has_new_request(record: Record, i: int) -> bool:
    """Return True if the operator's request at tick `i` is not that of the previous tick."""
    request, previous = record.words["request"][i], record.words["request"][i - 1]
    return request not in (Request.NONE.name, previous)


def _find_cause_detail(record: Record, i: int) -> str:
    """Return the detail of the cause at tick `i`, such as the joint; empty if there is none.

    The record holds it in the sentences of the operating states only: between the cause and the
    remedy in parentheses.
    """
    cause = record.enum_at(Cause, "cause", i)
    index = bisect_right(record.operating, i, key=itemgetter(0)) - 1
    sentence = record.operating[index][1] if index >= 0 else ""
    _, _, detail_and_remedy = sentence.partition(f": {cause.value}: ")
    return detail_and_remedy.removesuffix(f" ({cause.remedy})")


def number_stages(record: Record) -> NDArray[np.intp]:
    """Return the number of the stage, from 0, of each tick (N,)."""
    first_ticks = [stage.first for stage in record.stages]
    numbers = np.searchsorted(first_ticks, np.arange(len(record.time)), side="right") - 1
    return np.maximum(numbers, 0)


def find_end_time(record: Record) -> float:
    """Return the time (s) at which the last tick ends."""
    return float(record.time[-1]) + 1.0 / read_rate(record) if len(record.time) else 0.0


def read_rate(record: Record) -> float:
    """Return the ticks per second of the servo, in Hz."""
    rate_hz = _read_setting(record, "rate")
    return rate_hz if rate_hz > 0.0 else DEFAULT_RATE_HZ


def _read_late_fraction(record: Record) -> float:
    """Return the fraction of the period by which a tick may be late and still count as punctual."""
    fraction = _read_setting(record, "thresholds", "late_tick_fraction")
    return fraction if fraction > 0.0 else Thresholds.late_tick_fraction


def _read_setting(record: Record, *keys: str) -> float:
    """Return a setting of the last stage's servo; NaN if it is not recorded as a number.

    `keys` leads to the setting through the tables of the servo's description.
    """
    value: Any = record.stages[-1].servo if record.stages else None
    for key in keys:
        value = replace_former_names(value, keys).get(key) if is_table(value) else None
    return float(value) if isinstance(value, float) else math.nan


def summarise_record(record: Record) -> RunResult:
    """Return the result of a recorded run with all numbers of its record."""
    result = replace(
        _judge_last_run(record),
        duration_s=find_end_time(record),
        loop=_measure_loop_timing(record),
        frames=_count_frames(record),
    )
    return _add_exploration(record, result)


def _judge_last_run(record: Record) -> RunResult:
    """Return the result of the record's last run, by the rules that hold during a run.

    A run whose record ends early has not settled.
    """
    first = max((stage.first for stage in record.stages if not stage.mid_run), default=0)
    times = record.time[first:]
    if not len(times):
        return _mark_unfinished(record, RunResult(), Mode())
    last = len(record.time) - 1
    mode = Mode(
        record.enum_at(Phase, "phase", last),
        record.enum_at(Cause, "cause", last),
        detail=_find_cause_detail(record, last),
    )
    explored = _find_exploration_end(record, first)
    exploration_end_s = None if explored is None else float(record.time[explored])
    parts, q = _rebuild_arm_and_tool(record), record.ticks["q"][first:]
    distances = (
        np.full(len(q), np.nan)
        if parts is None
        else measure_distances(q, *parts, record.stages[-1].target.q)
    )
    course = RunCourse(
        times=times,
        errors=record.ticks["delta"][first:],
        now=record.ticks["now"][first:, 0] * 1e-9,
        q=q,
        applied=record.ticks["applied"][first:],
        J_hat=record.ticks["J_hat"][-1].reshape(3, 3),
        distances=distances,
        pose_bound=float(record.ticks["pose_bound"][-1, 0]),
        bound_parts=record.ticks["bound_parts"][-1],
        resting_rates=record.ticks["resting_rates"][-1],
        frames=record.ticks["frame"][first:, 0].astype(float),
        q_exposure=record.ticks["q_exposure"][first:],
        points=record.ticks["points"][first:].reshape(-1, 2, 2),
    )
    backlash = np.zeros(3) if parts is None else measure_backlash(course, *parts)
    pose = FinalPose() if parts is None else measure_final_pose(course, *parts, backlash)
    result = judge_run(course, exploration_end_s, mode, pose)
    result = replace(result, backlash=backlash.tolist())
    return _mark_unfinished(record, result, mode)


def _mark_unfinished(record: Record, result: RunResult, final_mode: Mode) -> RunResult:
    """Return an unsettled result if the record ends before its run, otherwise the result itself.

    A cause that stops the arm, or a drive that is off, explains why the run ended before its
    planned time.
    """
    planned_s, end_s = record.planned, find_end_time(record)
    is_complete = record.complete if planned_s is None else end_s > planned_s - END_TOLERANCE_S
    is_switched_off = final_mode.phase is Phase.DISABLED and record.complete
    if is_complete or is_switched_off or final_mode.cause.stop_sentence:
        return result
    planned = "" if planned_s is None else f" of {planned_s:.2f} s"
    cause = f"the record ends at {end_s:.2f} s{planned}: what came after is not in it"
    return result.unsettled(cause)


def _measure_loop_timing(record: Record) -> LoopTiming:
    """Return the punctuality of the loop, without the times between its stages."""
    ticks, stage_numbers = record.ticks, number_stages(record)
    is_same_stage = np.diff(stage_numbers) == 0
    intervals_s = (np.diff(ticks["now"][:, 0]) * 1e-9)[is_same_stage]
    late_interval_s = (1.0 + _read_late_fraction(record)) / read_rate(record)
    return LoopTiming(
        ticks=len(record.time),
        late=int((intervals_s > late_interval_s).sum()),
        longest_ms=1e3 * float(intervals_s.max()) if len(intervals_s) else None,
        latency_ms=time_spread(ticks["latency"][record.new_frames(), 0]),
    )


def _count_frames(record: Record) -> FrameCounts:
    """Return the numbers of used, skipped, rejected and dropped frames."""
    new_frames, stage_numbers = record.new_frames(), number_stages(record)
    frame_numbers = record.ticks["frame"][new_frames, 0]
    steps = np.diff(frame_numbers)[np.diff(stage_numbers[new_frames]) == 0]
    drop_reasons = (record.enum_at(DropReason, "dropped", i) for i in range(len(record.time)))
    return FrameCounts(
        used=len(new_frames),
        skipped=int((steps[steps > 0] - 1).sum()),
        rejected=int((record.ticks["accepted_frame"][new_frames, 0] != frame_numbers).sum()),
        dropped=dict(Counter(r.text for r in drop_reasons if r is not DropReason.NONE)),
    )


def _add_exploration(record: Record, result: RunResult) -> RunResult:
    """Return the result with the cost of the first exploration and the errors of Ĵ."""
    end = _find_exploration_end(record)
    end_s = None if end is None else float(record.time[end])
    positions, errors = record.truth["p1"], record.truth["jacobian_error"][:, 0]
    if not len(positions):
        return replace(result, explore=ExplorationCost(end_s))
    path: Floats = positions if end is None else positions[: end + 1]
    length_mm = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    displacements: Floats = path - path[0]
    excursion_mm = float(np.linalg.norm(displacements, axis=1).max())
    explored_error = None if end is None else finite_or_none(errors[end])
    return replace(
        result,
        explore=ExplorationCost(end_s, length_mm, excursion_mm),
        jacobian_error=JacobianError(explored_error, finite_or_none(errors[-1])),
    )


def _find_exploration_end(record: Record, first: int = 0) -> int | None:
    """Return the index of the earliest tick from `first` on that has explored, if there is one."""
    is_explored = record.ticks["explored"][first:, 0]
    return first + int(np.argmax(is_explored)) if is_explored.any() else None


def compute_distances(record: Record) -> tuple[Floats, Floats]:
    """Return the distances (N,), (N,) in mm of marker 2 from the taught pose, by image and joints.

    They are NaN if the record does not describe the arm, and by the image before Ĵ is known.
    """
    parts, count = _rebuild_arm_and_tool(record), len(record.time)
    if parts is None:
        return np.full(count, np.nan), np.full(count, np.nan)
    mechanism, tool = parts
    rcm, ticks, by_image = mechanism.to_struct(tool.offset), record.ticks, np.empty(count)
    for i, (q, delta, J_hat) in enumerate(
        zip(ticks["q"], ticks["delta"], ticks["J_hat"].reshape(-1, 3, 3), strict=True)
    ):
        by_image[i], _ = convert_to_mm(delta[None], J_hat, tool, compute_position(rcm, q))
    by_image[~ticks["explored"][:, 0].astype(bool)] = np.nan
    return by_image, measure_distances(ticks["q"], mechanism, tool, record.stages[-1].target.q)


def find_taught_position(record: Record) -> Floats | None:
    """Return the last taught position (3,) of marker 1 in mm, as the joints give it.

    It is None if the record does not describe the arm.
    """
    parts = _rebuild_arm_and_tool(record)
    if parts is None:
        return None
    mechanism, tool = parts
    return compute_position(mechanism.to_struct(tool.offset), record.stages[-1].target.q)


def _rebuild_arm_and_tool(record: Record) -> tuple[Kinematics, Tool] | None:
    """Return mechanism and tool of the last stage; None if the record does not describe them."""
    if not record.stages:
        return None
    servo = record.stages[-1].servo
    try:
        return rebuild_part(servo, "mechanism"), rebuild_part(servo, "tool")
    except BadInput:
        return None
