"""Content of the page for a browser: the newest tick and status messages in words and numbers.

`Dashboard.to_table` returns it and `encode_json` encodes it.
"""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydantic_core import to_json

from rcmservo.config.toml_json_parsing import Table
from rcmservo.interfaces import Floats, Target
from rcmservo.page.channels import DUE_TIME, PageChannels
from rcmservo.page.messages import (
    Note,
    PoseTaught,
    SequenceStatus,
    SettingsApplied,
    Standby,
    StatusMessage,
    TargetChanged,
    TeachingStatus,
)
from rcmservo.page.plots.curves import Curves
from rcmservo.page.plots.mechanism_shape import MechanismShape
from rcmservo.page.pose_sequence import AUTONOMOUS_PHASES, SequenceProgress
from rcmservo.page.poses import PoseStore
from rcmservo.page.selected_settings import describe_estimator
from rcmservo.recording import ros2_messages
from rcmservo.recording.ros2_messages import TICK
from rcmservo.recording.tick_schema import NAME_COLUMNS
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Phase
from rcmservo.servo.servo import Servo

MAX_NOTES, DISPLAYED_NOTES = 20, 3
"""Number of notes that are stored, and of those that a browser displays."""

TruePoseError = Callable[[Floats], float]
"""True pose error in mm of a target, as a function of the joints (3,) at which it was taught."""


@dataclass(frozen=True)
class Status:
    """State of the servo in words, and the actions of the page's buttons, as the browser gets them.

    Parameters
    ----------
    phase : str
        Name of the phase; OFF if no loop runs.
    words : str
        Phase in words.
    action : str
        Name of the `Action` that the cause requests, which shows its severity.
    can : list[str]
        Actions that the browser in control may request now.
    recovery : list[str]
        Actions that recover from the cause, in the order in which they are pressed.
    way_out : str
        Recovery from the cause in words.
    why : str
        Cause in words.
    moves : bool
        The servo moves the tool.
    intent : str
        Description of what happens once the drive is on.
    question : str
        Question to the operator.
    """

    phase: str
    words: str
    action: str
    can: list[str]
    recovery: list[str]
    way_out: str
    why: str = ""
    moves: bool = False
    intent: str = ""
    question: str = ""


