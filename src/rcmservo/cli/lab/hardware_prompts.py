"""What a person at the arm is asked before its drive goes on, in the process that will move it.

Where the arm stands, if it does not know; the target, shown by hand or read from a file; and at
last, for a word, leave to move. Nothing here moves anything.
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
from rcmservo.config.rig_file import Lab
from rcmservo.config.target_file import Setup
from rcmservo.errors import BadInput, Stopped, require
from rcmservo.interfaces import Floats, Target
from rcmservo.live.device_protocols import LabArm, NotReady, OperatorTerminal
from rcmservo.live.servo_process import HeartbeatPlant
from rcmservo.live.terminal_operator import Terminal
from rcmservo.loop.plant import Plant
from rcmservo.loop.target_frames import TEACHING_FRAMES
from rcmservo.loop.teach import NotShown, teach

ENABLE_WORD = "enable"
MAX_ANSWER_AGE_NS = 1_000_000_000
"""ns after it was typed for which an answer counts."""

JOINT_UNITS = "rad", "rad", "mm"


@dataclass(frozen=True)
class HardwarePreparation:
    """What is to be done with a person's help; it passes to the servo's process.

    Parameters
    ----------
    lab : Lab
        The laboratory with its devices.
    intent : str
        What is going to happen once the drive is on, in words.
    target : Path or None
        The file that holds the target; None where it is shown by hand.
    save_target : Path or None
        A new file to keep the target in that is shown; None where it is not kept.
    frames : int
        Frames that a target is the mean of.
    """

    lab: Lab
    intent: str
    target: Path | None = None
    save_target: Path | None = None
    frames: int = TEACHING_FRAMES


class AttendedTerminal:
    """A person at a terminal, whose answers count only where they were typed just now."""

    def __init__(self, terminal: Terminal) -> None:
        self._terminal = terminal

    def tell(self, words: str) -> None:
        """Say something that needs no answer."""
        self._terminal.tell(words)

    def ask(self, question: str) -> str:
        """What the person answers to this question."""
        while True:
            answer = self._terminal.ask(question)
            if time.monotonic_ns() - self._terminal.typed <= MAX_ANSWER_AGE_NS:
                return answer
            self.tell("That was typed a while ago; once more.")


def obtain_target(preparing: HardwarePreparation, plant: Plant) -> Target:
    """Where the arm stands, and the target. At the end the tool is at its start."""
    setup, given = target_setup(preparing.lab, plant), preparing.target
    target = None if given is None else target_file.load(given, setup)
    with _operator(plant) as person:
        require_drive_off(plant)
        if not lab_arm(plant).homed():
            define(person, plant, preparing.lab)
        if target is None:
            target = teach_by_hand(person, plant, preparing.frames)
            if preparing.save_target is not None:
                target_file.save(preparing.save_target, target, setup)
                person.tell(f"The target is kept in {preparing.save_target}.")
        else:
            words = "It holds only if the camera stands where it stood when it was shown."
            person.tell(f"The target is that of {given}. {words}")
        await_enter(person, plant, "Bring the tool to its start by hand, then press Enter:")
    return target


def confirm_enable(preparing: HardwarePreparation, plant: Plant) -> None:
    """Ask for the word that lets the drive go on: it counts while it is fresh."""
    with _operator(plant) as person:
        q = format_joints(plant.arm.measure().q, preparing.lab)
        person.tell(f"The arm stands at {q}. {preparing.intent}")
        answer = person.ask(f"Type {ENABLE_WORD} to switch the drive on; anything else ends this:")
        if answer != ENABLE_WORD:
            raise Stopped(f"nothing was switched on: the answer was not {ENABLE_WORD}")


def target_setup(lab: Lab, plant: Plant) -> Setup:
    """What a target is bound to: the camera by all that the rig file says of it but its latency,
    which no picture shows.
    """
    frame = plant.frame
    image = None if frame is None else frame.image
    assert image is not None
    height, width = image.shape[:2]
    return target_setup_for_size(lab, width, height)


def target_setup_for_size(lab: Lab, width: int, height: int) -> Setup:
    """The same, by the pictures' size in px."""
    told = {key: value for key, value in lab.devices["camera"].items() if key != "latency"}
    name = json.dumps(told, sort_keys=True)
    slack = lab.thresholds.slack
    return Setup(name, width, height, lab.mechanism, lab.tool, lab.markers, slack=slack)


