"""A run on disk: every tick as ROS 2 messages in an MCAP file, under CRTK's topic names where CRTK has one.

    measured_js, servo_jv   sensor_msgs/JointState   the joints as measured and as commanded (rad and m, SI)
    rcmservo/tick           rcmservo_msgs/Tick       all that the servo saw, knew and decided (mm, px, rad)
    rcmservo/truth          rcmservo_msgs/Truth      simulation only: what the servo must not know

Chunks are small and carry CRCs, so that a run that was cut short is readable up to its end.
"""

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np
from mcap.exceptions import McapError
from mcap.records import Channel, Footer, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer
from zstandard import ZstdError

from rcmservo.errors import UnusableFile
from rcmservo.loop import Tick
from rcmservo.plant import Floats
from rcmservo.servo import Servo

CHUNK = 16 * 1024

TICK_FIELDS = {
    "frame": 1,
    "exposure": 1,
    "q": 3,
    "q_exposure": 3,
    "points": 4,
    "o_c": 2,
    "rcm_condition": 1,
    "p1": 3,
    "y": 3,
    "delta": 3,
    "J_hat": 9,
    "condition": 1,
    "model": 4,
    "v": 3,
    "command": 3,
    "applied": 3,
}
"""Name and length of the numbers of a tick; `model` is π (34) of both markers from o_c, NaN where there is none."""

TRUTH_FIELDS = {"p1": 3, "p2": 3, "jacobian_error": 1}

DAMAGE = (McapError, ZstdError, struct.error, EOFError, ValueError, KeyError)
"""What reading a file that was cut or damaged raises, beyond its format's own error."""

