"""What a record tells at a glance: its beginning and its last ticks, however long it is."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.config.texts import is_table
from rcmservo.errors import UnusableFile
from rcmservo.guard.causes import Cause
from rcmservo.guard.states import Phase
from rcmservo.record.columns import WORDS
from rcmservo.record.mcap_recovery import MAGIC, MessageReader, find_chunks, read_chunk
from rcmservo.record.reader import TICK_TOPIC
from rcmservo.record.ros2_messages import TICKS, decode_names, decode_text

LAST = 20
"""Chunks at the end among which there must be a tick."""


@dataclass(frozen=True)
class Glance:
    """A record in a few words."""

    about: dict[str, Any]
    """What the run was told."""
    servo: Any
    """The description of its first servo; empty where there is none."""
    seconds: float
    """To its last tick."""
    phase: str
    """That of its last tick, in words; empty where it has none."""
    cause: str
    """That of its last tick, in words; empty where all was well."""
    ended: bool
    """Whether the file was ended in order."""


def glance(path: Path) -> Glance:
    """Look at a record's file. What is between its ends is not looked at."""
    messages = MessageReader(path)
    about, servo, layout = None, {}, None
    for message in messages:
        if message.topic == TICK_TOPIC:
            layout = TICKS.get(message.definition)
            break
        if message.topic == "rcmservo/about":
            about = _table(message.data)
        elif message.topic == "rcmservo/stage":
            servo = _table(message.data).get("servo", {})
    if about is None:
        raise UnusableFile(path, "is not a record of a run, or its start is damaged")
    seconds, phase, cause = 0.0, "", ""
    if layout is not None:
        time, words = _last(path, messages.channel(TICK_TOPIC), layout)
        seconds = time * 1e-9
        phase, cause = _word(Phase, words.get("phase", "")), _word(Cause, words.get("cause", ""))
    return Glance(about, servo, seconds, phase, cause, _ended(path))


def _last(path: Path, channel: int, layout: np.dtype[Any]) -> tuple[int, dict[str, str]]:
    """Time ns and names of the last tick."""
    for place in reversed(find_chunks(path)[-LAST:]):
        for message in reversed(read_chunk(path, place)):
            if message.channel_id == channel:
                names = decode_names(message.data, layout)
                return message.log_time, {
                    one.name: name for one, name in zip(WORDS, names, strict=True)
                }
    return 0, {}


def _word(kind: type[Phase] | type[Cause], name: str) -> str:
    return kind[name].value if name in kind.__members__ else name


def _table(data: bytes) -> dict[str, Any]:
    value: object = json.loads(decode_text(data))
    return value if is_table(value) else {}


def _ended(path: Path) -> bool:
    """Whether the file ends as one that was ended in order."""
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - len(MAGIC), 0))
        return file.read() == MAGIC and path.stat().st_size > 2 * len(MAGIC)