def require_drive_off(plant: Plant) -> None:
    """Refuse an arm whose drive is on: nobody here has switched it on, and it would hold or go."""
    if plant.arm.measure().enabled:
        raise NotReady("the arm's drive is on, by somebody else: switch it off there first")


def define(person: OperatorTerminal, plant: Plant, lab: Lab) -> None:
    """A person says where the arm stands, and agrees to it before the arm is told."""
    arm = lab_arm(plant)
    person.tell(
        "The arm does not know where it stands: nobody has said so since its controller was reset. "
        "The drive is off. Bring the arm by hand to a mark whose joints are known."
    )
    while True:
        answer = person.ask("The joints at the mark in rad, rad and mm, such as 0.1 -0.2 100:")
        try:
            q = parse_joints(answer, lab)
        except BadInput as error:
            person.tell(f"{error}.")
            continue
        if not person.ask(f"The arm stands at {format_joints(q, lab)}. Enter if so:"):
            break
    arm.define(q)
    told = arm.measure().q
    if not (np.abs(told - q) <= lab.thresholds.following).all():
        raise NotReady(f"the arm stands elsewhere than it was told, at {format_joints(told, lab)}")


def parse_joints(answer: str, lab: Lab) -> Floats:
    """The joints (3,) that were typed, within their limits."""
    try:
        typed = np.array([float(part) for part in answer.replace(",", " ").split()])
    except ValueError:
        typed = np.empty(0)
    require(typed.shape == (3,), "the joints", answer, "three numbers (rad, rad, mm)")
    lower, upper = lab.mechanism.limits.arrays
    inside = bool(((lower <= typed) & (typed <= upper)).all())
    limits = f"within {format_joints(lower, lab)} and {format_joints(upper, lab)}"
    require(inside, "the joints", answer, limits)
    return typed


def teach_by_hand(person: OperatorTerminal, plant: Plant, frames: int = TEACHING_FRAMES) -> Target:
    """What the camera sees when a person says that the tool is at the target."""
    while True:
        await_enter(person, plant, "Bring the tool to the target by hand, then press Enter:")
        person.tell(f"Taking {frames} frames (60 are 1 s of most cameras): keep the tool still.")
        try:
            target = teach(plant, frames)
        except NotShown as error:
            person.tell(f"{error}.")
        else:
            person.tell("The target is taught.")
            return target


def await_enter(person: OperatorTerminal, plant: Plant, words: str) -> None:
    """Wait until a person has done what these words say, the drive being off."""
    require_drive_off(plant)
    while person.ask(f"The drive is off. {words}"):
        person.tell("Only Enter goes on; Ctrl-C ends this.")


def format_joints(q: Floats, lab: Lab) -> str:
    """Joints (3,) in words, with their names and units."""
    parts = zip(lab.mechanism.joint_names, q.tolist(), JOINT_UNITS, strict=True)
    return ", ".join(f"{name} {value:.4g} {unit}" for name, value, unit in parts)


def lab_arm(plant: Plant) -> LabArm:
    """The plant's arm, which is one of a laboratory."""
    return cast(Any, plant.arm)


@contextmanager
def _operator(plant: Plant) -> Generator[OperatorTerminal]:
    assert isinstance(plant, HeartbeatPlant)
    with closing(Terminal(plant.told_to_end)) as terminal:
        yield AttendedTerminal(terminal)
