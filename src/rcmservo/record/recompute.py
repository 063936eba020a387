"""A recorded run computed again: every stage's servo is stepped through what it saw, and must
decide the same.

With the recorded settings the answer is the same bit for bit, as a step depends on nothing else.
With other settings it is what the servo would have decided on what was seen then. That is open
loop: the arm would have gone elsewhere, and the camera would have seen something else.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcmservo import __version__
from rcmservo.config.own_code import source
from rcmservo.config.servo_json import NOBODY, describe, rebuild
from rcmservo.errors import BadInput, UnusableFile
from rcmservo.guard.states import Request
from rcmservo.interfaces import Dropped, Floats, Observation, Target
from rcmservo.loop.operator import same
from rcmservo.loop.tick import Tick
from rcmservo.method.estimators.base import Estimator
from rcmservo.record import memory, reader, ros2_messages
from rcmservo.record.columns import WORDS
from rcmservo.record.reader import Column, Record
from rcmservo.record.ros2_messages import TICK
from rcmservo.record.stage import ELSEWHERE, NOTHING, Stage
from rcmservo.servo.servo import Servo, State
from rcmservo.servo.user_estimator import called


@dataclass(frozen=True, eq=False)
class Rerun:
    """What was recorded and what came out again."""

    then: Record
    """The record as it was written."""
    now: Record
    """The same with the decisions that came out again; it can be plotted as any record."""
    first: int | None
    """Index of the first tick that is not the same bit for bit; None where there is none."""
    differs: dict[str, int]
    """By column, at how many ticks it is not the same. A column without such ticks is left out."""
    open_loop: bool
    """Whether other settings than the recorded ones were given."""
    changed: str = ""
    """Which users' own estimators have another source than when they were recorded, in words; empty
    where none has."""

    @property
    def same(self) -> bool:
        """Whether every tick came out the same."""
        return self.first is None

    @property
    def numbers(self) -> dict[str, Any]:
        """Outcome as JSON has it."""
        return {
            "same": self.same,
            "open_loop": self.open_loop,
            "ticks": len(self.then.time),
            "first": self.first,
            "differs": self.differs,
            "missing": self.then.missing,
            "changed": self.changed,
        }

    @property
    def words(self) -> str:
        """The outcome in one sentence."""
        count = len(self.then.time)
        loop = "open loop, with other settings: " if self.open_loop else ""
        changed = f"; {self.changed}" if self.changed else ""
        if self.first is None:
            return f"{loop}all {count} ticks came out the same, bit for bit{changed}"
        most = max(self.differs.values())
        at = f"tick {self.first} ({self.then.time[self.first]:.2f} s)"
        return (
            f"{loop}from {at} on, {most} of {count} ticks came out otherwise, in "
            f"{', '.join(self.differs)}{changed}"
        )


def recompute(
    run: Path | Record,
    servo: Servo | None = None,
    own: Mapping[str, type[Estimator]] = NOBODY,
) -> Rerun:
    """Compute a recorded run again, with the recorded settings or with those of another `servo`.

    A recorded estimator that is not ours must be among the caller's `own` by its name.
    """
    then = run if isinstance(run, Record) else reader.read(run)
    if not then.stages and len(then.time):
        raise UnusableFile(then.path, "does not tell the servo of its ticks")
    rows: list[bytes] = []
    decided: list[tuple[str, ...]] = []
    kept: dict[int, Floats] = {}
    servos = [servo_of(then, stage, own) if servo is None else servo for stage in then.stages]
    for tick in _ticks(then, servos):
        rows.append(ros2_messages.encode_tick(tick))
        decided.append(ros2_messages.decode_names(rows[-1], TICK))
        numbers = memory.numbers_of(tick)
        if numbers is not None:
            kept[len(rows) - 1] = numbers
    words = {one.name: [row[i] for row in decided] for i, one in enumerate(WORDS)}
    ticks = ros2_messages.columns(TICK, rows) | memory.column(kept, len(rows))
    now = replace(then, ticks=ticks, words=words, operating=[])
    other = servo is not None and any(describe(servo) != stage.servo for stage in then.stages)
    return replace(_compared(then, now, other), changed=_changed(then.stages, servos))


def _changed(stages: Sequence[Stage], servos: Sequence[Servo]) -> str:
    """Which users' own estimators have another source now than when they were recorded."""
    names = {
        called(servo.estimator)
        for stage, servo in zip(stages, servos, strict=True)
        if stage.servo["estimator"].get("kind") == called(servo.estimator)
        and stage.source != source(servo.estimator)
    }
    return ", ".join(f"the source of {name} has changed since" for name in sorted(names))


