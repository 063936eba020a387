"""Operator at the page: the requests of the browser in control, as the loop reads them each tick.

A session starts paused, so that nothing moves before the operator requests it. Autonomous motion
pauses when the browser's heartbeats cease. A jog moves the joints while the browser repeats the
command: a late command stops the tool, the next one moves it again. A pose sequence moves the tool
from pose to pose until something stops the tool.
"""

from collections import deque
from dataclasses import replace
from typing import TypeVar

import numpy as np

from rcmservo.errors import BadInput
from rcmservo.geometry.kinematics import compute_joint_rates
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.operator import Jog, OperatorRequest, Teach, check_changed_servo
from rcmservo.loop.pixel_precision import describe_precision
from rcmservo.loop.target_frames import TEACHING_FRAMES
from rcmservo.loop.tick import Tick
from rcmservo.page.channels import PageChannels
from rcmservo.page.jog_state import NO_PRESS, JogCommand
from rcmservo.page.messages import (
    Go,
    Note,
    PoseTaught,
    SequenceStatus,
    SettingsApplied,
    SettingsChange,
    StatusMessage,
    TargetChanged,
    TeachingStatus,
    TeachPose,
)
from rcmservo.page.pose_sequence import (
    AUTONOMOUS_PHASES,
    RunSequence,
    SequenceProgress,
    SequenceRunner,
)
from rcmservo.page.selected_settings import IMMEDIATE_PARTS, SelectedSettings
from rcmservo.safety.state_machine import SLOW_SPEED_SCALE, Phase, Request
from rcmservo.servo.servo import Servo

HEARTBEAT_TIMEOUT_NS = 500_000_000
"""Time (ns) without a heartbeat of the browser in control after which the tool is paused."""

JOG_TIMEOUT_NS = 80_000_000
"""Time (ns) without a repeated jog command after which the tool stops until the next command."""

PRESS_TIMEOUT_NS = 1_000_000_000
"""Time (ns) without a repeated jog command after which the button must be pressed again."""

FRAMES_PER_REPORT = 15
"""Frames between two reports on teaching, a quarter of a second."""

Requested = TypeVar("Requested", Target, Servo)


PRECISION_IS_UNKNOWN = "the precision of the image is known once the tool has explored"


