"""Summary of a record from its first and last messages, so that long records list quickly."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.config.toml_json_parsing import Table, is_table
from rcmservo.errors import UnusableFile
from rcmservo.recording.mcap_recovery import MAGIC, MessageReader, find_chunks, read_chunk
from rcmservo.recording.reader import TICK_TOPIC
from rcmservo.recording.ros2_messages import TICKS, decode_names, decode_text
from rcmservo.recording.tick_schema import NAME_COLUMNS
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Phase

MAX_CHUNKS_SEARCHED = 20
"""Number of chunks (groups of messages) at the end that are searched for the last tick."""


@dataclass(frozen=True)
class RecordHeader:
    """Settings, last state and completeness of a record.

    Parameters
    ----------
    settings : dict[str, Any]
        Settings, seed and versions of the run.
    servo : Any
        JSON description of the servo before the first tick; empty if there is none.
    seconds : float
        Time of the last tick in s since the start of the record; 0 without a tick.
    phase : str
        Phase at the last tick, as a sentence; empty without a tick.
    cause : str
        Cause at the last tick, as a sentence; empty if there is none.
    is_closed : bool
        True if the file was closed properly.
    """

    settings: dict[str, Any]
    servo: Any
    seconds: float
    phase: str
    cause: str
    is_closed: bool


def read_header(path: Path) -> RecordHeader:
    """Return the summary of a record file.

    Raises
    ------
    UnusableFile
        If the file is no record or its start is damaged.
    """
    messages = MessageReader(path)
    about, servo, tick_layout = None, {}, None
    for message in messages:
        if message.topic == TICK_TOPIC:
            tick_layout = TICKS.get(message.definition)
            break
        if message.topic == "rcmservo/about":
            about = _decode_json_object(message.data)
        elif message.topic == "rcmservo/stage":
            servo = _decode_json_object(message.data).get("servo", {})
    if about is None:
        raise UnusableFile(path, "is not a record of a run, or its start is damaged")
    time_ns, names = 0, dict[str, str]()
    if tick_layout is not None:
        time_ns, names = _read_last_tick(path, messages.channel(TICK_TOPIC), tick_layout)
    phase = _describe_member(Phase, names.get("phase", ""))
    cause = _describe_member(Cause, names.get("cause", ""))
    return RecordHeader(about, servo, time_ns * 1e-9, phase, cause, _is_closed(path))


def _read_last_tick(path: Path, channel: int, layout: np.dtype[Any]) -> tuple[int, dict[str, str]]:
    """Return the time (ns) of the last tick and the names of its phase, cause and other enums."""
    for position in reversed(find_chunks(path)[-MAX_CHUNKS_SEARCHED:]):
        for message in reversed(read_chunk(path, position)):
            if message.channel_id == channel:
                columns = (column.name for column in NAME_COLUMNS)
                names = decode_names(message.data, layout)
                return message.log_time, dict(zip(columns, names, strict=True))
    return 0, {}


def _describe_member(kind: type[Phase] | type[Cause], name: str) -> str:
    """Return the sentence of an enum member; the name itself if this version does not know it."""
    return kind[name].value if name in kind.__members__ else name


def _decode_json_object(data: bytes) -> Table:
    """Return the JSON object in a std_msgs/String; empty if it is another JSON value."""
    value: object = json.loads(decode_text(data))
    return value if is_table(value) else {}


def _is_closed(path: Path) -> bool:
    """Return True if the file ends like one that was closed properly."""
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(size - len(MAGIC), 0))
        return file.read() == MAGIC and size > 2 * len(MAGIC)
