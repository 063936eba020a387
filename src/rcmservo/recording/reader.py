"""Reader of records: a run as columns of observations, estimates and decisions at each tick.

A truncated or damaged file is read up to the damage, and the record states what is missing. All
values are read as they were written, bit for bit; see mcap_recovery.py.
"""

import json
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from rcmservo.config.toml_json_parsing import Table, is_table
from rcmservo.errors import UnusableFile
from rcmservo.interfaces import Floats, Image
from rcmservo.recording import ros2_messages as ros2
from rcmservo.recording.mcap_recovery import Message, MessageReader
from rcmservo.recording.stage import Stage, parse_stage
from rcmservo.recording.tick_schema import NAME_COLUMNS, TRUTH_COLUMNS
from rcmservo.tracking import decode_image

RECORD = "record.mcap"
"""File name of a record in the folder of its run."""

TICK_TOPIC = "rcmservo/tick"
"""Topic of the ticks."""

MAX_PLANNED_DURATION_S = 1e9
"""Planned duration in s from which on a recorded value is ignored."""

Column = NDArray[Any]
Member = TypeVar("Member", bound=Enum)


@dataclass(frozen=True, eq=False, repr=False)
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

    def __repr__(self) -> str:
        """Return the file and the names of the columns, without their numbers."""
        return f"<Record of {len(self.time)} ticks, {self.path}, ticks: {', '.join(self.ticks)}>"

    @property
    def version(self) -> str:
        """Version of rcmservo that wrote the record; empty if unknown."""
        versions: object = self.about.get("versions")
        return str(versions.get("rcmservo", "")) if is_table(versions) else ""

    @property
    def planned(self) -> float | None:
        """Planned duration of the run in s, or None if unknown."""
        return _read_planned_duration(self.about)

    @property
    def phase(self) -> list[str]:
        """Name of the phase at each tick."""
        return self.words["phase"]

    @property
    def cause(self) -> list[str]:
        """Name of the cause at each tick."""
        return self.words["cause"]

    @property
    def complete(self) -> bool:
        """True if nothing is missing."""
        return not self.missing

    def enum_at(self, kind: type[Member], column: str, i: int) -> Member:
        """Return the enum member that a column of `words` names at tick `i`.

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
        is_new = np.diff(self.ticks["frame"][:, 0], prepend=-1) > 0
        return np.flatnonzero(is_new & (self.time >= since))


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
    path = find_record_file(path)
    messages = MessageReader(path)
    builder = _RecordBuilder(path)
    for message in messages:
        builder.add(message)
    if builder.about is None:
        raise UnusableFile(path, "is not a record of a run, or its start is damaged")
    try:
        return builder.build(builder.about, messages)
    except ValueError as error:
        raise UnusableFile(path, f"is a record that cannot be read: {error}") from error


def find_record_file(path: Path) -> Path:
    """Return the record's file, given the file or the folder of its run."""
    return path / RECORD if path.is_dir() else path


def has_ticks(path: Path) -> bool:
    """Return True if a record holds a tick; reading stops at the first one."""
    return any(message.topic == TICK_TOPIC for message in MessageReader(find_record_file(path)))


def iterate_frames(path: Path) -> Iterator[tuple[int, Image]]:
    """Yield the exposure (ns on the plant's clock) and the image of each recorded frame."""
    path = find_record_file(path)
    for exposure, jpeg in iterate_jpegs(path):
        yield exposure, decode_image(jpeg, path)