@dataclass
class Dashboard:
    """Content of the page.

    Parameters
    ----------
    channels : PageChannels
        Channels that it reads.
    poses : PoseStore
        Stored poses.
    standby : Standby or None
        State of the session while no loop runs; None while one runs.
    target : Target or None
        Present target of the loop.
    tick : Table
        Columns and names of the newest tick.
    notes : deque[str]
        Notes, the newest last.
    active_servo : Servo or None
        Settings that the loop uses.
    pose_version : int
        Counter that rises with each stored pose.
    settings_version : int
        Counter that rises with each change of settings.
    sequence : SequenceProgress or None
        Progress of the pose sequence; None if none runs.
    teaching : str
        Progress of teaching in words; empty if no pose is being taught.
    curves : Curves
        Newest samples of the curves.
    shape : MechanismShape or None
        Mechanism and tool to draw; None if they are not drawn.
    truth : TruePoseError or None
        True pose error; None outside simulation.
    count : int
        Index of the newest tick that was read.
    picture : bytes
        Displayed JPEG picture.
    updated_at : int
        Time (ns) of the last update. No message to a browser carries a later time.
    """

    channels: PageChannels
    poses: PoseStore
    standby: Standby | None = None
    target: Target | None = None
    tick: Table = field(default_factory=dict[str, Any])
    notes: deque[str] = field(default_factory=lambda: deque[str](maxlen=MAX_NOTES))
    active_servo: Servo | None = None
    pose_version: int = 0
    settings_version: int = 0
    sequence: SequenceProgress | None = None
    teaching: str = ""
    curves: Curves = field(default_factory=Curves)
    shape: MechanismShape | None = None
    truth: TruePoseError | None = None
    count: int = -1
    picture: bytes = b""
    updated_at: int = 0

    @property
    def frame(self) -> int:
        """Number of the frame of the newest tick, -1 if there is none."""
        return int(self.tick["frame"][0]) if self.tick else -1

    def update(self) -> None:
        """Read new status messages and ticks."""
        for message in self.channels.status.receive_all():
            self._apply(message)
        self.count, encoded_ticks = self.channels.ticks.read_after(self.count)
        for encoded_tick in encoded_ticks:
            self.tick = decode_ring_tick(encoded_tick)
            self.curves.add(self.tick)
        if encoded_ticks:
            is_stopped = self.standby is not None and self.standby.is_latched
            if self.tick["phase"] != Phase.DISABLED.name and not is_stopped:
                self.standby = None
        self.updated_at = time.monotonic_ns()

    def _apply(self, message: StatusMessage) -> None:
        match message:
            case Note():
                self.notes.append(message.words)
            case Standby():
                self.standby, self.tick = message, {}
                self.count = self.channels.ticks.newest
                self.curves.restart()
                self.target = self.sequence = None
                self.teaching = ""
            case SequenceStatus():
                self.sequence = message.progress
            case TargetChanged():
                self.target = message.target
            case PoseTaught():
                error = self.poses.save(message.name, message.target, self.picture)
                self.notes.append(error or f"{message.name} is taught")
                if message.target.swing_text:
                    self.notes.append(message.target.swing_text)
                self.pose_version += 1
            case TeachingStatus():
                self.teaching = message.words
            case SettingsApplied():
                self.active_servo = message.servo
                self.settings_version += 1
            case _:
                raise TypeError(f"{message!r} is not a status message")

    def to_table(self) -> Table:
        """Return the content for a browser; `encode_json` encodes it."""
        tick, target = self.tick, self.target
        return {
            **vars(self._describe_status()),
            "points": as_points(tick.get("points")),
            "predicted": as_points(tick["model"] + np.tile(tick["o_c"], 2)) if tick else None,
            **{name: tick.get(name) for name in ("y", "quality", "delta", "q")},
            "rcm": tick.get("o_c"),
            "target": None if target is None else target.points,
            "tool": self._compute_tool_points(tick.get("q")),
            "tool_target": self._compute_tool_points(None if target is None else target.q),
            "truth_mm": self._compute_true_error(target),
            "at": self.updated_at,
            "poses": sorted(self.poses.targets),
            "refused_poses": self.poses.refused,
            "pose_version": self.pose_version,
            "sequence": self.sequence,
            "settings_version": self.settings_version,
            "estimator_status": self._describe_estimator(),
            "notes": list(self.notes)[-DISPLAYED_NOTES:],
        }

    def _compute_true_error(self, target: Target | None) -> float | None:
        """Return the true pose error in mm; None outside simulation or without known joints."""
        if self.truth is None or target is None or not np.isfinite(target.q).all():
            return None
        return round(self.truth(target.q), 4)

    def _describe_estimator(self) -> str:
        """Return the state of the estimator in words; empty if no servo runs."""
        tick = self.tick
        if self.active_servo is None or not tick:
            return ""
        has_explored, condition = bool(tick["explored"][0]), float(tick["condition"][0])
        return describe_estimator(self.active_servo, has_explored, condition, Phase[tick["phase"]])

    def _compute_tool_points(self, q: Floats | None) -> Floats | None:
        """Return markers and tip (3, 3) in mm at the joints; None if the joints are unknown."""
        if self.shape is None or q is None or not np.isfinite(q).all():
            return None
        return self.shape.compute_points(q).round(2)

    def _describe_status(self) -> Status:
        """Return the state of the servo, or of the session while no loop runs."""
        if self.standby is not None or not self.tick:
            standby = self.standby or Standby("preparing")
            return Status(
                phase="FAULT" if standby.is_latched else "OFF",
                words=standby.words,
                action="FAULT" if standby.is_latched else "NONE",
                way_out="find out why, then clear" if standby.can_clear else "",
                recovery=["clear"] if standby.can_clear else [],
                can=["enable"] * standby.can_enable + ["clear"] * standby.can_clear,
                intent=standby.intent,
                question=standby.question,
            )
        phase, cause = Phase[self.tick["phase"]], Cause[self.tick["cause"]]
        return Status(
            phase=phase.name,
            words=phase.value,
            action=self.tick["action"],
            why="; ".join(filter(None, (self.teaching, cause.value))),
            way_out=cause.remedy,
            recovery=list_recovery_actions(phase, cause),
            can=list_allowed_actions(phase),
            moves=phase in AUTONOMOUS_PHASES,
        )


def decode_ring_tick(data: bytes) -> Table:
    """Decode a tick of the ring to its columns and names."""
    columns = ros2_messages.decode_tick_columns(TICK, [data])
    names = ros2_messages.decode_names(data[: -DUE_TIME.size], TICK)
    named = {column.name: name for column, name in zip(NAME_COLUMNS, names, strict=True)}
    (due_ns,) = DUE_TIME.unpack(data[-DUE_TIME.size :])
    return {name: column[0] for name, column in columns.items()} | named | {"time": due_ns}


def list_recovery_actions(phase: Phase, cause: Cause) -> list[str]:
    """Return the actions that recover from a cause, in the order in which they are pressed."""
    if phase is Phase.FAULT:
        return ["clear"]
    if phase is not Phase.PAUSED:
        return []
    return ["teach_again", "resume"] if cause.needs_teaching else ["resume"]


def list_allowed_actions(phase: Phase) -> list[str]:
    """Return the actions that the browser in control may request in a phase of the loop."""
    if phase is Phase.FAULT:
        return ["clear"]
    pause = "resume" if phase is Phase.PAUSED else "pause"
    can_jog = phase in (Phase.IDLE, Phase.PAUSED, Phase.JOG)
    return ["teach_again", "teach", "go", pause, *["jog"] * can_jog]


def as_points(numbers: Floats | None) -> Floats | None:
    """Return coordinates (2 n,) in px as points (n, 2) with columns u, v; None for None."""
    return None if numbers is None else np.reshape(numbers, (-1, 2))


def encode_json(value: object) -> bytes:
    """Encode a value as JSON: dataclasses as tables, arrays as lists, NaN and infinity as null."""
    return to_json(value, inf_nan_mode="null", fallback=_convert_array)


def _convert_array(array: Any) -> Any:
    """Convert an array or a NumPy scalar to plain Python."""
    return array.tolist()