HEADER = """\
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
JOINT_STATE = (
    "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n" + HEADER
)


def _definition(numbers: dict[str, int], words: tuple[str, ...] = ()) -> str:
    lines = [f"float64[{size}] {name.lower()}" for name, size in numbers.items()]
    return "\n".join(["std_msgs/Header header", *(f"string {word}" for word in words), *lines, HEADER])


class Recorder:
    """Writes a run while it happens; use it as a context, so that the file is ended however the run ends."""

    def __init__(self, path: Path, servo: Servo, about: dict[str, Any]) -> None:
        self._servo = servo
        self._file: IO[bytes] = path.open("xb")
        self._writer = Writer(self._file, chunk_size=CHUNK)
        self._joints = self._writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        self._tick = self._writer.register_msgdef(
            "rcmservo_msgs/msg/Tick", _definition(TICK_FIELDS, ("phase", "cause"))
        )
        self._truth = self._writer.register_msgdef("rcmservo_msgs/msg/Truth", _definition(TRUTH_FIELDS))
        self._writer.add_metadata("rcmservo", {"about": json.dumps(about)})

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.finish()
        self._file.close()

    def write(self, tick: Tick) -> None:
        """Add one tick of the loop."""
        numbers = tick_numbers(tick, self._servo)
        state = tick.state
        self._send("rcmservo/tick", self._tick, tick.time, numbers, phase=state.phase.name, cause=state.cause.name)
        self._send_joints("measured_js", tick.time, tick.seen.q, np.full(3, np.nan))
        self._send_joints("servo_jv", tick.time, np.full(3, np.nan), state.command.rates)

    def write_truth(self, time: int, p1: Floats, p2: Floats, jacobian_error: float) -> None:
        """Add what a simulation knows at a tick: the markers (3,) mm, and the scaled relative error of Ĵ."""
        self._send("rcmservo/truth", self._truth, time, {"p1": p1, "p2": p2, "jacobian_error": jacobian_error})

    def _send_joints(self, topic: str, time: int, q: Floats, rates: Floats) -> None:
        si = np.array([1.0, 1.0, 1e-3])
        message = {
            "header": _header(time),
            "name": list(self._servo.mechanism.joint_names),
            "position": (q * si).tolist() if np.isfinite(q).all() else [],
            "velocity": (rates * si).tolist() if np.isfinite(rates).all() else [],
            "effort": [],
        }
        self._writer.write_message(topic, self._joints, message, time, time)

    def _send(self, topic: str, schema: Any, time: int, numbers: dict[str, Any], **words: str) -> None:
        lists = {name.lower(): np.ravel(value).astype(float).tolist() for name, value in numbers.items()}
        self._writer.write_message(topic, schema, {"header": _header(time), **words, **lists}, time, time)


def _header(time: int) -> dict[str, Any]:
    return {"stamp": {"sec": time // 10**9, "nanosec": time % 10**9}, "frame_id": ""}


def tick_numbers(tick: Tick, servo: Servo) -> dict[str, Any]:
    """The numbers of a tick, by the names of TICK_FIELDS."""
    state, seen = tick.state, tick.seen
    model = servo.estimator.predict(state.memory, servo.tool, state.p1)
    return {
        "frame": seen.frame,
        "exposure": seen.exposure,
        "q": seen.q,
        "q_exposure": seen.q_exposure,
        "points": seen.points,
        "o_c": state.o_c,
        "rcm_condition": state.rcm_condition,
        "p1": state.p1,
        "y": state.y,
        "delta": state.delta,
        "J_hat": state.J_hat,
        "condition": state.condition,
        "model": np.full(4, np.nan) if model is None else model,
        "v": state.v,
        "command": state.command.rates,
        "applied": tick.applied,
    }


@dataclass(frozen=True, eq=False)
class Record:
    """A run as columns: ``time`` (N,) s; ``ticks`` and ``truth`` by name, (N, size) each; ``phase``, ``cause`` names.

    ``about`` is what the run was told: settings, seed, versions. ``complete`` is False where the file ends early.
    """

    about: dict[str, Any]
    time: Floats
    ticks: dict[str, Floats]
    phase: list[str]
    cause: list[str]
    truth: dict[str, Floats]
    complete: bool


def read(path: Path) -> Record:
    """A run from its MCAP file, up to its end or to where it was cut."""
    rows: dict[str, list[Any]] = {"rcmservo/tick": [], "rcmservo/truth": []}
    times: list[int] = []
    about: dict[str, Any] = {}
    complete = False
    for topic, time, message in _messages(path):
        if topic == "about":
            about = message
        elif topic == "end":
            complete = True
        elif topic in rows:
            rows[topic].append(message)
            if topic == "rcmservo/tick":
                times.append(time)
    ticks = rows["rcmservo/tick"]
    return Record(
        about=about,
        time=np.array(times, dtype=float) * 1e-9,
        ticks=_columns(ticks, TICK_FIELDS),
        phase=[row.phase for row in ticks],
        cause=[row.cause for row in ticks],
        truth=_columns(rows["rcmservo/truth"], TRUTH_FIELDS),
        complete=complete,
    )


def _columns(rows: list[Any], numbers: dict[str, int]) -> dict[str, Floats]:
    return {
        name: np.array([getattr(row, name.lower()) for row in rows], dtype=float).reshape(-1, size)
        for name, size in numbers.items()
    }


def _messages(path: Path) -> Iterator[tuple[str, int, Any]]:
    """(topic, time, message) of every record in order; ("about", …) is the settings, ("end", …) says it is whole."""
    decoders: dict[int, Any] = {}
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    try:
        with path.open("rb") as file:
            for record in StreamReader(file, validate_crcs=True).records:
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Metadata) and record.name == "rcmservo":
                    yield "about", 0, json.loads(record.metadata["about"])
                elif isinstance(record, Message):
                    channel = channels[record.channel_id]
                    if channel.schema_id not in decoders:
                        decoders[channel.schema_id] = DecoderFactory().decoder_for("cdr", schemas[channel.schema_id])
                    yield channel.topic, record.log_time, decoders[channel.schema_id](record.data)
                elif isinstance(record, Footer):
                    yield "end", 0, None
    except OSError as error:
        raise UnusableFile(path, f"cannot be read: {error.strerror}") from error
    except DAMAGE:
        return
