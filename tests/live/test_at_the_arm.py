"""What a person at the arm is asked, each question by itself, at a terminal with an arm of a few
lines."""

import os
import signal
import subprocess
import sys

import pytest
from at_terminal import AtTerminal

from conftest import first_quick

pytestmark = pytest.mark.alone

ARM = """
import sys, time
import numpy as np
from contextlib import closing
from rcmservo.app.lab.at_the_arm import Preparing, define, leave_to_move, shown
from rcmservo.config.rig_file import Lab
from rcmservo.errors import RcmServoError
from rcmservo.interfaces import Measured
from rcmservo.live.servo_process import HeartbeatPlant
from rcmservo.live.terminal_person import Terminal
from rcmservo.loop.clock import Punctuality, WallClock

class Arm:
    q, deaf = np.array([0.6, 0.2, 120.0]), "deaf" in sys.argv
    def measure(self):
        return Measured(time.monotonic_ns(), self.q, "on" in sys.argv)
    def define(self, q):
        self.q = self.q if self.deaf else q

class Plant(HeartbeatPlant):
    def __init__(self):
        super().__init__(Arm(), None, Punctuality(WallClock()), None, lambda: False)

try:
    if "leave" in sys.argv:
        leave_to_move(Preparing(Lab(), "It moves."), Plant())
        print("[on]", flush=True)
    elif "show" in sys.argv:
        with closing(Terminal()) as person:
            shown(person, Plant())
    else:
        plant = Plant()
        with closing(Terminal()) as person:
            define(person, plant, Lab())
        print(plant.arm.q.tolist(), flush=True)
except RcmServoError as error:
    print(f"[{error}]", flush=True)
"""
WORD, JOINTS, SO = "ends this: ", "0.1 -0.2 100: ", "Enter if so: "


def at_the_arm(*what: str) -> AtTerminal:
    return AtTerminal([sys.executable, "-c", ARM, *what])


def test_a_fresh_word_gives_leave() -> None:
    with at_the_arm("leave") as at:
        assert "stands at theta 0.6 rad, phi 0.2 rad, rho 120 mm. It moves." in at.until(WORD)
        at.type("enable\n")
        at.until("[on]")


def test_a_word_that_nobody_read_for_a_while_gives_none_and_is_asked_for_again() -> None:
    with at_the_arm("leave") as at:
        at.until(WORD)
        at.process.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, at.process.pid, os.WSTOPPED)
        at.type("enable\n")
        with pytest.raises(subprocess.TimeoutExpired):
            at.process.wait(1.5)
        at.process.send_signal(signal.SIGCONT)
        assert "[on]" not in at.until(WORD)
        at.type("enable\n")
        at.until("[on]")


@pytest.mark.parametrize("answer", first_quick(["enable please", "", "Enable", "y"]))
def test_another_answer_ends_it(answer: str) -> None:
    with at_the_arm("leave") as at:
        at.until(WORD)
        at.type(f"{answer}\n")
        at.until("[nothing was switched on: the answer was not enable]")


def test_joints_are_typed_until_they_are_good_and_the_person_agrees() -> None:
    with at_the_arm("define") as at:
        for wrong in ("", "1 2", "0.5 nan 100", "0.5 0.1 100 7", "0.5 0.1 1e9"):
            at.until(JOINTS)
            at.type(f"{wrong}\n")
            at.until("the joints must be ")
        at.until(JOINTS)
        at.type("0.5, 0.1, 100\n")
        at.until("theta 0.5 rad, phi 0.1 rad, rho 100 mm. Enter if so: ")
        at.type("no\n")
        at.until(JOINTS)
        at.type("0.5 0.1 101\n")
        at.until(SO)
        at.type("\n")
        at.until("[0.5, 0.1, 101.0]")


def test_an_arm_that_does_not_take_what_it_is_told_is_not_used() -> None:
    with at_the_arm("define", "deaf") as at:
        at.until(JOINTS)
        at.type("0.5 0.1 100\n")
        at.until(SO)
        at.type("\n")
        at.until("[the arm stands elsewhere than it was told, at theta 0.6 rad")


def test_nobody_is_sent_to_move_an_arm_by_hand_whose_drive_is_on() -> None:
    with at_the_arm("show", "on") as at:
        at.until("[the arm's drive is on, by somebody else: switch it off there first]")
        assert "by hand" not in at.shown
