"""A run as it was recorded, as columns: what the servo saw, knew and decided at every tick.

A file that was cut or damaged is read up to there, and the record says how much is missing. What is
read is as it was written, bit for bit: see mcap_recovery.py.
"""

import json
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from rcmservo.config.texts import is_table
from rcmservo.errors import UnusableFile
from rcmservo.interfaces import Floats, Image
from rcmservo.record import memory
from rcmservo.record.columns import TRUTH, WORDS
from rcmservo.record.mcap_recovery import Message, MessageReader
from rcmservo.record.ros2_messages import (
    DEFINITIONS,
    TICK,
    TICKS,
    TOPICS,
    TRUTH_LAYOUT,
    columns,
    decode_memory,
    decode_names,
    decode_operating_words,
    decode_picture,
    decode_text,
    tick_columns,
)
from rcmservo.record.stage import Stage, stage_of
from rcmservo.tracking import decode_image

RECORD = "record.mcap"
"""A record's name in the folder of its run."""

TICK_TOPIC = "rcmservo/tick"
"""On which its ticks are."""

LONGEST = 1e9
"""s from which on what a record tells as its run's length is none."""

Column = NDArray[Any]
Name = TypeVar("Name", bound=Enum)


@dataclass(frozen=True, eq=False)
class Record:
    """A run as columns, of N ticks."""

    path: Path
    """Its file."""
    about: dict[str, Any]
    """What the run was told: settings, seed, versions, how long it was `planned` to last."""
    time: Floats
    """(N,) s since the record's start."""
    ticks: dict[str, Column]
    """The ticks' numbers by column, (N, size) each; see columns.py."""
    words: dict[str, list[str]]
    """The ticks' names by column, N each, of which `phase` and `cause` stand out."""
    operating: list[tuple[int, str]]
    """What was said of the operating state, in words, each after the tick from which on."""
    truth: dict[str, Floats]
    """What the simulation knew, by name, (N, size) each; (0, size) where it is not in the
    record."""
    stages: list[Stage]
    """One after the other: which servo and target the ticks go by."""
    missing: str
    """What could not be read, in one sentence; empty where the record is `complete`."""
    unread: int
    """Bytes of the file that could not be read."""

    @property
    def version(self) -> str:
        """Which rcmservo has written it, as the run was told; empty where it does not tell."""
        versions: object = self.about.get("versions")
        return str(versions.get("rcmservo", "")) if is_table(versions) else ""

    @property
    def planned(self) -> float | None:
        """s that the run was to last, or None where the record does not tell."""
        return _planned(self.about)

    @property
    def phase(self) -> list[str]:
        """The phase at every tick."""
        return self.words["phase"]

    @property
    def cause(self) -> list[str]:
        """The cause at every tick."""
        return self.words["cause"]

    @property
    def complete(self) -> bool:
        """Whether nothing is missing."""
        return not self.missing

    def named(self, kind: type[Name], column: str, i: int) -> Name:
        """The member of an enum that a column of words names at tick `i`."""
        name = self.words[column][i]
        try:
            return kind[name]
        except KeyError as error:
            why = f"tells a {column} {name!r} that this version of rcmservo does not know"
            raise UnusableFile(self.path, why) from error

    def new_frames(self, since: float = 0.0) -> NDArray[np.intp]:
        """The ticks from `since` s on at which a new frame had come."""
        new = np.diff(self.ticks["frame"][:, 0], prepend=-1) > 0
        return np.flatnonzero(new & (self.time >= since))


def file_of(path: Path) -> Path:
    """The record's file, given that or the folder of its run."""
    return path / RECORD if path.is_dir() else path


def begun(path: Path) -> bool:
    """Whether a record holds a tick; it is read no further than to the first."""
    return any(message.topic == TICK_TOPIC for message in MessageReader(file_of(path)))


def read(path: Path) -> Record:
    """A run from its folder or MCAP file, up to its end or to where it was cut or damaged."""
    path = file_of(path)
    messages = MessageReader(path)
    rows = _Rows(path)
    for message in messages:
        rows.add(message)
    if rows.about is None:
        raise UnusableFile(path, "is not a record of a run, or its start is damaged")
    try:
        return rows.record(messages)
    except ValueError as error:
        raise UnusableFile(path, f"is a record that cannot be read: {error}") from error


def frames(path: Path) -> Iterator[tuple[int, Image]]:
    """The exposures (ns on the plant's clock, as in the ticks) and pictures of a record's frames,
    one at a time."""
    path = file_of(path)
    for exposure, data in pictures(path):
        yield exposure, decode_image(data, path)


def pictures(path: Path) -> Iterator[tuple[int, bytes]]:
    """The exposures of a record's frames, and their pictures as the JPEG files that they are kept
    as."""
    path = file_of(path)
    for message in MessageReader(path):
        if message.topic == "image_raw/compressed":
            try:
                yield decode_picture(message.data)
            except ValueError as error:
                raise UnusableFile(path, f"holds a frame that cannot be read: {error}") from error


