"""Summary of a record from its first and last messages, without reading the rest."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.config.toml_json_parsing import is_table
from rcmservo.errors import UnusableFile
from rcmservo.recording.mcap_recovery import MAGIC, MessageReader, find_chunks, read_chunk
from rcmservo.recording.reader import TICK_TOPIC
from rcmservo.recording.ros2_messages import TICKS, decode_names, decode_text
from rcmservo.recording.tick_schema import NAME_COLUMNS
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Phase

MAX_CHUNKS_SEARCHED = 20
"""Number of chunks at the end that are searched for the last tick."""


@dataclass(frozen=True)
class RecordHeader:
    """Settings, last state and completeness of a record.

    Parameters
    ----------
    settings : dict[str, Any]
        Settings, seed and versions of the run.
    servo : Any
        Description of the first servo; empty if there is none.
    seconds : float
        Time of the last tick in s.
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
    about, servo, layout = None, {}, None
    for message in messages:
        if message.topic == TICK_TOPIC:
            layout = TICKS.get(message.definition)
            break
        if message.topic == "rcmservo/about":
            about = _json_object(message.data)
        elif message.topic == "rcmservo/stage":
            servo = _json_object(message.data).get("servo", {})
    if about is None:
        raise UnusableFile(path, "is not a record of a run, or its start is damaged")
    seconds, phase, cause = 0.0, "", ""
    if layout is not None:
        time, words = _last_tick(path, messages.channel(TICK_TOPIC), layout)
        seconds = time * 1e-9
        phase = _sentence(Phase, words.get("phase", ""))
        cause = _sentence(Cause, words.get("cause", ""))
    return RecordHeader(about, servo, seconds, phase, cause, _is_closed(path))


def _last_tick(path: Path, channel: int, layout: np.dtype[Any]) -> tuple[int, dict[str, str]]:
    """Return the time (ns) and the names of the last tick."""
    for position in reversed(find_chunks(path)[-MAX_CHUNKS_SEARCHED:]):
        for message in reversed(read_chunk(path, position)):
            if message.channel_id == channel:
                names = decode_names(message.data, layout)
                return message.log_time, {
                    column.name: name for column, name in zip(NAME_COLUMNS, names, strict=True)
                }
    return 0, {}


def _sentence(kind: type[Phase] | type[Cause], name: str) -> str:
    return kind[name].value if name in kind.__members__ else name


def _json_object(data: bytes) -> dict[str, Any]:
    value: object = json.loads(decode_text(data))
    return value if is_table(value) else {}


def _is_closed(path: Path) -> bool:
    """Report whether the file ends like one that was closed properly."""
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - len(MAGIC), 0))
        return file.read() == MAGIC and path.stat().st_size > 2 * len(MAGIC)
