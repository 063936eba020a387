"""Replay of a recorded run: the servo of each stage steps through the recorded observations.

A step depends on nothing else, so the recorded settings give the recorded decisions bit for bit.
Other settings give the decisions that the servo would have made on the recorded observations. That
is open loop: the arm would have moved differently, and the camera would have observed something
else.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcmservo import __version__
from rcmservo.config.servo_json import NO_USER_ESTIMATORS, describe_servo, rebuild_servo
from rcmservo.config.user_estimators import hash_source
from rcmservo.errors import BadInput, UnusableFile
from rcmservo.estimation.base import Estimator
from rcmservo.interfaces import DropReason, Floats, Observation, Target
from rcmservo.loop.operator import targets_are_equal
from rcmservo.loop.tick import Tick
from rcmservo.recording import estimator_memory, reader, ros2_messages
from rcmservo.recording.reader import Column, Record
from rcmservo.recording.ros2_messages import TICK
from rcmservo.recording.stage import NO_ORIGIN, UNRECORDED_ORIGIN, Stage
from rcmservo.recording.tick_schema import NAME_COLUMNS
from rcmservo.safety.state_machine import Request
from rcmservo.servo.servo import Servo, State
from rcmservo.servo.user_estimator import class_path_of


@dataclass(frozen=True, eq=False)
class ReplayResult:
    """Comparison of a record with its replay.

    Parameters
    ----------
    recorded : Record
        Record as it was written.
    recomputed : Record
        Record with the replayed decisions; it can be plotted like any other record.
    first_difference : int or None
        Index of the first tick that differs in any bit; None if there is none.
    difference_counts : dict[str, int]
        Number of differing ticks by column; columns without a difference are left out.
    open_loop : bool
        True if other settings than the recorded ones were used.
    changed : str
        Sentence about user-defined estimators whose source has changed since; empty if none has.
    """

    recorded: Record
    recomputed: Record
    first_difference: int | None
    difference_counts: dict[str, int]
    open_loop: bool
    changed: str = ""

    @property
    def same(self) -> bool:
        """True if no tick differs."""
        return self.first_difference is None

    @property
    def numbers(self) -> dict[str, Any]:
        """Outcome as JSON has it."""
        return {
            "same": self.same,
            "open_loop": self.open_loop,
            "ticks": len(self.recorded.time),
            "first": self.first_difference,
            "differs": self.difference_counts,
            "missing": self.recorded.missing,
            "changed": self.changed,
        }

    @property
    def sentence(self) -> str:
        """Result in one sentence."""
        count = len(self.recorded.time)
        loop = "open loop, with other settings: " if self.open_loop else ""
        changed = f"; {self.changed}" if self.changed else ""
        if self.first_difference is None:
            return f"{loop}all {count} ticks came out the same, bit for bit{changed}"
        first_tick = (
            f"tick {self.first_difference} ({self.recorded.time[self.first_difference]:.2f} s)"
        )
        differing = f"{max(self.difference_counts.values())} of {count} ticks"
        columns = ", ".join(self.difference_counts)
        return f"{loop}from {first_tick} on, {differing} differ in {columns}{changed}"


def replay_record(
    run: Path | Record,
    servo: Servo | None = None,
    own: Mapping[str, type[Estimator]] = NO_USER_ESTIMATORS,
) -> ReplayResult:
    """Replay a recorded run and compare the decisions.

    Parameters
    ----------
    run : Path or Record
        Record, its file, or the folder of its run.
    servo : Servo, optional
        Servo with other settings; by default the recorded servo of each stage.
    own : Mapping of str to type, optional
        User-defined estimators by name. A recorded estimator that is not built in must be among
        them.

    Returns
    -------
    ReplayResult
        Both runs and their differences.

    Raises
    ------
    UnusableFile
        If the record cannot be read, or if a recorded servo cannot be rebuilt.
    """
    recorded = run if isinstance(run, Record) else reader.read_record(run)
    if not recorded.stages and len(recorded.time):
        raise UnusableFile(recorded.path, "holds no stage: the servo of its ticks is unknown")
    rows: list[bytes] = []
    names: list[tuple[str, ...]] = []
    memories: dict[int, Floats] = {}
    servos = [
        rebuild_stage_servo(recorded, stage, own) if servo is None else servo
        for stage in recorded.stages
    ]
    for tick in _ticks(recorded, servos):
        rows.append(ros2_messages.encode_tick(tick))
        names.append(ros2_messages.decode_names(rows[-1], TICK))
        numbers = estimator_memory.recorded_memory(tick)
        if numbers is not None:
            memories[len(rows) - 1] = numbers
    words = {column.name: [row[i] for row in names] for i, column in enumerate(NAME_COLUMNS)}
    ticks = ros2_messages.columns(TICK, rows) | estimator_memory.memory_column(memories, len(rows))
    recomputed = replace(recorded, ticks=ticks, words=words, operating=[])
    stages = recorded.stages
    open_loop = servo is not None and any(describe_servo(servo) != stage.servo for stage in stages)
    comparison = _compare(recorded, recomputed, open_loop)
    return replace(comparison, changed=_changed_sources(stages, servos))


def _changed_sources(stages: Sequence[Stage], servos: Sequence[Servo]) -> str:
    """Return a sentence about user-defined estimators with another source than recorded."""
    names = {
        class_path_of(servo.estimator)
        for stage, servo in zip(stages, servos, strict=True)
        if stage.servo["estimator"].get("kind") == class_path_of(servo.estimator)
        and stage.source != hash_source(servo.estimator)
    }
    return ", ".join(f"the source of {name} has changed since" for name in sorted(names))


def _ticks(recorded: Record, servos: Sequence[Servo]) -> Iterator[Tick]:
    """Yield each recorded tick with its replayed state.

    This does not use `loop.run`: the record holds observations and requests, and nothing is sent.
    """
    ends: list[State] = []
    firsts = [*(stage.first for stage in recorded.stages), len(recorded.time)]
    for number, (stage, servo) in enumerate(zip(recorded.stages, servos, strict=True)):
        state = _initial_state(recorded, stage, servo, ends)
        target = _stage_target(stage, state)
        servo.require_target(target)
        for i in range(stage.first, firsts[number + 1]):
            observation, jog = _observation(recorded, i), recorded.ticks["jog"][i]
            request = recorded.enum_at(Request, "request", i)
            state = servo.step(state, observation, target, request, jog)
            yield Tick(0, servo, observation, request, jog, state, recorded.ticks["applied"][i])
        ends.append(state)


def rebuild_stage_servo(
    recorded: Record, stage: Stage, own: Mapping[str, type[Estimator]] = NO_USER_ESTIMATORS
) -> Servo:
    """Return the servo of a stage.

    Raises
    ------
    UnusableFile
        If this version cannot rebuild it; the message names the version that can.
    """
    try:
        return rebuild_servo(stage.servo, own)
    except BadInput as error:
        version = stage.version or recorded.version
        reason = f"its servo cannot be rebuilt: {error}"
        if version != __version__:
            reason += f": replay it with rcmservo {version}, which has written it"
        raise UnusableFile(recorded.path, reason) from error


def _initial_state(recorded: Record, stage: Stage, servo: Servo, ends: list[State]) -> State:
    """Return the state at the start of a stage."""
    if stage.origin == NO_ORIGIN:
        return servo.init()
    if stage.origin == UNRECORDED_ORIGIN:
        raise UnusableFile(
            recorded.path, "a stage continues from a state that is not in this record"
        )
    end = ends[stage.origin]
    return end if stage.mid_run else servo.restart(end)


def _stage_target(stage: Stage, state: State) -> Target:
    """Return the stage's target, as the state's own object if both are equal.

    Another object would start a new approach.
    """
    own = state.target
    return own if own is not None and targets_are_equal(own, stage.target) else stage.target


def _observation(recorded: Record, i: int) -> Observation:
    """Return the observation of a tick."""
    ticks = recorded.ticks
    return Observation(
        now=int(ticks["now"][i, 0]),
        q=ticks["q"][i],
        q_time=int(ticks["q_time"][i, 0]),
        enabled=bool(ticks["enabled"][i, 0]),
        applied=ticks["applied_at_observation"][i],
        frame=int(ticks["frame"][i, 0]),
        exposure=int(ticks["exposure"][i, 0]),
        arrival=int(ticks["arrival"][i, 0]),
        q_exposure=ticks["q_exposure"][i],
        points=ticks["points"][i].reshape(2, 2),
        drop_reason=recorded.enum_at(DropReason, "dropped", i),
        recorded=bool(ticks["recorded"][i, 0]),
        sizes=ticks["sizes"][i],
        quality=ticks["quality"][i],
    )


def _compare(recorded: Record, recomputed: Record, open_loop: bool) -> ReplayResult:
    """Compare two records column by column, bit by bit."""
    nothing = np.empty((len(recorded.time), 0))
    a, b = recorded.ticks, recomputed.ticks
    rows = {
        name: _differing_rows(a.get(name, nothing), b.get(name, nothing)) for name in {**a, **b}
    }
    for name in recorded.words:
        pairs = zip(recorded.words[name], recomputed.words[name], strict=True)
        rows[name] = np.array([then != now for then, now in pairs], dtype=bool)
    differs = {name: int(differing.sum()) for name, differing in rows.items() if differing.any()}
    first = min((int(np.argmax(rows[name])) for name in differs), default=None)
    return ReplayResult(recorded, recomputed, first, differs, open_loop)


def _differing_rows(a: Column, b: Column) -> NDArray[np.bool_]:
    """Return the rows at which two columns (N, size) differ in any bit."""
    if a.shape != b.shape:
        return np.ones(len(a), dtype=bool)
    width = a.shape[1] * a.itemsize
    bits_a, bits_b = (
        np.ascontiguousarray(column).view(np.uint8).reshape(-1, width) for column in (a, b)
    )
    return (bits_a != bits_b).any(axis=1)