class _Rows:
    """A record's messages as they come."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.about: object = None
        self.times: list[int] = []
        self.ticks: list[bytes] = []
        self.truth: list[bytes] = []
        self.stages: list[Stage] = []
        self.memory: dict[int, Floats] = {}
        self.operating: list[tuple[int, str]] = []
        self._layout = TICK
        self._tails: dict[bytes, tuple[str, ...]] = {}
        self._words: list[tuple[str, ...]] = []

    def add(self, message: Message) -> None:
        """Keep one message."""
        topic = message.topic
        if topic in TOPICS and message.definition not in _definitions(topic):
            raise UnusableFile(
                self.path,
                f"its {topic} has another form: another version of rcmservo has written it",
            )
        try:
            self._keep(topic, message)
        except (ValueError, RecursionError) as error:
            raise UnusableFile(
                self.path, f"holds a {topic} that cannot be read: {error}"
            ) from error

    def _keep(self, topic: str, message: Message) -> None:
        if topic == TICK_TOPIC:
            self._take(TICKS[message.definition])
            self.times.append(message.time)
            self.ticks.append(message.data)
            self._words.append(self._tail(message.data))
        elif topic == memory.TOPIC:
            self.memory[len(self.ticks)] = decode_memory(message.data)
        elif topic == "operating_state":
            self.operating.append((len(self.ticks), decode_operating_words(message.data)))
        elif topic == "rcmservo/truth":
            self.truth.append(message.data)
        elif topic == "rcmservo/stage":
            self.stages.append(stage_of(_json(message.data), len(self.ticks), len(self.stages)))
        elif topic == "rcmservo/about":
            self.about = _json(message.data)

    def _take(self, layout: np.dtype[Any]) -> None:
        """Read ticks of this layout: a record's are all of one."""
        if self.ticks and layout != self._layout:
            raise ValueError("it is of another version than those before")
        self._layout = layout

    def _tail(self, data: bytes) -> tuple[str, ...]:
        tail = data[self._layout.itemsize :]
        words = self._tails.get(tail)
        if words is None:
            words = self._tails[tail] = decode_names(data, self._layout)
        return words

    def record(self, messages: MessageReader) -> Record:
        """All of it as columns."""
        time = np.array(self.times, dtype=np.float64) * 1e-9
        return Record(
            path=self.path,
            about=self.about if is_table(self.about) else {},
            time=time,
            ticks=tick_columns(self._layout, self.ticks)
            | memory.column(self.memory, len(self.ticks)),
            words={one.name: [row[i] for row in self._words] for i, one in enumerate(WORDS)},
            operating=self.operating,
            truth=self._truth(),
            stages=self.stages,
            missing=_missing(messages, float(time[-1]) if len(time) else 0.0, _planned(self.about)),
            unread=messages.unread,
        )

    def _truth(self) -> dict[str, Floats]:
        """The truth of every tick, NaN where the record ends between a tick and its truth."""
        truth = columns(TRUTH_LAYOUT, self.truth)
        lost = len(self.ticks) - len(self.truth) if self.truth else 0
        if lost < 0:
            raise ValueError("it tells the truth of more ticks than it has")
        return {
            name: np.concatenate([truth[name], np.full((lost, len(parts)), np.nan)])
            for name, parts in TRUTH.items()
        }


def _definitions(topic: str) -> Collection[str]:
    """Those of a topic's messages that can be read."""
    return TICKS if topic == TICK_TOPIC else (DEFINITIONS[TOPICS[topic]],)


def _planned(about: object) -> float | None:
    seconds: Any = about.get("duration_s") if is_table(about) else None
    return float(seconds) if type(seconds) in (int, float) and 0.0 < seconds < LONGEST else None


def _missing(messages: MessageReader, last: float, planned: float | None) -> str:
    """What is missing of a file, in one sentence; empty if nothing is."""
    if messages.complete:
        return ""
    if messages.summary is not None:
        until = f"{last:.2f} s of {messages.summary.message_end_time * 1e-9:.2f} s"
        left_out = f"{messages.unread} of its {messages.size} bytes"
        return f"the record is damaged: it is read up to {until}, {left_out} are left out"
    until = f"{last:.2f} s" if planned is None else f"{last:.2f} s of the planned {planned:.2f} s"
    why = "is damaged or cut off" if messages.unread else "was not ended"
    left_out = f"{messages.unread} bytes that follow are left out, " if messages.unread else ""
    return (
        f"the record {why}: it is read up to {until}, {left_out}and how much more there was "
        f"is not known"
    )


def _json(data: bytes) -> object:
    """The object in a std_msgs/String."""
    value: object = json.loads(decode_text(data))
    if not is_table(value):
        raise ValueError("it is no JSON object")
    return value
