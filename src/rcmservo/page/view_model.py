"""What the page shows: the newest tick in words and numbers, and what was said beside it."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rcmservo.config.texts import Table
from rcmservo.interfaces import Floats, Target
from rcmservo.page.channels import DUE_TIME, Desk
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
from rcmservo.page.plots.mechanism_shape import Shape
from rcmservo.page.pose_sequence import AUTONOMOUS_PHASES, SequenceProgress
from rcmservo.page.poses import PoseStore
from rcmservo.page.recovery_actions import list_allowed_actions, list_recovery_actions
from rcmservo.page.settings import describe_estimator
from rcmservo.recording import ros2_messages
from rcmservo.recording.ros2_messages import TICK
from rcmservo.recording.tick_schema import NAME_COLUMNS
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Phase
from rcmservo.servo.servo import Servo

MAX_NOTES = 20
"""Sentences that are kept."""

Truth = Callable[[Floats], float]
"""The true pose error, mm, of a target by the joints (3,) at which it was shown."""


@dataclass(frozen=True)
class Status:
    """State of the servo in words, and the buttons that lead on.

    Parameters
    ----------
    phase : str
        Name of the phase; OFF where no loop runs.
    words : str
        The phase in words.
    action : str
        Action of the cause, which says how grave it is.
    can : list[str]
        Actions that the browser in control may ask for now.
    ways : list[str]
        Actions that lead out of the cause, in the order in which they are pressed.
    way_out : str
        The way out in words.
    why : str
        The cause in words.
    moves : bool
        Whether the tool moves by itself.
    intent : str
        What is going to happen once the drive is on.
    asks : str
        What the person is asked.
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
    """What there is to show.

    Parameters
    ----------
    desk : Desk
        Where it comes from.
    poses : Poses
        Where poses are kept.
    between : Between or None
        What there is instead of a loop; None while there is one.
    target : Target or None
        Where the loop goes to.
    tick : Table
        The newest tick's columns and names.
    notes : deque[str]
        What was said, the newest last.
    in_force : Servo or None
        The settings that the loop goes by.
    kept : int
        It rises with each pose that is kept.
    changes : int
        It rises with each change of settings.
    tour : HowFar or None
        How far a tour is; None where there is none.
    teaching : str
        How far teaching is, in words; empty where nothing is being taught.
    curves : Curves
        The loop's last seconds.
    shape : Shape or None
        What the tool is, where that is to be drawn.
    truth : Truth or None
        What tells how far the tool truly is from a target; None where nobody knows.
    count : int
        That of the newest tick taken.
    picture : bytes
        The JPEG file that is shown.
    looked : int
        ns, when it was last made new: what is shown later is no newer.
    """

    channels: Desk
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
    shape: Shape | None = None
    truth: Truth | None = None
    count: int = -1
    picture: bytes = b""
    updated_at: int = 0

    @property
    def frame(self) -> int:
        """Number of the frame that the newest tick knows, -1 where there is none."""
        return int(self.tick["frame"][0]) if self.tick else -1

    def update(self) -> None:
        """Take what is new."""
        for said in self.channels.said.heard():
            self._apply(said)
        self.count, ticks = self.channels.ticks.after(self.count)
        for one in ticks:
            self.tick = decode_ring_tick(one)
            self.curves.add(self.tick)
        if ticks:
            ended = self.standby is not None and self.standby.latched
            if self.tick["phase"] != Phase.DISABLED.name and not ended:
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
                self.pose_version += 1
            case TeachingStatus():
                self.teaching = message.words
            case SettingsApplied():
                self.active_servo = message.servo
                self.settings_version += 1
            case _:
                raise TypeError(f"{message!r} is nothing that is said to the page")

    def to_table(self) -> Table:
        """What a browser draws: `json_of` encodes it."""
        tick, target = self.tick, self.target
        return {
            **vars(self._status()),
            "points": as_points(tick.get("points")),
            "ghost": as_points(predicted_markers(tick)),
            **{name: tick.get(name) for name in ("y", "quality", "delta", "q")},
            "rcm": tick.get("o_c"),
            "target": None if target is None else target.points,
            "tool": self._tool(tick.get("q")),
            "tool_target": self._tool(None if target is None else target.q),
            "truth_mm": self._true_error(target),
            "at": self.updated_at,
            "poses": sorted(self.poses.targets),
            "refused_poses": self.poses.refused,
            "kept": self.pose_version,
            "tour": self.sequence,
            "settings": self.settings_version,
            "standing": self._estimator_status(),
            "notes": list(self.notes)[-3:],
        }

    def _true_error(self, target: Target | None) -> float | None:
        if self.truth is None or target is None or not np.isfinite(target.q).all():
            return None
        return round(self.truth(target.q), 4)

    def _estimator_status(self) -> str:
        """How the estimator stands, in words; empty where no servo looks."""
        tick = self.tick
        if self.active_servo is None or not tick:
            return ""
        explored, condition = bool(tick["explored"][0]), float(tick["condition"][0])
        return describe_estimator(self.active_servo, explored, condition, Phase[tick["phase"]])

    def _tool(self, q: Floats | None) -> Floats | None:
        """Markers and tip (3, 3) mm at the joints; None where they are not known."""
        if self.shape is None or q is None or not np.isfinite(q).all():
            return None
        return self.shape.points(q).round(2)

    def _status(self) -> Status:
        """State of the servo, or of the wait for it."""
        if self.standby is not None or not self.tick:
            standby = self.standby or Standby("preparing")
            return Status(
                phase="FAULT" if standby.latched else "OFF",
                words=standby.words,
                action="FAULT" if standby.latched else "NONE",
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
            action=self.tick["asks"],
            why="; ".join(filter(None, (self.teaching, cause.value))),
            way_out=cause.way_out,
            recovery=list_recovery_actions(phase, cause),
            can=list_allowed_actions(phase),
            moves=phase in AUTONOMOUS_PHASES,
        )


def decode_ring_tick(data: bytes) -> Table:
    """A tick of the ring as columns and names."""
    columns = ros2_messages.tick_columns(TICK, [data])
    names = ros2_messages.decode_names(data[: -DUE_TIME.size], TICK)
    named = {one.name: name for one, name in zip(NAME_COLUMNS, names, strict=True)}
    (due,) = DUE_TIME.unpack(data[-DUE_TIME.size :])
    return {name: column[0] for name, column in columns.items()} | named | {"time": due}


def predicted_markers(tick: Table) -> Floats | None:
    """Where the servo expects the markers (4,) px in the picture; NaN where its estimator does not
    tell.
    """
    return tick["model"] + np.tile(tick["o_c"], 2) if tick else None


def as_points(numbers: Floats | None) -> Floats | None:
    """Points [[u, v], ...] of numbers in a row."""
    return None if numbers is None else np.reshape(numbers, (-1, 2))
