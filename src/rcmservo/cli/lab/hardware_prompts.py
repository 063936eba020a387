"""Questions to the operator at the arm before the drive is enabled, in the process that moves it.

The operator defines the joint values if the arm does not know them, teaches the target by hand or
names its file, and confirms the motion with a typed word. Nothing here moves the arm.
"""

import json
import time
from collections.abc import Generator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from rcmservo.config import target_file
from rcmservo.config.rig_file import RigDescription
from rcmservo.config.target_file import TargetSetup
from rcmservo.errors import BadInput, Stopped, require
from rcmservo.interfaces import Floats, Target
from rcmservo.live.device_protocols import LabArm, NotReady, OperatorTerminal
from rcmservo.live.servo_process import HeartbeatPlant
from rcmservo.live.terminal_operator import Terminal
from rcmservo.loop.plant import Plant
from rcmservo.loop.target_frames import TEACHING_FRAMES
from rcmservo.loop.teach import TeachingFailed, teach
from rcmservo.rig.confirmation import ENABLE_WORD
from rcmservo.rig.rig import require_drive_off

MAX_ANSWER_AGE_NS = 1_000_000_000
"""Time in ns after typing during which an answer is valid."""

JOINT_UNITS = "rad", "rad", "mm"


@dataclass(frozen=True)
class HardwarePreparation:
    """Preparation of a run with the operator; it is passed to the servo process.

    Parameters
    ----------
    lab : RigDescription
        Lab with its devices.
    motion_announcement : str
        Announcement of the motion that follows once the drive is on.
    target : Path or None
        File of the target; None if the operator teaches it by hand.
    save_target : Path or None
        New file for the taught target; None if it is not saved.
    teaching_frames : int
        Number of frames over which a taught target is averaged.
    """

    lab: RigDescription
    motion_announcement: str
    target: Path | None = None
    save_target: Path | None = None
    teaching_frames: int = TEACHING_FRAMES


class AttendedTerminal:
    """Operator at a terminal, whose answers are valid only if they were typed just now.

    Parameters
    ----------
    terminal : Terminal
        Terminal that reports when an answer was typed.
    """

    def __init__(self, terminal: Terminal) -> None:
        self._terminal = terminal

    def notify(self, message: str) -> None:
        """Print a message that needs no answer."""
        self._terminal.notify(message)

    def ask(self, question: str) -> str:
        """Return the operator's answer to a question; ask again if the answer is too old."""
        while True:
            answer = self._terminal.ask(question)
            if time.monotonic_ns() - self._terminal.typed <= MAX_ANSWER_AGE_NS:
                return answer
            self.notify("This answer is too old; please repeat it.")


def obtain_target(preparation: HardwarePreparation, plant: Plant) -> Target:
    """Define the joint values if needed, and return the target; the tool is then at its start."""
    setup, file = target_setup(preparation.lab, plant), preparation.target
    target = None if file is None else target_file.load_target(file, setup)
    with _open_operator(plant) as operator:
        require_drive_off(plant)
        if not get_lab_arm(plant).is_homed():
            define_joints(operator, plant, preparation.lab)
        if target is None:
            target = teach_by_hand(operator, plant, preparation.teaching_frames)
            if preparation.save_target is not None:
                target_file.save_target(preparation.save_target, target, setup)
                operator.notify(f"The target is saved in {preparation.save_target}.")
        else:
            condition = "It holds only if the camera has not moved since it was taught."
            operator.notify(f"The target is read from {file}. {condition}")
        await_enter(operator, plant, "Move the tool to its start by hand, then press Enter:")
    return target


def confirm_enable(preparation: HardwarePreparation, plant: Plant) -> None:
    """Request the word that enables the drive; it is valid for a short time only."""
    with _open_operator(plant) as operator:
        q = format_joints(plant.arm.measure().q, preparation.lab)
        operator.notify(f"The arm is at {q}. {preparation.motion_announcement}")
        answer = operator.ask(
            f"Type {ENABLE_WORD} to switch the drive on; any other answer ends the program:"
        )
        if answer != ENABLE_WORD:
            raise Stopped(f"the drive was not switched on: the answer was not {ENABLE_WORD}")


