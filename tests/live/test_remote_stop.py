"""STOP for an arm that only the servo process can disable: it does so, or is killed."""

import time
from multiprocessing import get_context
from typing import Any

import numpy as np
import pytest

from rcmservo.errors import Stopped
from rcmservo.interfaces import ArmMeasurement, Command, Floats
from rcmservo.live.remote_stop import RemotelyStoppableArm, RemoteStop


class ToyArm:
    """Arm that responds at once."""

    def __init__(self) -> None:
        self.on, self.off_reason = False, ""
        self.taken: list[Command] = []

    def is_homed(self) -> bool:
        return True

    def set_position(self, q: Floats) -> None:
        raise AssertionError("the joint values are known")

    def enable(self) -> None:
        self.on = True

    def measure(self) -> ArmMeasurement:
        return ArmMeasurement(len(self.taken), np.zeros(3), self.on)

    def apply(self, command: Command) -> Floats:
        self.taken.append(command)
        self.on = self.on and command.enabled
        return command.rates

    def close(self) -> None:
        self.on = False


MOTION = Command(0, 0, 10**18, np.array([0.1, 0.0, 1.0]), True)


def make_arm() -> tuple[RemoteStop, ToyArm, RemotelyStoppableArm, list[str]]:
    stop, arm, reasons = RemoteStop(get_context("spawn")), ToyArm(), list[str]()
    stop.reset()
    return stop, arm, RemotelyStoppableArm(arm, stop, reasons.append), reasons


def test_the_first_command_after_a_stop_request_disables_the_drive() -> None:
    stop, arm, stoppable, _ = make_arm()
    stoppable.enable()
    stoppable.measure()
    stoppable.apply(MOTION)
    assert arm.on and arm.taken[-1] is MOTION
    stop.switch_off(True)
    stoppable.apply(MOTION)
    assert not arm.on and not arm.taken[-1].enabled and not arm.taken[-1].rates.any()
    stoppable.measure()
    assert stop.switch_off(True) == "the arm's drive is off"


def test_a_drive_being_enabled_counts_as_on_and_a_stopped_one_stays_off() -> None:
    stop, arm, stoppable, _ = make_arm()
    assert stop.switch_off(False) == "the arm's drive is off"
    with pytest.raises(Stopped):
        stoppable.enable()
    assert not arm.on
    stop, arm, stoppable, _ = make_arm()
    stoppable.enable()
    arm.on = False
    stoppable.measure()
    assert "did not switch the drive off" in stop.switch_off(False)


def test_the_reason_for_a_drive_going_off_is_reported_once() -> None:
    _, arm, stoppable, reasons = make_arm()
    stoppable.measure()
    arm.off_reason = "its limit switch"
    stoppable.measure()
    stoppable.measure()
    assert reasons == ["its limit switch"]


def serve(stop: RemoteStop, responds: bool, pipe: Any) -> None:
    """Run a loop that reads the arm, or one that hangs."""
    arm = RemotelyStoppableArm(ToyArm(), stop, pipe.send)
    arm.enable()
    arm.measure()
    pipe.send("on")
    while True:
        time.sleep(0.005)
        if responds:
            arm.measure()
            arm.apply(MOTION)


@pytest.mark.parametrize("responds", [True, False])
def test_only_a_servo_that_does_not_disable_the_drive_is_killed(responds: bool) -> None:
    context = get_context("spawn")
    stop = RemoteStop(context)
    stop.reset()
    here, there = context.Pipe()
    process = context.Process(target=serve, args=(stop, responds, there), daemon=True)
    process.start()
    there.close()
    try:
        assert here.recv() == "on"
        words = stop.switch_off(True)
        if responds:
            assert words.startswith("the servo switched the arm's drive off within")
            assert process.is_alive()
        else:
            assert "was killed; the arm must stop by its own watchdog" in words
            process.join(10.0)
            assert process.exitcode == -9
    finally:
        process.kill()
        process.join()
