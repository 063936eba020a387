"""Observation without motion until the operator enables the drive at the page."""

from dataclasses import replace

import numpy as np

from rcmservo.interfaces import Target
from rcmservo.live.servo_process import HeartbeatPlant, raise_if_stopped
from rcmservo.loop.clock import ticks
from rcmservo.loop.plant import Plant
from rcmservo.loop.teach import TeachingFailed, teach
from rcmservo.loop.tick import Tick
from rcmservo.page.channels import PageChannels
from rcmservo.page.messages import Enable, Note, SettingsApplied, Standby
from rcmservo.safety.state_machine import Request
from rcmservo.servo.servo import Servo

NO_MOTION = np.zeros(3)
FIRST_TARGET_FRAMES = 30
"""Number of frames of the first target, half a second.

It is small so that the drive goes on soon after Enable. The tool moves only to poses that are
taught or selected later.
"""


def await_enable(channels: PageChannels, servo: Servo, intent: str, plant: Plant) -> Target:
    """Display observations until the drive is enabled; return the present pose as the target.

    This is not `loop.run`: the drive is off and no command is sent.

    Parameters
    ----------
    channels : PageChannels
        Channels to the page.
    servo : Servo
        Servo of the session.
    intent : str
        Description of what happens once the drive is on, for the page.
    plant : Plant
        Plant of the servo process.

    Returns
    -------
    Target
        Mean of the first frames after the request.

    Raises
    ------
    Stopped
        If a stop is requested.
    """
    assert isinstance(plant, HeartbeatPlant)
    channels.status.send(SettingsApplied(replace(servo)))
    servo.warm_up()  # so that no compilation delays the drive after Enable
    state, schedule = servo.init(), ticks(plant.clock, servo.rate)
    list(channels.requests.receive_all())  # requests to an earlier session
    channels.status.send(Standby("the drive is off", can_enable=True, intent=intent))
    while True:
        now = next(schedule)
        raise_if_stopped(plant.stop_requested)
        channels.ticks.add(
            Tick(now, servo, plant.read(), Request.NONE, NO_MOTION, state, NO_MOTION)
        )
        target = _teach_first_target(channels, plant) if _enable_requested(channels) else None
        if target is not None:
            return target


def _enable_requested(channels: PageChannels) -> bool:
    """Return whether the operator requests the drive; report every other request as refused."""
    messages = list(channels.requests.receive_all())
    if any(not isinstance(one, Enable) for one in messages):
        channels.status.send(Note("the drive is off: enable first"))
    return any(isinstance(one, Enable) for one in messages)


def _teach_first_target(channels: PageChannels, plant: Plant) -> Target | None:
    try:
        return teach(plant, FIRST_TARGET_FRAMES)
    except TeachingFailed as error:
        channels.status.send(Note(f"not enabled: {error}"))
        return None
