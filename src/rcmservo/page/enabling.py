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
from rcmservo.page.messages import Between, Enable, InForce, Note
from rcmservo.safety.state_machine import Request
from rcmservo.servo.servo import Servo

STILL = np.zeros(3)
FIRST_FRAMES = 30
"""Frames of the first target, half a second: the drive goes on soon after Enable, and the tool goes
only to what is taught or chosen later."""


def await_enable(desk: Desk, servo: Servo, intent: str, plant: Plant) -> Target:
    """Show what is seen, and tell what is going to happen, until the person wants the drive on; the
    pose in which the tool then is, as the first target. No `loop.run`: the drive is off, and no
    command is sent.
    """
    assert isinstance(plant, HeartbeatPlant)
    desk.said.put(InForce(replace(servo)))
    servo.warm_up()  # so that the drive goes on soon once it is wanted, whatever was set
    state, schedule = servo.init(), ticks(plant.clock, servo.rate)
    list(desk.wants.heard())  # what was wanted of a session that is over
    desk.said.put(Between("the drive is off", ready=True, intent=intent))
    while True:
        now = next(schedule)
        go_on(plant.told_to_end)
        desk.ticks.add(Tick(now, servo, plant.read(), Request.NONE, STILL, state, STILL))
        target = _shown(desk, plant) if _enabled(desk) else None
        if target is not None:
            return target


def _enabled(desk: Desk) -> bool:
    """Whether the person wants the drive on; all else is not for now."""
    told = list(desk.wants.heard())
    if any(not isinstance(one, Enable) for one in told):
        desk.said.put(Note("the drive is off: enable first"))
    return any(isinstance(one, Enable) for one in told)


def _shown(desk: Desk, plant: Plant) -> Target | None:
    try:
        return teach(plant, FIRST_FRAMES)
    except NotShown as error:
        desk.said.put(Note(f"not enabled: {error}"))
        return None