def _ticks(then: Record, servos: Sequence[Servo]) -> Iterator[Tick]:
    """Every recorded tick with the state that comes out again. No `loop.run`: what was seen and
    requested is in the record, and nothing is sent."""
    ends: list[State] = []
    for number, (stage, servo) in enumerate(zip(then.stages, servos, strict=True)):
        state = _begun(then, stage, servo, ends)
        target = _aim(stage, state)
        servo.demand(target)
        last = then.stages[number + 1].first if number + 1 < len(then.stages) else len(then.time)
        for i in range(stage.first, last):
            seen, jog = _observation(then, i), then.ticks["jog"][i]
            request = then.named(Request, "request", i)
            state = servo.step(state, seen, target, request, jog)
            yield Tick(0, servo, seen, request, jog, state, then.ticks["applied"][i])
        ends.append(state)


def servo_of(then: Record, stage: Stage, own: Mapping[str, type[Estimator]] = NOBODY) -> Servo:
    """The servo of a stage; UnusableFile, naming the version that can rebuild it, where this one
    cannot."""
    try:
        return rebuild(stage.servo, own)
    except BadInput as error:
        wrote = stage.version or then.version
        other = f": replay it with rcmservo {wrote}, which has written it" * (wrote != __version__)
        why = f"its servo cannot be rebuilt: {error}{other}"
        raise UnusableFile(then.path, why) from error


def _begun(then: Record, stage: Stage, servo: Servo, ends: list[State]) -> State:
    """The state that a stage begins with."""
    if stage.origin == NOTHING:
        return servo.init()
    if stage.origin == ELSEWHERE:
        raise UnusableFile(then.path, "a stage goes on from a state that is not in this record")
    end = ends[stage.origin]
    return end if stage.mid_run else servo.again(end)


def _aim(stage: Stage, state: State) -> Target:
    """The stage's target: the state's own where it is the same, as another one begins a new way."""
    own = state.target
    return own if own is not None and same(own, stage.target) else stage.target


def _observation(then: Record, i: int) -> Observation:
    """What was seen at a tick."""
    ticks = then.ticks
    return Observation(
        now=int(ticks["now"][i, 0]),
        q=ticks["q"][i],
        q_time=int(ticks["q_time"][i, 0]),
        enabled=bool(ticks["enabled"][i, 0]),
        applied=ticks["applied_before"][i],
        frame=int(ticks["frame"][i, 0]),
        exposure=int(ticks["exposure"][i, 0]),
        arrival=int(ticks["arrival"][i, 0]),
        q_exposure=ticks["q_exposure"][i],
        points=ticks["points"][i].reshape(2, 2),
        dropped=then.named(Dropped, "dropped", i),
        recorded=bool(ticks["recorded"][i, 0]),
        sizes=ticks["sizes"][i],
        quality=ticks["quality"][i],
    )


def _compared(then: Record, now: Record, open_loop: bool) -> Rerun:
    """Both, column by column, down to the bits."""
    nothing = np.empty((len(then.time), 0))
    other = {
        name: _unlike(then.ticks.get(name, nothing), now.ticks.get(name, nothing))
        for name in {**then.ticks, **now.ticks}
    }
    for name in then.words:
        other[name] = np.array(
            [a != b for a, b in zip(then.words[name], now.words[name], strict=True)], dtype=bool
        )
    differs = {name: int(rows.sum()) for name, rows in other.items() if rows.any()}
    first = min((int(np.argmax(other[name])) for name in differs), default=None)
    return Rerun(then, now, first, differs, open_loop)


def _unlike(a: Column, b: Column) -> NDArray[np.bool_]:
    """At which rows two columns (N, size) differ in any bit."""
    if a.shape != b.shape:
        return np.ones(len(a), dtype=bool)
    width = a.shape[1] * a.itemsize
    bits_a, bits_b = (
        np.ascontiguousarray(column).view(np.uint8).reshape(-1, width) for column in (a, b)
    )
    return (bits_a != bits_b).any(axis=1)
