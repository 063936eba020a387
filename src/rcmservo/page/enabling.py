"""First part of a session: observation without motion until the operator enables the drive."""

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
"""Velocity of marker 1 and joint rates, each (3,), while the drive is off."""
FIRST_TARGET_FRAMES = 30
"""Number of frames of the first target, half a second.

It is small so that the drive goes on soon after Enable. The tool moves only to poses that are
taught or selected later.
"""


def await_enable(channels: PageChannels, servo: Servo, intent: str, plant: Plant) -> Target:
    """Display observations until the drive is enabled; return the present pose as the target.

    The drive stays off and no command is sent, unlike in `loop.servo_loop`.

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
    state = servo.init()
    channels.requests.receive_all()  # discards requests to an earlier session
    channels.status.send(Standby("the drive is off", can_enable=True, intent=intent))
    for time in ticks(plant.clock, servo.rate):
        raise_if_stopped(plant.stop_requested)
        observation = plant.read()
        tick = Tick(time, servo, observation, Request.NONE, NO_MOTION, state, NO_MOTION)
        channels.ticks.add(tick)
        if _is_enable_requested(channels):
            try:
                return teach(plant, FIRST_TARGET_FRAMES)
            except TeachingFailed as error:
                channels.status.send(Note(f"not enabled: {error}"))
    raise AssertionError("ticks without a duration never end")


def _is_enable_requested(channels: PageChannels) -> bool:
    """Return whether the operator requests the drive; report every other request as refused."""
    are_enable = [isinstance(request, Enable) for request in channels.requests.receive_all()]
    if not all(are_enable):
        channels.status.send(Note("the drive is off: enable first"))
    return any(are_enable)
