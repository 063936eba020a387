"""Reader of records: a run as columns of observations, estimates and decisions at each tick.

A truncated or damaged file is read up to the damage, and the record states what is missing. All
values are read as they were written, bit for bit; see mcap_recovery.py.
"""

import json
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from rcmservo.config.toml_json_parsing import is_table
from rcmservo.errors import UnusableFile
from rcmservo.interfaces import Floats, Image
from rcmservo.recording import estimator_memory
from rcmservo.recording.mcap_recovery import Message, MessageReader
from rcmservo.recording.ros2_messages import (
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
from rcmservo.recording.stage import Stage, stage_of
from rcmservo.recording.tick_schema import NAME_COLUMNS, TRUTH_COLUMNS
from rcmservo.tracking import decode_image

RECORD = "record.mcap"
"""File name of a record in the folder of its run."""

TICK_TOPIC = "rcmservo/tick"
"""Topic of the ticks."""

MAX_PLANNED_DURATION_S = 1e9
"""Planned duration (s) from which on a recorded value is ignored."""

Column = NDArray[Any]
Name = TypeVar("Name", bound=Enum)


@dataclass(frozen=True, eq=False)
class Record:
    """Run of N ticks as columns.

    Parameters
    ----------
    path : Path
        File of the record.
    about : dict[str, Any]
        Settings, seed and versions of the run, and its planned duration.
    time : Floats
        Time of each tick (N,) in s since the start of the record.
    ticks : dict[str, Column]
        Values of the ticks by column name, (N, size) each; see tick_schema.py.
    words : dict[str, list[str]]
        Enum names of the ticks by column name, N each, such as `phase` and `cause`.
    operating : list[tuple[int, str]]
        Operating states as sentences, each with the index of its first tick.
    truth : dict[str, Floats]
        Values known to the simulation by name, (N, size) each; (0, size) if the record has none.
    stages : list[Stage]
        Stages in order, with the servo and target of their ticks.
    missing : str
        Sentence about the part that could not be read; empty if the record is `complete`.
    unread : int
        Bytes of the file that could not be read.
    """

    path: Path
    about: dict[str, Any]
    time: Floats
    ticks: dict[str, Column]
    words: dict[str, list[str]]
    operating: list[tuple[int, str]]
    truth: dict[str, Floats]
    stages: list[Stage]
    missing: str
    unread: int

    @property
    def version(self) -> str:
        """Version of rcmservo that wrote the record; empty if unknown."""
        versions: object = self.about.get("versions")
        return str(versions.get("rcmservo", "")) if is_table(versions) else ""

    @property
    def planned(self) -> float | None:
        """Planned duration of the run in s, or None if unknown."""
        return _planned(self.about)

    @property
    def phase(self) -> list[str]:
        """Phase at each tick."""
        return self.words["phase"]

    @property
    def cause(self) -> list[str]:
        """Cause at each tick."""
        return self.words["cause"]

    @property
    def complete(self) -> bool:
        """True if nothing is missing."""
        return not self.missing

    def enum_at(self, kind: type[Name], column: str, i: int) -> Name:
        """Return the enum member in a column of words at tick `i`.

        Raises
        ------
        UnusableFile
            If this version has no member of that name.
        """
        name = self.words[column][i]
        try:
            return kind[name]
        except KeyError as error:
            reason = f"has the {column} {name!r}, which this version of rcmservo does not know"
            raise UnusableFile(self.path, reason) from error

    def new_frames(self, since: float = 0.0) -> NDArray[np.intp]:
        """Return the indices of ticks with a new frame, from `since` s on."""
        new = np.diff(self.ticks["frame"][:, 0], prepend=-1) > 0
        return np.flatnonzero(new & (self.time >= since))


def record_file(path: Path) -> Path:
    """Return the record's file, given the file or the folder of its run."""
    return path / RECORD if path.is_dir() else path


def has_ticks(path: Path) -> bool:
    """Report whether a record holds a tick; reading stops at the first one."""
    return any(message.topic == TICK_TOPIC for message in MessageReader(record_file(path)))


def read_record(path: Path) -> Record:
    """Read a run up to its end or to the damage.

    Parameters
    ----------
    path : Path
        Folder of the run, or its MCAP file.

    Raises
    ------
    UnusableFile
        If the file is no record, its start is damaged, or another version wrote it in a format that
        this version cannot read.
    """
    path = record_file(path)
    messages = MessageReader(path)
    rows = _RecordBuilder(path)
    for message in messages:
        rows.add(message)
    if rows.about is None:
        raise UnusableFile(path, "is not a record of a run, or its start is damaged")
    try:
        return rows.build(messages)
    except ValueError as error:
        raise UnusableFile(path, f"is a record that cannot be read: {error}") from error


def iterate_frames(path: Path) -> Iterator[tuple[int, Image]]:
    """Yield the exposure (ns on the plant's clock) and the image of each recorded frame."""
    path = record_file(path)
    for exposure, data in iterate_jpegs(path):
        yield exposure, decode_image(data, path)


def iterate_jpegs(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield the exposure (ns on the plant's clock) and the JPEG file of each recorded frame."""
    path = record_file(path)
    for message in MessageReader(path):
        if message.topic == "image_raw/compressed":
            try:
                yield decode_picture(message.data)
            except ValueError as error:
                raise UnusableFile(path, f"holds a frame that cannot be read: {error}") from error


class _RecordBuilder:
    """Collector of a record's messages."""

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
        """Store one message."""
        topic = message.topic
        if topic in TOPICS and message.definition not in _definitions(topic):
            raise UnusableFile(
                self.path,
                f"its {topic} has an unknown format: another version of rcmservo wrote it",
            )
        try:
            self._store(topic, message)
        except (ValueError, RecursionError) as error:
            raise UnusableFile(
                self.path, f"holds a {topic} that cannot be read: {error}"
            ) from error

    def _store(self, topic: str, message: Message) -> None:
        if topic == TICK_TOPIC:
            self._check_layout(TICKS[message.definition])
            self.times.append(message.time)
            self.ticks.append(message.data)
            self._words.append(self._decode_names(message.data))
        elif topic == estimator_memory.TOPIC:
            self.memory[len(self.ticks)] = decode_memory(message.data)
        elif topic == "operating_state":
            self.operating.append((len(self.ticks), decode_operating_words(message.data)))
        elif topic == "rcmservo/truth":
            self.truth.append(message.data)
        elif topic == "rcmservo/stage":
            self.stages.append(stage_of(_json(message.data), len(self.ticks), len(self.stages)))
        elif topic == "rcmservo/about":
            self.about = _json(message.data)

    def _check_layout(self, layout: np.dtype[Any]) -> None:
        """Set the layout of the ticks, which must be the same for the whole record."""
        if self.ticks and layout != self._layout:
            raise ValueError("it is of another version than the ticks before it")
        self._layout = layout

    def _decode_names(self, data: bytes) -> tuple[str, ...]:
        tail = data[self._layout.itemsize :]
        words = self._tails.get(tail)
        if words is None:
            words = self._tails[tail] = decode_names(data, self._layout)
        return words

    def build(self, messages: MessageReader) -> Record:
        """Return all messages as columns."""
        time = np.array(self.times, dtype=np.float64) * 1e-9
        return Record(
            path=self.path,
            about=self.about if is_table(self.about) else {},
            time=time,
            ticks=tick_columns(self._layout, self.ticks)
            | estimator_memory.memory_column(self.memory, len(self.ticks)),
            words={
                column.name: [row[i] for row in self._words]
                for i, column in enumerate(NAME_COLUMNS)
            },
            operating=self.operating,
            truth=self._truth(),
            stages=self.stages,
            missing=_missing(messages, float(time[-1]) if len(time) else 0.0, _planned(self.about)),
            unread=messages.unread,
        )

    def _truth(self) -> dict[str, Floats]:
        """Return the truth of each tick; NaN if the record ends between a tick and its truth."""
        truth = columns(TRUTH_LAYOUT, self.truth)
        missing_rows = len(self.ticks) - len(self.truth) if self.truth else 0
        if missing_rows < 0:
            raise ValueError("it holds the truth of more ticks than it has")
        return {
            name: np.concatenate([truth[name], np.full((missing_rows, len(parts)), np.nan)])
            for name, parts in TRUTH_COLUMNS.items()
        }


def _definitions(topic: str) -> Collection[str]:
    """Return the definitions of a topic's messages that can be read."""
    return TICKS if topic == TICK_TOPIC else (DEFINITIONS[TOPICS[topic]],)


def _planned(about: object) -> float | None:
    seconds: Any = about.get("duration_s") if is_table(about) else None
    is_valid = type(seconds) in (int, float) and 0.0 < seconds < MAX_PLANNED_DURATION_S
    return float(seconds) if is_valid else None


def _missing(messages: MessageReader, last: float, planned: float | None) -> str:
    """Return a sentence about the missing part of a file; empty if it is complete."""
    if messages.complete:
        return ""
    if messages.summary is not None:
        until = f"{last:.2f} s of {messages.summary.message_end_time * 1e-9:.2f} s"
        skipped = f"{messages.unread} of its {messages.size} bytes"
        return f"the record is damaged: it is read up to {until}, {skipped} are left out"
    until = f"{last:.2f} s" if planned is None else f"{last:.2f} s of the planned {planned:.2f} s"
    reason = "is damaged or cut off" if messages.unread else "was not ended"
    skipped = f"{messages.unread} bytes that follow are left out, " if messages.unread else ""
    return (
        f"the record {reason}: it is read up to {until}, {skipped}and how much more there was "
        f"is not known"
    )


def _json(data: bytes) -> object:
    """Return the JSON object in a std_msgs/String."""
    value: object = json.loads(decode_text(data))
    if not is_table(value):
        raise ValueError("it is no JSON object")
    return value
