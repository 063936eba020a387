"""One axis: how its commanded speed goes up and down, and what stops it.

A jogging axis follows its speed with the acceleration AC and the deceleration DC; a positioning one
turns back in time to end where it was to go. The reference goes where this leads, and the motor
follows it. Units are counts and seconds. Source: command reference, JG, PR, PA, AC, DC, SD, FL, BL,
OE, SC.
"""

import math
from dataclasses import dataclass, field
from enum import Enum

FAR = 2147483647
"""Counts: a soft limit that is off."""

STIFF = 20.0
"""1/s. With so much of its position error a motor's speed is corrected."""


class MoveMode(Enum):
    """What BG begins."""

    JOG = "JG"
    RELATIVE = "PR"
    ABSOLUTE = "PA"


class StopCode:
    """Why an axis stands or comes to rest (SC)."""

    RUNNING, DONE, FORWARD, REVERSE, COMMAND, ABORTED = 0, 1, 2, 3, 4, 7
    OFF_ON_ERROR, AMPLIFIER = 8, 15


@dataclass
class Settings:
    """What is set for one axis, in counts and seconds; each is named as its command."""

    AC: float = 256000.0
    """Acceleration."""
    DC: float = 256000.0
    """Deceleration."""
    SD: float = 256000.0
    """Deceleration at a limit."""
    SP: float = 25000.0
    """Speed of a positioning move."""
    JG: float = 25000.0
    """Speed of a jog, with its sign."""
    PR: float = 0.0
    """Way of a relative move."""
    PA: float = 0.0
    """End of an absolute move."""
    FL: float = FAR
    """Forward soft limit."""
    BL: float = -FAR - 1
    """Reverse soft limit."""
    ER: float = 16384.0
    """Position error that is too large."""
    OE: float = 0.0
    """1 and 3: the motor goes off where the error is too large."""
    LD: float = 0.0
    """1 disables the forward limit switch, 2 the reverse one, 3 both."""
    ZA: float = 0.0
    """A number of the user's in the data record."""
    MT: float = 1.0
    """Motor type."""


@dataclass
class Axis:
    """One axis; `step` lets a sample pass."""

    settings: Settings = field(default_factory=Settings)
    """What is set."""
    mode: MoveMode = MoveMode.JOG
    """What BG begins, or began."""
    off: bool = False
    """Whether its motor is off (MO)."""
    moving: bool = False
    """Whether its profile is under way (_BG)."""
    stop_code: int = StopCode.DONE
    """Why it stands, or is coming to rest."""
    stopping: bool = False
    """Whether it comes to rest before it was to."""
    speed: float = 0.0
    """Of the profile."""
    reference: float = 0.0
    """Where the profile is (RP)."""
    position: float = 0.0
    """Where the encoder is (TP)."""
    end: float = 0.0
    """Where a positioning move ends."""
    forward: bool = False
    """Whether the forward limit switch is tripped."""
    reverse: bool = False
    """Whether the reverse limit switch is tripped."""
    velocity: float = 0.0
    """Of the encoder, filtered (TV)."""

    @property
    def error(self) -> float:
        """Position error (TE)."""
        return self.reference - self.position

    @property
    def may_forward(self) -> bool:
        """Whether no limit forbids it to go forward."""
        switched = self.forward and self.settings.LD not in (1.0, 3.0)
        return not switched and self.position <= self.settings.FL

    @property
    def may_reverse(self) -> bool:
        """Whether no limit forbids it to go backward."""
        switched = self.reverse and self.settings.LD not in (2.0, 3.0)
        return not switched and self.position >= self.settings.BL

    def heads(self) -> float:
        """Which way BG would send it: its sign."""
        if self.mode is MoveMode.JOG:
            return self.settings.JG
        if self.mode is MoveMode.RELATIVE:
            return self.settings.PR
        return self.settings.PA - self.reference

    def begin(self) -> None:
        """Set out."""
        self.moving, self.stopping, self.stop_code = True, False, StopCode.RUNNING
        self.end = self.reference + self.heads()

    def stop(self, code: int) -> None:
        """Come to rest, decelerating."""
        if self.moving:
            self.stopping, self.stop_code = True, code

    def abort(self, code: int) -> None:
        """Stand still at once."""
        if self.moving:
            self.stop_code = code
        self.moving, self.stopping, self.speed = False, False, 0.0

    def switch_off(self, code: int | None = None) -> None:
        """Let the motor go."""
        self.abort(self.stop_code)
        self.off, self.stop_code = True, self.stop_code if code is None else code

    def switch_on(self) -> None:
        """Hold the motor where it is."""
        self.off, self.reference = False, self.position

    def define(self, position: float) -> None:
        """Call the present place `position`."""
        self.reference = self.position = position

    def step(self, seconds: float, lag: float) -> float:
        """A sample passes; the speed that the motor is then asked for. It is tuned to a motor that
        lags by so many s: what that would lose while the speed changes is added."""
        if self.off:
            return 0.0
        before = self.speed
        if self.moving:
            self._look_at_limits()
            self._change_speed(seconds)
            self.reference += self.speed * seconds
            if self.stopping and self.speed == 0.0:
                self.moving = self.stopping = False
        lost = lag * (self.speed - before) / seconds
        return self.speed + lost + STIFF * self.error

    def watch(self) -> None:
        """Switch off on an error that is too large (OE, ER)."""
        if not self.off and self.settings.OE in (1.0, 3.0) and abs(self.error) > self.settings.ER:
            self.switch_off(StopCode.OFF_ON_ERROR)

    def _look_at_limits(self) -> None:
        if self.stopping and self.stop_code in (StopCode.FORWARD, StopCode.REVERSE):
            return
        if self.speed > 0.0 and not self.may_forward:
            self.stop(StopCode.FORWARD)
        elif self.speed < 0.0 and not self.may_reverse:
            self.stop(StopCode.REVERSE)

    def _change_speed(self, seconds: float) -> None:
        if self.stopping:
            limited = self.stop_code in (StopCode.FORWARD, StopCode.REVERSE)
            self._towards(0.0, seconds, self.settings.SD if limited else self.settings.DC)
        elif self.mode is MoveMode.JOG:
            self._towards(self.settings.JG, seconds, self.settings.DC)
        else:
            self._approach(seconds)

    def _towards(self, wanted: float, seconds: float, deceleration: float) -> None:
        """Nearer to a speed: slower by the deceleration, and once it stands, faster by AC."""
        faster = self.speed * wanted >= 0.0 and abs(wanted) > abs(self.speed)
        most = (self.settings.AC if faster else deceleration) * seconds
        through = self.speed * wanted < 0.0
        aim = 0.0 if through else wanted
        self.speed += min(max(aim - self.speed, -most), most)

    def _approach(self, seconds: float) -> None:
        """Along a positioning move, slow enough to end where it was to."""
        left = self.end - self.reference
        slow = math.sqrt(2.0 * self.settings.DC * abs(left))
        wanted = math.copysign(min(self.settings.SP, slow), left)
        self._towards(wanted, seconds, self.settings.DC)
        if abs(left) <= max(abs(self.speed) * seconds, 0.5):
            self.reference, self.speed = self.end, 0.0
            self.moving, self.stop_code = False, StopCode.DONE