class PageOperator:
    """Operator whose requests come from the page.

    Parameters
    ----------
    channels : PageChannels
        Channels to the page.
    selection : SelectedSettings
        Settings at the start of the session.
    frames : int
        Number of frames whose mean is a target.
    """

    def __init__(
        self, channels: PageChannels, selection: SelectedSettings, frames: int = TEACHING_FRAMES
    ) -> None:
        self._channels, self._selection, self._frames = channels, selection, frames
        self._requests: deque[tuple[OperatorRequest, str | None]] = deque([(Request.PAUSE, None)])
        """Requests for the next ticks, each with the name of the pose that it teaches, or None."""
        command = channels.jog_state.read() or JogCommand()
        self._jog_command, self._ended_press, self._active_press = command, command.press, NO_PRESS
        self._heartbeat_ns: int | None = None
        """Time (ns) of the browser's last sign of life; None before the first tick."""
        self._taught_name: str | None = None
        """Name of the pose that is being taught, "" for one that is not stored, None for none."""
        self._observed_frames, self._frame = 0, -1
        self._sequence: SequenceRunner | None = None
        self._reported_servo: Servo | None = None
        self._reported_target: Target | None = None
        self._reported_progress: SequenceProgress | None = None
        # Kernels are compiled here, so that no compilation delays the loop.
        compute_joint_rates(selection.servo.rcm, np.zeros(3), np.zeros(3))
        describe_precision(selection.servo.init(), selection.servo.tool)

    def __call__(self, tick: Tick) -> OperatorRequest:
        self._channels.ticks.add(tick)
        self._report_changes(tick)
        self._report_teaching(tick)
        self._read_jog_state(tick)
        self._advance_sequence(tick)
        for message in self._channels.requests.receive_all():
            self._handle(message, tick)
        if self._is_unattended(tick):
            self._requests.clear()
            return Request.PAUSE
        if not self._requests:
            return self._request_jog(tick)
        request, name = self._requests.popleft()
        self._cancel_teaching()
        self._taught_name = name
        if self._jog_command.press != NO_PRESS:
            self._ended_press = self._jog_command.press
        return request

    def _cancel_teaching(self) -> None:
        """End teaching without a result and report it, if a pose is being taught."""
        if self._taught_name is not None:
            self._report(Note(f"{self._taught_name or 'the target'} was not taught"))
            self._end_teaching()

    def _end_teaching(self) -> None:
        self._taught_name = None
        self._observed_frames = 0
        self._report(TeachingStatus(""))

    def _report_teaching(self, tick: Tick) -> None:
        """Report the number of frames since teaching began in which both markers are observed."""
        frame, is_observed = tick.observation.frame, np.isfinite(tick.observation.points).all()
        is_new, self._frame = frame != self._frame, frame
        if self._taught_name is None or not (is_new and is_observed):
            return
        self._observed_frames += 1
        if self._observed_frames % FRAMES_PER_REPORT == 1:
            precision = describe_precision(tick.state, tick.servo.tool) or PRECISION_IS_UNKNOWN
            count = f"{self._observed_frames} of {self._frames} frames"
            words = f"teaching, keep the tool still: {count}; {precision}"
            self._report(TeachingStatus(words))

    def _read_jog_state(self, tick: Tick) -> None:
        """Read the jog command. End a press that the browser has not repeated for long."""
        command = self._channels.jog_state.read() or self._jog_command
        if self._heartbeat_ns is None or command.heartbeats != self._jog_command.heartbeats:
            self._heartbeat_ns = tick.observation.now
        self._jog_command = command
        is_over = self._get_silence_ns(tick) > PRESS_TIMEOUT_NS
        if is_over and command.press not in (NO_PRESS, self._ended_press):
            self._ended_press = command.press
            self._report(Note("the browser was silent during a jog: press the button again"))

    def _handle(self, message: object, tick: Tick) -> None:
        match message:
            case Go():
                self._request_motion((message.target,), tick)
            case RunSequence():
                if self._request_motion(message.targets, tick):
                    self._sequence = SequenceRunner(message)
            case TeachPose():
                self._requests.append((Teach(self._frames), message.name))
            case SettingsChange():
                self._change_settings(message, tick)
            case Request():
                self._requests.append((message, None))
            case _:
                self._report(Note(f"{type(message).__name__}: not while the drive is on"))

    def _request_motion(self, targets: tuple[Target, ...], tick: Tick) -> bool:
        """Request the first target. Return False if the settings do not support all targets."""
        try:
            for target in targets:
                self._find_pending(Servo, tick.servo).require_target(target)
        except BadInput as error:
            self._report(Note(str(error)))
            return False
        self._requests.append((targets[0], None))
        if tick.state.phase not in AUTONOMOUS_PHASES:
            self._requests.append((Request.RESUME, None))
        return True

    def _advance_sequence(self, tick: Tick) -> None:
        """Advance the pose sequence once the tick includes all earlier requests."""
        sequence = self._sequence
        if sequence is not None and not self._requests:
            if sequence.update(tick):
                self._requests.append((sequence.target, None))
            elif sequence.progress is None:
                self._sequence = None
                if tick.state.phase in AUTONOMOUS_PHASES:
                    self._requests.append((Request.PAUSE, None))
                self._report(Note(sequence.outcome))
        progress = None if self._sequence is None else self._sequence.progress
        if progress != self._reported_progress:
            self._reported_progress = progress
            self._report(SequenceStatus(progress))

    def _change_settings(self, change: SettingsChange, tick: Tick) -> None:
        """Change a part that may change now; other parts change with the next session."""
        if change.part not in IMMEDIATE_PARTS:
            return
        try:
            selection = self._selection.with_change(change)
            servo = check_changed_servo(tick.servo, selection.limited)
            assert tick.state.target is not None
            servo.require_target(self._find_pending(Target, tick.state.target))
        except BadInput as error:
            self._report(Note(f"not before the next session: {error}"))
            return
        self._selection = selection
        self._requests.append((servo, None))

    def _find_pending(self, kind: type[Requested], present: Requested) -> Requested:
        """Return the newest pending request of a type, or the present value if there is none."""
        pending = [request for request, _ in self._requests if isinstance(request, kind)]
        return pending[-1] if pending else present

    def _is_unattended(self, tick: Tick) -> bool:
        """Return whether the servo moves the tool autonomously without an operator."""
        is_silent = self._get_silence_ns(tick) > HEARTBEAT_TIMEOUT_NS
        return tick.state.phase in AUTONOMOUS_PHASES and is_silent

    def _get_silence_ns(self, tick: Tick) -> int:
        """Return the time (ns) since the browser's last sign of life."""
        assert self._heartbeat_ns is not None
        return tick.observation.now - self._heartbeat_ns

    def _request_jog(self, tick: Tick) -> OperatorRequest:
        """Return the motion of the held button. A press ends when the servo stops the jog."""
        command = self._jog_command
        if self._active_press != NO_PRESS and tick.state.phase is not Phase.JOG:
            self._ended_press = self._active_press
        is_held = command.press not in (NO_PRESS, self._ended_press)
        is_moving = is_held and self._get_silence_ns(tick) <= JOG_TIMEOUT_NS
        self._active_press = command.press if is_moving else NO_PRESS
        if not is_moving:
            return Request.NONE
        self._cancel_teaching()
        if self._sequence is not None:
            return Request.PAUSE
        rates = _compute_jog_rates(command, tick)
        return Jog(rates) if np.isfinite(rates).all() else Request.NONE

    def _report_changes(self, tick: Tick) -> None:
        """Report new settings, a new target, and a taught pose to the page."""
        if tick.servo is not self._reported_servo:
            self._reported_servo = tick.servo
            self._report(SettingsApplied(replace(tick.servo)))
        target, name = tick.state.target, self._taught_name
        if target is None or target is self._reported_target:
            return
        self._reported_target = target
        self._report(TargetChanged(target))
        if name is not None:
            self._report(PoseTaught(name, target) if name else Note("the target was taught again"))
            self._end_teaching()

    def _report(self, message: StatusMessage) -> None:
        self._channels.status.send(message)


def _compute_jog_rates(command: JogCommand, tick: Tick) -> Floats:
    """Return the joint rates (3,) rad/s, rad/s, mm/s of a jog command at the present joints.

    The rates are scaled down to the fraction `speed_scale` of the jog speed. They are not finite if
    the joints are unknown.
    """
    rates = np.array([command.first, command.second, command.third])
    if command.moves_marker:
        rates = compute_joint_rates(tick.servo.rcm, np.array(tick.observation.q), rates)
    limits = SLOW_SPEED_SCALE * command.speed_scale * np.array(tick.servo.gate.speed)
    return rates / max(1.0, float(np.abs(rates / limits).max()))
