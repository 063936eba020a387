"""Motion profile of one emulated axis, its limits and its stops.

In jog mode the profile's speed follows JG with the acceleration AC and the deceleration DC. In a
positioning move it slows down in time to end at the target. The reference position integrates this
speed, and the motor follows the reference. Units are counts and seconds.

Source: command reference, JG, PR, PA, AC, DC, SD, FL, BL, OE, SC.
"""

import math
from dataclasses import dataclass, field
from enum import Enum

MIN_POSITION, MAX_POSITION = -(2**31), 2**31 - 1
"""Range of positions in counts. As soft limits these values limit nothing."""

POSITION_GAIN = 20.0
"""Gain of the position loop in 1/s: speed correction per position error."""


class MoveMode(Enum):
    """Kind of motion that BG begins."""

    JOG = "JG"
    RELATIVE = "PR"
    ABSOLUTE = "PA"


class StopCode:
    """Reason why an axis has stopped or decelerates (SC).

    ``RUNNING`` is no stop, ``DONE`` the end of a move, ``FORWARD`` and ``REVERSE`` are limits,
    ``COMMAND`` is ST and ``ABORTED`` is AB. ``OFF_ON_ERROR`` is an excessive position error, and
    ``AMPLIFIER`` an amplifier's fault; both switch the motor off.
    """

    RUNNING, DONE, FORWARD, REVERSE, COMMAND, ABORTED = 0, 1, 2, 3, 4, 7
    OFF_ON_ERROR, AMPLIFIER = 8, 15
    LIMITS = FORWARD, REVERSE


@dataclass
class AxisSettings:
    """Settings of one axis in counts and seconds, named like the commands that set them.

    Parameters
    ----------
    AC : float
        Acceleration.
    DC : float
        Deceleration.
    SD : float
        Deceleration at a limit.
    SP : float
        Speed of a positioning move.
    JG : float
        Signed speed of a jog.
    PR : float
        Distance of a relative move.
    PA : float
        Target of an absolute move.
    FL : float
        Forward soft limit.
    BL : float
        Reverse soft limit.
    ER : float
        Limit of the position error.
    OE : float
        1 and 3 switch the motor off when the position error exceeds ER.
    LD : float
        Disabled limit switches: 1 the forward one, 2 the reverse one, 3 both.
    ZA : float
        User variable in the data record.
    MT : float
        Motor type.
    """

    AC: float = 256000.0
    DC: float = 256000.0
    SD: float = 256000.0
    SP: float = 25000.0
    JG: float = 25000.0
    PR: float = 0.0
    PA: float = 0.0
    FL: float = MAX_POSITION
    BL: float = MIN_POSITION
    ER: float = 16384.0
    OE: float = 0.0
    LD: float = 0.0
    ZA: float = 0.0
    MT: float = 1.0


