"""The simulated arm as a device: a process of its own that lives in wall time and is reached over a
wire alone.

Its physics keeps up with the clock in steps of a millisecond. The watchdog is fed by valid commands
of the session that has the drive, and by nothing else that arrives. Should this process itself be
held up, a command counts from the moment at which it was sent: a stall of the emulator is none of
the arm.
"""

import contextlib
import select
import shutil
import socket
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from rcmservo.errors import RcmServoError
from rcmservo.interfaces import Command
from rcmservo.live.arm_link import (
    Action,
    ArmState,
    Done,
    Message,
    Request,
    Setpoint,
    arm_socket_path,
    encode,
    open_socket,
    receive,
)
from rcmservo.live.child import heard
from rcmservo.live.realtime import realtime
from rcmservo.sim.arm import STEP
from rcmservo.sim.disturbances.arm_faults import DisturbedArm
from rcmservo.sim.processes.live_disturbances import Mischief
from rcmservo.sim.processes.motion_log import MotionLog
from rcmservo.sim.rig import SETTLE, Rig, RigSettings

PACE = 2_000_000
"""ns from answer to answer."""

KNOWN = 1_000_000_000
"""ns for which a servo that sends nothing gets answers."""

FRESH = 1_000_000_000
"""ns after which nobody still wants what was asked."""


class ArmDevice:
    """A simulated arm behind a wire; `turn` does all that is due at `now` ns of the wall clock."""

    def __init__(self, rig: Rig, wire: socket.socket, log: MotionLog, now: int) -> None:
        self.rig, self.wire, self.log = rig, wire, log
        self.arm = rig.truth.arm
        rig.open_to_trouble()
        assert isinstance(rig.arm, DisturbedArm)
        self.front = rig.arm
        self.session = 0
        self._callers: dict[str, int] = {}
        self._asked = 0
        self._due: list[tuple[int, str, int]] = []
        self._answered = 0
        self.arm.time = now // STEP * STEP
        self.arm.place(rig.scene.start)
        self.advance(now)

    def turn(self, now: int) -> None:
        """Hear what has come, let time pass until now, and answer."""
        for message, sender in receive(self.wire):
            if not self.front.silent:
                self._hear(message, sender, now)
        self.advance(now)
        if self.front.silent:
            return
        done = [entry for entry in self._due if entry[0] <= now]
        if done or now - self._answered >= PACE:
            self._answered = now
            self._answer(now)
        for entry in done:
            self._due.remove(entry)
            self._send(Done(entry[2]), entry[1])

    def advance(self, now: int) -> None:
        """Let time pass until `now`."""
        while self.arm.time < now:
            self._step()

    def off(self) -> None:
        """Zero and off, at once."""
        self.arm.watchdog.disable()
        self._step()

    def _step(self) -> None:
        self.rig.clock.wait_until(self.arm.time + STEP)
        dog = self.arm.watchdog
        self.log.add(
            self.arm.time, time.monotonic_ns(), dog.number, dog.enabled, dog.rates, self.arm.q_true
        )

    def _hear(self, message: Message, sender: str, now: int) -> None:
        match message:
            case Setpoint(session, command):
                if session == self.session or not command.enabled:
                    self._obey(command, now)
            case Request(number, session, action):
                if not (self._asked < number <= now and now - number <= FRESH):
                    return
                self._asked = number
                self._due.append((self._do(action, session, now), sender, number))
            case _:
                return
        self._callers[sender] = now

    def _obey(self, command: Command, now: int) -> None:
        self.advance(min(command.time, now))
        self.front.apply(command)

    def _do(self, action: Action, session: int, now: int) -> int:
        """Do what a person wants; when it will be done, ns."""
        self.advance(now)
        if action is Action.ENABLE:
            self.off()
            self.session = session
            self.front.enable()
        elif action in (Action.HOLD_AT_TARGET, Action.RETURN_TO_START):
            scene = self.rig.scene
            self.arm.place(scene.target if action is Action.HOLD_AT_TARGET else scene.start)
            return now + SETTLE
        return now

    def _answer(self, now: int) -> None:
        """Tell all who were heard of lately how the arm is."""
        self._callers = {
            caller: heard for caller, heard in self._callers.items() if now - heard <= KNOWN
        }
        at, q, enabled = self.front.measure()
        dog = self.arm.watchdog
        answer = ArmState(self.session, at, q, enabled, dog.rates, dog.number)
        for caller in self._callers:
            self._send(answer, caller)

    def _send(self, message: Message, caller: str) -> None:
        with contextlib.suppress(OSError):
            self.wire.sendto(encode(message), caller)


def emulate(
    folder: Path, seed: int, settings: RigSettings, log: MotionLog, control: Connection
) -> None:
    """Be the arm until the other end of `control` says "end" or is gone; "off" is answered once the
    drive is off.

    The first thing that it says itself is where the target will be shown, the joints (3,), or why
    there is no arm. The folder goes with it, also where nobody is left to tidy up.
    """
    try:
        rig, wire = Rig(seed, settings, pictures=False), open_socket(arm_socket_path(folder))
    except RcmServoError as error:
        control.send(RcmServoError(str(error)))
        return
    with contextlib.closing(wire), realtime():
        device = ArmDevice(rig, wire, log, time.monotonic_ns())
        control.send(rig.scene.target)
        said: Any = ""
        while said != "end":
            left = device.arm.time - time.monotonic_ns()
            ready, _, _ = select.select([wire, control], [], [], max(left, 0) * 1e-9)
            device.turn(time.monotonic_ns())
            said = heard(control) if control in ready else ""
            if isinstance(said, Mischief):
                said.befalls(rig.schedule)
            elif said == "off":
                device.off()
                control.send("off")
        device.off()
    shutil.rmtree(folder, ignore_errors=True)
