"""STOP for an arm that only the servo's process can switch off: that does it, or is killed."""

import time
from multiprocessing import get_context
from typing import Any

import numpy as np
import pytest

from rcmservo.errors import Stopped
from rcmservo.interfaces import Command, Floats, Measured
from rcmservo.live.remote_stop import RemotelyStoppableArm, RemoteStop


class ToyArm:
    """An arm that does at once what it is told."""

    def __init__(self) -> None:
        self.on, self.why_off = False, ""
        self.taken: list[Command] = []

    def homed(self) -> bool:
        return True

    def define(self, q: Floats) -> None:
        raise AssertionError("it knows where it stands")

    def enable(self) -> None:
        self.on = True

    def measure(self) -> Measured:
        return Measured(len(self.taken), np.zeros(3), self.on)

    def apply(self, command: Command) -> Floats:
        self.taken.append(command)
        self.on = self.on and command.enabled
        return command.rates

    def close(self) -> None:
        self.on = False


GOES = Command(0, 0, 10**18, np.array([0.1, 0.0, 1.0]), True)


def held() -> tuple[RemoteStop, ToyArm, RemotelyStoppableArm, list[str]]:
    leash, arm, told = RemoteStop(get_context("spawn")), ToyArm(), list[str]()
    leash.reset()
    return leash, arm, RemotelyStoppableArm(arm, leash, told.append), told


def test_once_the_leash_is_pulled_the_next_command_switches_the_drive_off() -> None:
    leash, arm, leashed, _ = held()
    leashed.enable()
    leashed.measure()
    leashed.apply(GOES)
    assert arm.on and arm.taken[-1] is GOES
    leash.switch_off(True)
    leashed.apply(GOES)
    assert not arm.on and not arm.taken[-1].enabled and not arm.taken[-1].rates.any()
    leashed.measure()
    assert leash.switch_off(True) == "the arm's drive is off"


def test_a_drive_that_is_coming_on_counts_as_on_and_one_that_was_stopped_before_stays_off() -> None:
    leash, arm, leashed, _ = held()
    assert leash.switch_off(False) == "the arm's drive is off"
    with pytest.raises(Stopped):
        leashed.enable()
    assert not arm.on
    leash, arm, leashed, _ = held()
    leashed.enable()
    arm.on = False
    leashed.measure()
    assert "did not switch the drive off" in leash.switch_off(False)


def test_why_the_drive_went_off_is_told_once() -> None:
    _, arm, leashed, told = held()
    leashed.measure()
    arm.why_off = "its limit switch"
    leashed.measure()
    leashed.measure()
    assert told == ["its limit switch"]


def serves(leash: RemoteStop, obeys: bool, said: Any) -> None:
    """A servo's loop, or one that hangs."""
    arm = RemotelyStoppableArm(ToyArm(), leash, said.send)
    arm.enable()
    arm.measure()
    said.send("on")
    while True:
        time.sleep(0.005)
        if obeys:
            arm.measure()
            arm.apply(GOES)


@pytest.mark.parametrize("obeys", [True, False])
def test_a_servo_that_does_not_switch_off_is_killed_and_one_that_does_is_not(obeys: bool) -> None:
    context = get_context("spawn")
    leash = RemoteStop(context)
    leash.reset()
    here, there = context.Pipe()
    process = context.Process(target=serves, args=(leash, obeys, there), daemon=True)
    process.start()
    try:
        assert here.recv() == "on"
        words = leash.switch_off(True)
        if obeys:
            assert words.startswith("the servo has switched the arm's drive off within")
            assert process.is_alive()
        else:
            assert "was killed; the arm is left to its own watchdog" in words
            process.join(10.0)
            assert process.exitcode == -9
    finally:
        process.kill()
        process.join()
