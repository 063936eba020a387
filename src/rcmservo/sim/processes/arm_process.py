"""Simulated arm as a device: a separate process in wall time that is reached only over a socket.

Its physics follows the clock in steps of a millisecond. Only valid commands of the session that
enabled the drive feed the watchdog. If this process itself is late, a command acts from the time at
which it was sent, so that a stall of the simulation does not look like a stall of the arm.
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
from rcmservo.live.realtime import apply_realtime_settings
from rcmservo.sim.arm import PHYSICS_STEP_NS
from rcmservo.sim.disturbances.effects.arm_faults import DisturbedArm
from rcmservo.sim.processes.live_disturbances import DisturbanceChange
from rcmservo.sim.processes.motion_log import MotionLog
from rcmservo.sim.rig import SETTLE_TIME_NS, RigSettings, SimulatedRig

STATE_PERIOD_NS = 2_000_000
"""Period of the arm's state messages, ns."""

CLIENT_TIMEOUT_NS = 1_000_000_000
"""Time (ns) after its last message for which a client receives state messages."""

REQUEST_LIFETIME_NS = 1_000_000_000
"""Time (ns) after which a request is too old to be carried out."""


class ArmDevice:
    """Simulated arm behind a socket.

    Parameters
    ----------
    rig : SimulatedRig
        Simulated laboratory of the arm.
    endpoint : socket.socket
        Socket of the arm.
    log : MotionLog
        Log of the arm's motion.
    now : int
        Present wall time, ns.
    """

    def __init__(
        self, rig: SimulatedRig, endpoint: socket.socket, log: MotionLog, now: int
    ) -> None:
        self.rig, self.endpoint, self.log = rig, endpoint, log
        self.arm = rig.truth.arm
        rig.accept_live_disturbances()
        assert isinstance(rig.arm, DisturbedArm)
        self.disturbed_arm = rig.arm
        self.session = 0
        self._last_message_times: dict[str, int] = {}
        self._last_request = 0
        self._pending_answers: list[tuple[int, str, Done]] = []
        self._last_state_time = 0
        self.arm.time = now // PHYSICS_STEP_NS * PHYSICS_STEP_NS
        self.arm.place(rig.scene.start)
        self.advance(now)

    def step(self, now: int) -> None:
        """Process the received messages, let time pass until `now` (ns) and answer."""
        for message, sender in receive(self.endpoint):
            if not self.disturbed_arm.is_silent:
                self._receive(message, sender, now)
        self.advance(now)
        if self.disturbed_arm.is_silent:
            return
        due_answers = [answer for answer in self._pending_answers if answer[0] <= now]
        if due_answers or now - self._last_state_time >= STATE_PERIOD_NS:
            self._last_state_time = now
            self._send_state(now)
        for due_answer in due_answers:
            self._pending_answers.remove(due_answer)
            _, client, message = due_answer
            self._send(message, client)

    def advance(self, now: int) -> None:
        """Let time pass until `now` (ns)."""
        while self.arm.time < now:
            self._step_physics()

    def switch_off(self) -> None:
        """Zero the rates and switch the drive off, at once."""
        self.arm.watchdog.disable()
        self._step_physics()

    def _step_physics(self) -> None:
        """Let one physics step pass and log it."""
        self.rig.clock.wait_until(self.arm.time + PHYSICS_STEP_NS)
        now, watchdog = time.monotonic_ns(), self.arm.watchdog
        state = watchdog.number, watchdog.enabled, watchdog.rates
        self.log.add(self.arm.time, now, *state, self.arm.q_true)

    def _receive(self, message: Message, sender: str, now: int) -> None:
        """Apply a command, carry out a request, and store that the sender is a client."""
        match message:
            case SessionCommand(session, command):
                if session == self.session or not command.enabled:
                    self.advance(min(command.time, now))
                    self.disturbed_arm.apply(command)
            case ArmRequest(number, session, request):
                if not (self._last_request < number <= now and now - number <= REQUEST_LIFETIME_NS):
                    return
                self._last_request = number
                done_time = self._carry_out(request, session, now)
                self._pending_answers.append((done_time, sender, Done(number)))
            case _:
                return
        self._last_message_times[sender] = now

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
        measurement, watchdog = self.disturbed_arm.measure(), self.arm.watchdog
        state = ArmState(self.session, *measurement, watchdog.rates, watchdog.number)
        for client, last_message_time in self._last_message_times.items():
            if now - last_message_time <= CLIENT_TIMEOUT_NS:
                self._send(state, client)

    def _send(self, message: Message, client: str) -> None:
        """Send a message to a client, which may have closed its socket."""
        with contextlib.suppress(OSError):
            self.endpoint.sendto(encode(message), client)


def run_arm_process(
    folder: Path, seed: int, settings: RigSettings, log: MotionLog, control: Connection
) -> None:
    """Run the arm until the parent process sends "end" or closes its end of `control`.

    The first message to the parent is the joints (3,) of the target, or the error that prevents the
    arm from starting. After "off" from the parent, it switches the drive off and answers "off". It
    deletes the folder at the end, because the parent process may be dead.

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
        rig, endpoint = (
            SimulatedRig(seed, settings, pictures=False),
            open_socket(arm_socket_path(folder)),
        )
    except RcmServoError as error:
        control.send(RcmServoError(str(error)))
        return
    with contextlib.closing(endpoint), apply_realtime_settings():
        device = ArmDevice(rig, endpoint, log, time.monotonic_ns())
        control.send(rig.scene.target)
        message: Any = ""
        while message != "end":
            remaining_s = (device.arm.time - time.monotonic_ns()) * 1e-9
            readable, _, _ = select.select([endpoint, control], [], [], max(remaining_s, 0.0))
            device.step(time.monotonic_ns())
            message = receive_from_parent(control) if control in readable else ""
            if isinstance(message, DisturbanceChange):
                message.apply(rig.schedule)
            elif message == "off":
                device.switch_off()
                control.send("off")
        device.switch_off()
    shutil.rmtree(folder, ignore_errors=True)
