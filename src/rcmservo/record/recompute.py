"""A recorded run computed again: every stage's servo is stepped through what it saw, and must
decide the same.

With the recorded settings the answer is the same bit for bit, as a step depends on nothing else.
With other settings it is what the servo would have decided on what was seen then. That is open
loop: the arm would have gone elsewhere, and the camera would have seen something else.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rcmservo.config.servo_json import describe, rebuild
from rcmservo.errors import BadInput, UnusableFile
from rcmservo.guard.states import Request
from rcmservo.interfaces import Dropped, Observation, Target
from rcmservo.loop.operator import same
from rcmservo.loop.tick import Tick
from rcmservo.record import layout, reader
from rcmservo.record.columns import WORDS
from rcmservo.record.layout import TICK
from rcmservo.record.reader import Column, Record
from rcmservo.record.stage import ELSEWHERE, NOTHING, Stage
from rcmservo.servo.servo import Servo, State


@dataclass(frozen=True, eq=False)
class Rerun:
    """What was recorded and what came out again: ``then`` and ``now``, both as records that can be
    plotted.

    ``differs`` counts by column the ticks at which they are not the same bit for bit, and ``first``
    is the first such tick (None: there is none). ``open_loop`` tells whether other settings than
    the recorded ones were given.
    """

    then: Record
    now: Record
    first: int | None
    differs: dict[str, int]
    open_loop: bool

    @property
    def same(self) -> bool:
        """Whether every tick came out the same."""
        return self.first is None

    @property
    def words(self) -> str:
        """The outcome in one sentence."""
        count = len(self.then.time)
        loop = "open loop, with other settings: " if self.open_loop else ""
        if self.first is None:
            return f"{loop}all {count} ticks came out the same, bit for bit"
        most = max(self.differs.values())
        at = f"tick {self.first} ({self.then.time[self.first]:.2f} s)"
        return (
            f"{loop}from {at} on, {most} of {count} ticks came out otherwise, in "
            f"{', '.join(self.differs)}"
        )


def recompute(run: Path | Record, servo: Servo | None = None) -> Rerun:
    """Compute a recorded run again, with the recorded settings or with those of another `servo`."""
    then = run if isinstance(run, Record) else reader.read(run)
    if not then.stages and len(then.time):
        raise UnusableFile(then.path, "does not tell the servo of its ticks")
    rows: list[bytes] = []
    decided: list[tuple[str, ...]] = []
    for tick in _ticks(then, servo):
        rows.append(layout.tick(tick))
        decided.append(layout.words_of(rows[-1], TICK.itemsize, len(WORDS)))
    words = {one.name: [row[i] for row in decided] for i, one in enumerate(WORDS)}
    now = replace(then, ticks=layout.columns(TICK, rows), words=words)
    other = servo is not None and any(describe(servo) != stage.servo for stage in then.stages)
    return _compared(then, now, other)


def _ticks(then: Record, given: Servo | None) -> Iterator[Tick]:
    """Every recorded tick with the state that comes out again."""
    ends: list[State] = []
    for number, stage in enumerate(then.stages):
        servo = _servo(then, stage) if given is None else given
        state = _begun(then, stage, servo, ends)
        target = _aim(stage, state)
        last = then.stages[number + 1].first if number + 1 < len(then.stages) else len(then.time)
        for i in range(stage.first, last):
            seen, request = _observation(then, i), then.named(Request, "request", i)
            state = servo.step(state, seen, target, request)
            yield Tick(0, servo, seen, request, state, then.ticks["applied"][i])
        ends.append(state)


def _servo(then: Record, stage: Stage) -> Servo:
    try:
        return rebuild(stage.servo)
    except BadInput as error:
        raise UnusableFile(then.path, f"its servo cannot be rebuilt, give one: {error}") from error


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
    )


def _compared(then: Record, now: Record, open_loop: bool) -> Rerun:
    """Both, column by column, down to the bits."""
    other = {name: _unlike(then.ticks[name], now.ticks[name]) for name in then.ticks}
    for name in then.words:
        other[name] = np.array(
            [a != b for a, b in zip(then.words[name], now.words[name], strict=True)], dtype=bool
        )
    differs = {name: int(rows.sum()) for name, rows in other.items() if rows.any()}
    first = min((int(np.argmax(other[name])) for name in differs), default=None)
    return Rerun(then, now, first, differs, open_loop)


def _unlike(a: Column, b: Column) -> NDArray[np.bool_]:
    """At which rows two columns (N, size) differ in any bit."""
    width = a.shape[1] * a.itemsize
    bits_a, bits_b = (
        np.ascontiguousarray(column).view(np.uint8).reshape(-1, width) for column in (a, b)
    )
    return (bits_a != bits_b).any(axis=1)