def target_setup(lab: RigDescription, plant: Plant) -> TargetSetup:
    """Return the setup for which a target is valid.

    The camera is identified by all its entries in the rig file except its latency, which no image
    shows, and a user-defined tracker by all its entries.
    """
    assert plant.frame is not None
    if plant.frame.image is None:
        raise NotReady("the camera delivers frames without an image, whose size a target needs")
    height, width = plant.frame.image.shape[:2]
    return describe_target_setup(lab, width, height)


def describe_target_setup(lab: RigDescription, width: int, height: int) -> TargetSetup:
    """Return the setup for which a target is valid, given the size of the images in px."""
    camera = {key: value for key, value in lab.devices["camera"].items() if key != "latency"}
    name = json.dumps(camera, sort_keys=True, default=str)
    slack = lab.thresholds.limit_tolerance
    return TargetSetup(name, width, height, lab.mechanism, lab.tool, lab.tracking, slack=slack)


def define_joints(operator: OperatorTerminal, plant: Plant, lab: RigDescription) -> None:
    """Let the operator type and confirm the joint values, and define them in the arm."""
    arm = get_lab_arm(plant)
    operator.notify(
        "The joint values of the arm are unknown since its controller was reset. The drive is off. "
        "Move the arm by hand to a mark whose joint values are known."
    )
    while True:
        answer = operator.ask("Joint values at the mark in rad, rad and mm, such as 0.1 -0.2 100:")
        try:
            q = parse_joints(answer, lab)
        except BadInput as error:
            operator.notify(f"{error}.")
            continue
        if not operator.ask(f"The arm is at {format_joints(q, lab)}. Press Enter to confirm:"):
            break
    arm.set_position(q)
    reported = arm.measure().q
    if not (np.abs(reported - q) <= lab.thresholds.max_following_error).all():
        joints = format_joints(reported, lab)
        raise NotReady(f"the arm did not take the defined joint values; it reports {joints}")


def parse_joints(answer: str, lab: RigDescription) -> Floats:
    """Return the typed joint values (3,) in rad, rad, mm, within their limits."""
    try:
        typed = np.array([float(word) for word in answer.replace(",", " ").split()])
    except ValueError:
        typed = np.empty(0)
    require(typed.shape == (3,), "the joints", answer, "three numbers (rad, rad, mm)")
    lower, upper = lab.mechanism.limits.arrays
    is_within_limits = bool(((lower <= typed) & (typed <= upper)).all())
    limits = f"within {format_joints(lower, lab)} and {format_joints(upper, lab)}"
    require(is_within_limits, "the joints", answer, limits)
    return typed


def teach_by_hand(
    operator: OperatorTerminal, plant: Plant, frames: int = TEACHING_FRAMES
) -> Target:
    """Return the target that the camera sees once the operator has moved the tool there."""
    while True:
        await_enter(operator, plant, "Move the tool to the target by hand, then press Enter:")
        operator.notify(
            f"Averaging {frames} frames (most cameras take 60 in 1 s): hold the tool still."
        )
        try:
            target = teach(plant, frames)
        except TeachingFailed as error:
            operator.notify(f"{error}.")
        else:
            left_out = f" {target.left_out} frames were left out: their markers were elsewhere."
            operator.notify("The target is taught." + (left_out if target.left_out else ""))
            if target.swing_text:
                operator.notify(f"Note: {target.swing_text}")
            return target


def await_enter(operator: OperatorTerminal, plant: Plant, instruction: str) -> None:
    """Wait with the drive off until the operator confirms an instruction with Enter."""
    require_drive_off(plant)
    while operator.ask(f"The drive is off. {instruction}"):
        operator.notify("Press Enter to continue, or Ctrl-C to end the program.")


def format_joints(q: Floats, lab: RigDescription) -> str:
    """Return joint values (3,) with their names and units."""
    joints = zip(lab.mechanism.joint_names, q.tolist(), JOINT_UNITS, strict=True)
    return ", ".join(f"{name} {value:.4g} {unit}" for name, value, unit in joints)


def get_lab_arm(plant: Plant) -> LabArm:
    """Return the arm of the plant, which is that of a lab."""
    return cast(Any, plant.arm)


@contextmanager
def _open_operator(plant: Plant) -> Generator[OperatorTerminal]:
    """Yield the operator at the terminal of this process."""
    assert isinstance(plant, HeartbeatPlant)
    with closing(Terminal(plant.stop_requested)) as terminal:
        yield AttendedTerminal(terminal)