def iterate_jpegs(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield the exposure (ns on the plant's clock) and the JPEG file of each recorded frame."""
    path = find_record_file(path)
    for message in MessageReader(path):
        if message.topic == "image_raw/compressed":
            try:
                yield ros2.decode_picture(message.data)
            except ValueError as error:
                raise UnusableFile(path, f"holds a frame that cannot be read: {error}") from error


def build_memory_column(memories: Mapping[int, Floats], tick_count: int) -> dict[str, Column]:
    """Return the states of a user-defined estimator as the column `memory` (N, n) of N ticks.

    The result is empty if no state is recorded. A tick without a state, or with a smaller one than
    the largest, has NaN.

    Parameters
    ----------
    memories : Mapping of int to Floats
        Recorded states by the index of their tick; a state after the last tick is ignored.
    tick_count : int
        Number N of ticks.
    """
    states = {i: numbers for i, numbers in memories.items() if i < tick_count}
    if not states:
        return {}
    column = np.full((tick_count, max(map(len, states.values()))), np.nan)
    for i, numbers in states.items():
        column[i, : len(numbers)] = numbers
    return {"memory": column}


class _RecordBuilder:
    """Collector of the messages from which a record is built."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.about: Table | None = None
        self._times_ns: list[int] = []
        self._ticks: list[bytes] = []
        self._names: list[tuple[str, ...]] = []
        self._truth: list[bytes] = []
        self._stages: list[Stage] = []
        self._memories: dict[int, Floats] = {}
        self._operating: list[tuple[int, str]] = []
        self._layout = ros2.TICK
        self._names_by_encoding: dict[bytes, tuple[str, ...]] = {}

    def add(self, message: Message) -> None:
        """Store one message."""
        topic = message.topic
        if topic in ros2.TOPICS and message.definition not in _list_readable_definitions(topic):
            reason = f"its {topic} has an unknown format: another version of rcmservo wrote it"
            raise UnusableFile(self.path, reason)
        try:
            self._store(message)
        except (ValueError, RecursionError) as error:
            reason = f"holds a {topic} that cannot be read: {error}"
            raise UnusableFile(self.path, reason) from error

    def _store(self, message: Message) -> None:
        data, tick_count = message.data, len(self._ticks)
        match message.topic:
            case "rcmservo/tick":
                self._set_layout(ros2.TICKS[message.definition])
                self._times_ns.append(message.time)
                self._ticks.append(data)
                self._names.append(self._decode_names(data))
            case "rcmservo/memory":
                self._memories[tick_count] = ros2.decode_memory(data)
            case "operating_state":
                self._operating.append((tick_count, ros2.decode_operating_words(data)))
            case "rcmservo/truth":
                self._truth.append(data)
            case "rcmservo/stage":
                stage = parse_stage(_decode_json_object(data), tick_count, len(self._stages))
                self._stages.append(stage)
            case "rcmservo/about":
                self.about = _decode_json_object(data)
            case _:
                pass

    def _set_layout(self, layout: np.dtype[Any]) -> None:
        """Set the layout of the ticks, which must be the same for the whole record."""
        if self._ticks and layout != self._layout:
            raise ValueError("it is of another version than the ticks before it")
        self._layout = layout

    def _decode_names(self, tick: bytes) -> tuple[str, ...]:
        """Return the enum names at the end of a tick; few combinations of them exist."""
        encoding = tick[self._layout.itemsize :]
        if encoding not in self._names_by_encoding:
            self._names_by_encoding[encoding] = ros2.decode_names(tick, self._layout)
        return self._names_by_encoding[encoding]

    def build(self, about: Table, messages: MessageReader) -> Record:
        """Return all messages as columns."""
        time = np.array(self._times_ns, dtype=np.float64) * 1e-9
        last_time_s = float(time[-1]) if len(time) else 0.0
        ticks = ros2.decode_tick_columns(self._layout, self._ticks)
        return Record(
            path=self.path,
            about=about,
            time=time,
            ticks=ticks | build_memory_column(self._memories, len(time)),
            words=name_columns(self._names),
            operating=self._operating,
            truth=self._build_truth(),
            stages=self._stages,
            missing=_describe_missing(messages, last_time_s, _read_planned_duration(about)),
            unread=messages.unread,
        )

    def _build_truth(self) -> dict[str, Floats]:
        """Return the truth of each tick; NaN if the record ends between a tick and its truth."""
        truth = ros2.decode_columns(ros2.TRUTH_LAYOUT, self._truth)
        missing_rows = len(self._ticks) - len(self._truth) if self._truth else 0
        if missing_rows < 0:
            raise ValueError("it holds the truth of more ticks than it has")
        return {
            name: np.concatenate([truth[name], np.full((missing_rows, len(parts)), np.nan)])
            for name, parts in TRUTH_COLUMNS.items()
        }


def name_columns(names: list[tuple[str, ...]]) -> dict[str, list[str]]:
    """Return the enum names of each tick as columns: `Record.words`."""
    return {column.name: [row[i] for row in names] for i, column in enumerate(NAME_COLUMNS)}


def _list_readable_definitions(topic: str) -> Collection[str]:
    """Return the definitions of a topic's messages that this version can read."""
    return ros2.TICKS if topic == TICK_TOPIC else (ros2.DEFINITIONS[ros2.TOPICS[topic]],)


def _read_planned_duration(about: Table) -> float | None:
    """Return the planned duration of the run in s; None if it is unknown or implausible."""
    duration_s: Any = about.get("duration_s")
    is_valid = type(duration_s) in (int, float) and 0.0 < duration_s < MAX_PLANNED_DURATION_S
    return float(duration_s) if is_valid else None


def _describe_missing(messages: MessageReader, last_time_s: float, planned_s: float | None) -> str:
    """Return a sentence about the missing part of a file; empty if it is complete."""
    if messages.complete:
        return ""
    if messages.summary is not None:
        until = f"{last_time_s:.2f} s of {messages.summary.message_end_time * 1e-9:.2f} s"
        skipped = f"{messages.unread} of its {messages.size} bytes"
        return f"the record is damaged: it is read up to {until}, {skipped} are left out"
    planned = "" if planned_s is None else f" of the planned {planned_s:.2f} s"
    reason = "is damaged or cut off" if messages.unread else "was not ended"
    skipped = f"{messages.unread} bytes that follow are left out, " if messages.unread else ""
    return (
        f"the record {reason}: it is read up to {last_time_s:.2f} s{planned}, {skipped}and how "
        "much more there was is not known"
    )


def _decode_json_object(data: bytes) -> Table:
    """Return the JSON object in a std_msgs/String."""
    value: object = json.loads(ros2.decode_text(data))
    if not is_table(value):
        raise ValueError("it is no JSON object")
    return value
