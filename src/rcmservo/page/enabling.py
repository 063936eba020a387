"""Before the drive is on: the page sees what the camera sees, and the person switches it on."""

from dataclasses import replace

import numpy as np

from rcmservo.interfaces import Target
from rcmservo.live.servo_process import HeartbeatPlant, go_on
from rcmservo.loop.clock import ticks
from rcmservo.loop.plant import Plant
from rcmservo.loop.teach import NotShown, teach
from rcmservo.loop.tick import Tick
from rcmservo.page.channels import Desk
from rcmservo.page.messages import Enable, Note, SettingsApplied, Standby
from rcmservo.safety.state_machine import Request
from rcmservo.servo.servo import Servo

NO_MOTION = np.zeros(3)
FIRST_TARGET_FRAMES = 30
"""Frames of the first target, half a second: the drive goes on soon after Enable, and the tool goes
only to what is taught or chosen later."""


def await_enable(channels: Desk, servo: Servo, intent: str, plant: Plant) -> Target:
    """Show what is seen, and tell what is going to happen, until the person wants the drive on; the
    pose in which the tool then is, as the first target. No `loop.run`: the drive is off, and no
    command is sent.
    """
    assert isinstance(plant, HeartbeatPlant)
    channels.said.put(SettingsApplied(replace(servo)))
    servo.warm_up()  # so that the drive goes on soon once it is wanted, whatever was set
    state, schedule = servo.init(), ticks(plant.clock, servo.rate)
    list(channels.wants.heard())  # what was wanted of a session that is over
    channels.said.put(Standby("the drive is off", can_enable=True, intent=intent))
    while True:
        now = next(schedule)
        go_on(plant.told_to_end)
        channels.ticks.add(
            Tick(now, servo, plant.read(), Request.NONE, NO_MOTION, state, NO_MOTION)
        )
        target = _teach_first_target(channels, plant) if _enable_requested(channels) else None
        if target is not None:
            return target


def _enable_requested(channels: Desk) -> bool:
    """Whether the person wants the drive on; all else is not for now."""
    messages = list(channels.wants.heard())
    if any(not isinstance(one, Enable) for one in messages):
        channels.said.put(Note("the drive is off: enable first"))
    return any(isinstance(one, Enable) for one in messages)


def _teach_first_target(channels: Desk, plant: Plant) -> Target | None:
    try:
        return teach(plant, FIRST_TARGET_FRAMES)
    except NotShown as error:
        channels.said.put(Note(f"not enabled: {error}"))
        return None
