"""Replay of a recorded run: the servo of each stage steps through the recorded observations.

A step of the servo depends only on its settings, its state and its inputs, all of which are
recorded. The recorded settings therefore give the recorded decisions bit for bit. Other settings
give the decisions that the servo would have made on the recorded observations. Such a replay is
open loop: with these decisions the arm would have moved differently, and the camera would have
observed something else.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version as find_version
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcmservo.config.servo_json import NO_USER_ESTIMATORS, describe_servo, rebuild_servo
from rcmservo.config.user_estimators import hash_source
from rcmservo.errors import BadInput, UnusableFile
from rcmservo.estimation.base import Estimator
from rcmservo.interfaces import DropReason, Floats, Observation
from rcmservo.loop.tick import Tick
from rcmservo.recording import reader
from rcmservo.recording import ros2_messages as ros2
from rcmservo.recording.reader import Column, Record
from rcmservo.recording.stage import NO_ORIGIN, UNRECORDED_ORIGIN, Stage
from rcmservo.recording.tick_schema import ADDED_COLUMNS
from rcmservo.safety.state_machine import Request
from rcmservo.servo.servo import Servo, State
from rcmservo.servo.user_estimator import format_class_name_of


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
        """Result of the comparison as JSON values."""
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
        """Result of the comparison in one sentence."""
        count, first = len(self.recorded.time), self.first_difference
        settings = "open loop, with other settings: " if self.open_loop else ""
        changed = f"; {self.changed}" if self.changed else ""
        if first is None:
            return f"{settings}all {count} ticks came out the same, bit for bit{changed}"
        first_tick = f"tick {first} ({self.recorded.time[first]:.2f} s)"
        differing = f"{max(self.difference_counts.values())} of {count} ticks"
        columns = ", ".join(self.difference_counts)
        return f"{settings}from {first_tick} on, {differing} differ in {columns}{changed}"


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
    stages = recorded.stages
    if not stages and len(recorded.time):
        raise UnusableFile(recorded.path, "holds no stage: the servo of its ticks is unknown")
    servos = [
        rebuild_stage_servo(recorded, stage, own) if servo is None else servo for stage in stages
    ]
    messages: list[bytes] = []
    names: list[tuple[str, ...]] = []
    memories: dict[int, Floats] = {}
    for i, tick in enumerate(_step_through(recorded, servos)):
        messages.append(ros2.encode_tick(tick))
        names.append(ros2.decode_names(messages[-1], ros2.TICK))
        memory_numbers = tick.servo.guarded_estimator.recorded_numbers(tick.state.estimation.memory)
        if memory_numbers is not None:
            memories[i] = memory_numbers
    ticks = ros2.decode_columns(ros2.TICK, messages) | reader.build_memory_column(
        memories, len(messages)
    )
    recomputed = replace(recorded, ticks=ticks, words=reader.name_columns(names), operating=[])
    difference_counts, first_difference = _compare(recorded, recomputed)
    return ReplayResult(
        recorded,
        recomputed,
        first_difference,
        difference_counts,
        open_loop=servo is not None
        and any(describe_servo(servo) != stage.servo for stage in stages),
        changed=_describe_changed_sources(stages, servos),
    )


def _describe_changed_sources(stages: Sequence[Stage], servos: Sequence[Servo]) -> str:
    """Return a sentence about user-defined estimators with another source than recorded."""
    class_paths = {
        format_class_name_of(servo.estimator)
        for stage, servo in zip(stages, servos, strict=True)
        if stage.servo["estimator"].get("kind") == format_class_name_of(servo.estimator)
        and stage.source != hash_source(servo.estimator)
    }
    return ", ".join(f"the source of {name} has changed since" for name in sorted(class_paths))


def _step_through(recorded: Record, servos: Sequence[Servo]) -> Iterator[Tick]:
    """Yield each recorded tick with its replayed state.

    `servo_ticks` is not used: the record holds observations and requests, and nothing is sent.
    """
    end_states: list[State] = []
    stage_bounds = pairwise([*(stage.first for stage in recorded.stages), len(recorded.time)])
    for stage, servo, bounds in zip(recorded.stages, servos, stage_bounds, strict=True):
        state = _find_initial_state(recorded, stage, servo, end_states)
        target = stage.target
        servo.require_sizes(target)
        for i in range(*bounds):
            observation, jog = _read_observation(recorded, i), recorded.ticks["jog"][i]
            request = recorded.enum_at(Request, "request", i)
            state = servo.step(state, observation, target, request, jog)
            yield Tick(0, servo, observation, request, jog, state, recorded.ticks["applied"][i])
        end_states.append(state)


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
        if version != find_version("rcmservo"):
            reason += f": replay it with rcmservo {version}, which has written it"
        raise UnusableFile(recorded.path, reason) from error


def _find_initial_state(
    recorded: Record, stage: Stage, servo: Servo, end_states: Sequence[State]
) -> State:
    """Return the state at the start of a stage; `end_states` are those after earlier stages."""
    if stage.origin == NO_ORIGIN:
        return servo.init()
    if stage.origin == UNRECORDED_ORIGIN:
        reason = "a stage continues from a state that is not in this record"
        raise UnusableFile(recorded.path, reason)
    end_state = end_states[stage.origin]
    return end_state if stage.mid_run else servo.restart(end_state)


def _read_observation(recorded: Record, i: int) -> Observation:
    """Return the recorded observation of tick `i`."""
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


def _compare(recorded: Record, recomputed: Record) -> tuple[dict[str, int], int | None]:
    """Compare two records bit by bit, except for columns that the older one lacks.

    Return the number of differing ticks of each column that has any, and the index of the first
    tick that differs.
    """
    no_values = np.empty((len(recorded.time), 0))
    a, b = recorded.ticks, recomputed.ticks
    lacking = {name for name in chain(*ADDED_COLUMNS) if name in a and np.isnan(a[name]).all()}
    is_different = {
        name: _find_differing_rows(a.get(name, no_values), b.get(name, no_values))
        for name in {**a, **b}.keys() - lacking
    }
    for name, recorded_names in recorded.words.items():
        is_different[name] = np.array(recorded_names) != np.array(recomputed.words[name])
    counts = {name: int(rows.sum()) for name, rows in is_different.items() if rows.any()}
    first = min((int(np.argmax(is_different[name])) for name in counts), default=None)
    return counts, first


def _find_differing_rows(a: Column, b: Column) -> NDArray[np.bool_]:
    """Return True (N,) for the rows in which two columns (N, size) differ in any bit."""
    if a.shape != b.shape:
        return np.ones(len(a), dtype=bool)
    row_bytes = a.shape[1] * a.itemsize
    bytes_a, bytes_b = (
        np.ascontiguousarray(column).view(np.uint8).reshape(-1, row_bytes) for column in (a, b)
    )
    return (bytes_a != bytes_b).any(axis=1)