@dataclass
class Axis:
    """State of one axis. `step` advances it by one sample.

    Parameters
    ----------
    settings : AxisSettings
        Settings of the axis.
    mode : MoveMode
        Kind of motion that BG begins or has begun.
    motor_off : bool
        True if the motor is off (MO).
    moving : bool
        True while the profile runs (_BG).
    stop_code : int
        Reason of the last or present stop (SC).
    stopping : bool
        True while the axis decelerates before the end of its move.
    speed : float
        Speed of the profile.
    reference : float
        Reference position (RP).
    position : float
        Encoder position (TP).
    target : float
        End of a positioning move.
    forward_tripped : bool
        True if the forward limit switch is tripped.
    reverse_tripped : bool
        True if the reverse limit switch is tripped.
    velocity : float
        Filtered encoder velocity (TV).
    """

    settings: AxisSettings = field(default_factory=AxisSettings)
    mode: MoveMode = MoveMode.JOG
    motor_off: bool = False
    moving: bool = False
    stop_code: int = StopCode.DONE
    stopping: bool = False
    speed: float = 0.0
    reference: float = 0.0
    position: float = 0.0
    target: float = 0.0
    forward_tripped: bool = False
    reverse_tripped: bool = False
    velocity: float = 0.0

    @property
    def error(self) -> float:
        """Position error (TE)."""
        return self.reference - self.position

    @property
    def is_stopping_at_limit(self) -> bool:
        """True while the axis decelerates because of a limit."""
        return self.stopping and self.stop_code in StopCode.LIMITS

    @property
    def switches_off_on_error(self) -> bool:
        """True if an excessive position error switches the motor off (OE)."""
        return self.settings.OE in (1.0, 3.0)

    @property
    def can_move_forward(self) -> bool:
        """True if no limit prohibits forward motion."""
        at_switch = self.forward_tripped and self.settings.LD not in (1.0, 3.0)
        return not at_switch and self.position <= self.settings.FL

    @property
    def can_move_reverse(self) -> bool:
        """True if no limit prohibits reverse motion."""
        at_switch = self.reverse_tripped and self.settings.LD not in (2.0, 3.0)
        return not at_switch and self.position >= self.settings.BL

    def commanded_motion(self) -> float:
        """Return the jog speed or the distance that BG would begin; its sign is the direction."""
        if self.mode is MoveMode.JOG:
            return self.settings.JG
        if self.mode is MoveMode.RELATIVE:
            return self.settings.PR
        return self.settings.PA - self.reference

    def begin(self) -> None:
        """Start the motion (BG)."""
        self.moving, self.stopping, self.stop_code = True, False, StopCode.RUNNING
        self.target = self.reference + self.commanded_motion()

    def stop(self, code: int) -> None:
        """Decelerate to rest."""
        if self.moving:
            self.stopping, self.stop_code = True, code

    def abort(self, code: int) -> None:
        """Stop at once, without deceleration."""
        if self.moving:
            self.stop_code = code
        self.moving, self.stopping, self.speed = False, False, 0.0

    def switch_off(self, code: int | None = None) -> None:
        """Switch the motor off. Without a code the stop code stays as it is."""
        self.abort(self.stop_code)
        self.motor_off = True
        if code is not None:
            self.stop_code = code

    def switch_on(self) -> None:
        """Switch the motor on and hold the present position."""
        self.motor_off, self.reference = False, self.position

    def define_position(self, position: float) -> None:
        """Set the value of the present position (DP)."""
        self.reference = self.position = position

    def step(self, seconds: float, lag: float) -> float:
        """Advance by one sample and return the speed command for the motor.

        A feedforward of the acceleration compensates for the time constant `lag` (s) of the motor.
        """
        if self.motor_off:
            return 0.0
        previous_speed = self.speed
        if self.moving:
            self._check_limits()
            self._update_speed(seconds)
            self.reference += self.speed * seconds
            if self.stopping and self.speed == 0.0:
                self.moving = self.stopping = False
        feedforward = lag * (self.speed - previous_speed) / seconds
        return self.speed + feedforward + POSITION_GAIN * self.error

    def check_following_error(self) -> None:
        """Switch the motor off if the position error exceeds its limit (OE, ER)."""
        is_checked = self.switches_off_on_error and not self.motor_off
        if is_checked and abs(self.error) > self.settings.ER:
            self.switch_off(StopCode.OFF_ON_ERROR)

    def _check_limits(self) -> None:
        if self.is_stopping_at_limit:
            return
        if self.speed > 0.0 and not self.can_move_forward:
            self.stop(StopCode.FORWARD)
        elif self.speed < 0.0 and not self.can_move_reverse:
            self.stop(StopCode.REVERSE)

    def _update_speed(self, seconds: float) -> None:
        if self.is_stopping_at_limit:
            self._change_speed_towards(0.0, seconds, self.settings.SD)
        elif self.stopping:
            self._change_speed_towards(0.0, seconds, self.settings.DC)
        elif self.mode is MoveMode.JOG:
            self._change_speed_towards(self.settings.JG, seconds, self.settings.DC)
        else:
            self._approach(seconds)

    def _change_speed_towards(self, speed: float, seconds: float, deceleration: float) -> None:
        """Change the profile's speed towards another, by AC or the deceleration at most.

        A reversal first decelerates to zero.
        """
        accelerates = self.speed * speed >= 0.0 and abs(speed) > abs(self.speed)
        max_change = (self.settings.AC if accelerates else deceleration) * seconds
        reverses = self.speed * speed < 0.0
        change = (0.0 if reverses else speed) - self.speed
        self.speed += min(max(change, -max_change), max_change)

    def _approach(self, seconds: float) -> None:
        """Update the speed of a positioning move, slow enough to stop at its target."""
        remaining = self.target - self.reference
        max_speed = math.sqrt(2.0 * self.settings.DC * abs(remaining))
        speed = math.copysign(min(self.settings.SP, max_speed), remaining)
        self._change_speed_towards(speed, seconds, self.settings.DC)
        if abs(remaining) <= max(abs(self.speed) * seconds, 0.5):
            self.reference, self.speed = self.target, 0.0
            self.moving, self.stop_code = False, StopCode.DONE
