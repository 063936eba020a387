"""Simulated arm as a device: a separate process in wall time that is reached only over a socket.

Its physics follows the clock in steps of a millisecond. Only valid commands of the session that
owns the drive feed the watchdog. If this process itself is delayed, a command counts from the time
at which it was sent: a stall of the emulator must not look like one of the arm.
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
from rcmservo.live.arm_datagrams import (
    ArmAction,
    ArmRequest,
    ArmState,
    Done,
    Message,
    SessionCommand,
    arm_socket_path,
    encode,
    open_socket,
    receive,
)
from rcmservo.live.child_process import receive_from_parent
from rcmservo.live.realtime import realtime
from rcmservo.sim.arm import PHYSICS_STEP_NS
from rcmservo.sim.disturbances.effects.arm_faults import DisturbedArm
from rcmservo.sim.processes.live_disturbances import DisturbanceChange
from rcmservo.sim.processes.motion_log import MotionLog
from rcmservo.sim.rig import SETTLE_TIME_NS, Rig, RigSettings

STATE_PERIOD_NS = 2_000_000
"""Period of the arm's state messages, ns."""

CLIENT_TIMEOUT_NS = 1_000_000_000
"""Time (ns) for which a client that sends nothing still receives state messages."""

REQUEST_LIFETIME_NS = 1_000_000_000
"""Time (ns) after which a request is too old to be carried out."""


class ArmDevice:
    """Simulated arm behind a socket.

    Parameters
    ----------
    rig : Rig
        Simulated laboratory of the arm.
    wire : socket.socket
        Socket of the arm.
    log : MotionLog
        Log of the arm's motion.
    now : int
        Present wall time, ns.
    """

    def __init__(self, rig: Rig, wire: socket.socket, log: MotionLog, now: int) -> None:
        self.rig, self.wire, self.log = rig, wire, log
        self.arm = rig.truth.arm
        rig.accept_live_disturbances()
        assert isinstance(rig.arm, DisturbedArm)
        self.disturbed_arm = rig.arm
        self.session = 0
        self._clients: dict[str, int] = {}
        self._last_request = 0
        self._pending: list[tuple[int, str, int]] = []
        self._last_state_time = 0
        self.arm.time = now // PHYSICS_STEP_NS * PHYSICS_STEP_NS
        self.arm.place(rig.scene.start)
        self.advance(now)

    def step(self, now: int) -> None:
        """Process the received messages, let time pass until `now` (ns) and answer."""
        for message, sender in receive(self.wire):
            if not self.disturbed_arm.is_silent:
                self._receive(message, sender, now)
        self.advance(now)
        if self.disturbed_arm.is_silent:
            return
        finished = [entry for entry in self._pending if entry[0] <= now]
        if finished or now - self._last_state_time >= STATE_PERIOD_NS:
            self._last_state_time = now
            self._send_state(now)
        for entry in finished:
            self._pending.remove(entry)
            self._send(Done(entry[2]), entry[1])

    def advance(self, now: int) -> None:
        """Let time pass until `now` (ns)."""
        while self.arm.time < now:
            self._step()

    def switch_off(self) -> None:
        """Zero the rates and switch the drive off, at once."""
        self.arm.watchdog.disable()
        self._step()

    def _step(self) -> None:
        self.rig.clock.wait_until(self.arm.time + PHYSICS_STEP_NS)
        watchdog = self.arm.watchdog
        self.log.add(
            self.arm.time,
            time.monotonic_ns(),
            watchdog.number,
            watchdog.enabled,
            watchdog.rates,
            self.arm.q_true,
        )

    def _receive(self, message: Message, sender: str, now: int) -> None:
        match message:
            case SessionCommand(session, command):
                if session == self.session or not command.enabled:
                    self._apply_command(command, now)
            case ArmRequest(number, session, request):
                if not (self._last_request < number <= now and now - number <= REQUEST_LIFETIME_NS):
                    return
                self._last_request = number
                self._pending.append((self._carry_out(request, session, now), sender, number))
            case _:
                return
        self._clients[sender] = now

    def _apply_command(self, command: Command, now: int) -> None:
        self.advance(min(command.time, now))
        self.disturbed_arm.apply(command)

    def _carry_out(self, request: ArmAction, session: int, now: int) -> int:
        """Carry out an operator's request; return the time (ns) at which it is done."""
        self.advance(now)
        if request is ArmAction.ENABLE:
            self.switch_off()
            self.session = session
            self.disturbed_arm.enable()
        elif request in (ArmAction.HOLD_AT_TARGET, ArmAction.RETURN_TO_START):
            scene = self.rig.scene
            self.arm.place(scene.target if request is ArmAction.HOLD_AT_TARGET else scene.start)
            return now + SETTLE_TIME_NS
        return now

    def _send_state(self, now: int) -> None:
        """Send the arm's state to all recent clients."""
        self._clients = {
            client: last_seen
            for client, last_seen in self._clients.items()
            if now - last_seen <= CLIENT_TIMEOUT_NS
        }
        at, q, enabled = self.disturbed_arm.measure()
        watchdog = self.arm.watchdog
        answer = ArmState(self.session, at, q, enabled, watchdog.rates, watchdog.number)
        for client in self._clients:
            self._send(answer, client)

    def _send(self, message: Message, client: str) -> None:
        with contextlib.suppress(OSError):
            self.wire.sendto(encode(message), client)


def run_arm_process(
    folder: Path, seed: int, settings: RigSettings, log: MotionLog, control: Connection
) -> None:
    """Run the arm until the other end of `control` sends "end" or closes.

    The first message that it sends is the joints (3,) of the target, or the error for which there
    is no arm. It answers "off" after the drive is off. It deletes the folder at the end, because
    the parent process may be dead.

    Parameters
    ----------
    folder : pathlib.Path
        Folder of the socket.
    seed : int
        Seed of the laboratory.
    settings : RigSettings
        Parts of the laboratory.
    log : MotionLog
        Log of the arm's motion.
    control : multiprocessing.connection.Connection
        Connection to the parent process.
    """
    try:
        rig, wire = Rig(seed, settings, pictures=False), open_socket(arm_socket_path(folder))
    except RcmServoError as error:
        control.send(RcmServoError(str(error)))
        return
    with contextlib.closing(wire), realtime():
        device = ArmDevice(rig, wire, log, time.monotonic_ns())
        control.send(rig.scene.target)
        message: Any = ""
        while message != "end":
            remaining = device.arm.time - time.monotonic_ns()
            ready, _, _ = select.select([wire, control], [], [], max(remaining, 0) * 1e-9)
            device.step(time.monotonic_ns())
            message = receive_from_parent(control) if control in ready else ""
            if isinstance(message, DisturbanceChange):
                message.apply(rig.schedule)
            elif message == "off":
                device.switch_off()
                control.send("off")
        device.switch_off()
    shutil.rmtree(folder, ignore_errors=True)
