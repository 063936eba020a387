"""Safety gate: bounds on the joint rates before they become a command.

The gate receives joint rates from the control law or the exploration. It returns finite rates
within the limits of speed, slew (change of a rate per time) and joint range. Only the gate makes a
`Command`, and the arm accepts nothing else. Every comparison is written so that NaN fails it.

At the distance x from a joint limit, the speed v of the joint satisfies v²/a + v T <= x. Half of
the slew limit a stops the joint in time. T = e · latency + dt is the time that a loop with this
latency needs to approach the limit without passing it.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np

from rcmservo.constraints import (
    Checked,
    Triple,
    angles,
    between,
    not_negative,
    positive,
    three_positive,
)
from rcmservo.geometry.kinematics import RcmStruct
from rcmservo.interfaces import NEVER_NS, Command, Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, fill
from rcmservo.numerics.structs import Rows, Struct, to_row

ROUNDING = 1.0 + 1e-12
"""Factor on the slew limit: without it, rounding would leave a rate of nearly zero."""

MAX_JOINT_SPEED_RAD_S = 4.0 * np.pi
"""Largest valid speed of a rotary joint, two turns per second.

No RCM mechanism turns as fast: a larger value was given in degrees."""


class GateResult(NamedTuple):
    """Result of the gate.

    Parameters
    ----------
    command : Command
        Command for the arm.
    finite : bool
        False if an input was not finite or no time had passed; the rates are zero then.
    """

    command: Command
    finite: bool


@dataclass(frozen=True)
class Gate(Checked, section="gate"):
    """Bounds on every command: speed, slew (change of a rate per time) and joint range.

    The rates keep each joint within its range: towards a joint limit at the distance x, the speed v
    satisfies v²/slew + v (e · latency + dt) <= x, where e = 2.718 is Euler's number and dt (s) is
    the time since the last command, at most `max_period`. The signature states the range and the
    default of each bound. An instance is passed as the argument `gate` of `Servo`.

    Parameters
    ----------
    speed : Triple
        Largest rate of each joint, rad/s, rad/s, mm/s; positive, at most 4π rad/s.
    slew : Triple
        Largest change of each joint's rate per time, rad/s², rad/s², mm/s²; positive.
    latency : float
        Time for which the arm may continue at its last speed before a command takes effect, s; not
        negative.
    max_period : float
        Longest time for which the slew limit lets one command change the rates, s; positive. A late
        tick must not cause a jump.
    deadline : float
        Time after its tick at which a command expires, s; 0.01 to 0.05.

    Raises
    ------
    BadInput
        If a bound is outside its range.

    Notes
    -----
    The inequality adds two distances. Braking from v with half of the slew limit takes v²/slew. The
    other one is v (e · latency + dt): a loop ẋ(t) = −c x(t − latency) approaches x = 0 without
    passing it only for a gain c up to 1/(e · latency), that is for a speed v up to
    x/(e · latency); dt accounts for the time between two commands. The rule is this project's own.
    """

    name = "gate"

    speed: Annotated[
        Triple,
        three_positive("rad/s, rad/s, mm/s"),
        angles(MAX_JOINT_SPEED_RAD_S, first=2, unit="rad/s"),
    ] = (1.0, 1.0, 80.0)
    slew: Annotated[Triple, three_positive("rad/s², rad/s², mm/s²")] = (10.0, 10.0, 800.0)
    latency: Annotated[float, not_negative("time in s")] = 0.05
    max_period: Annotated[float, positive("time in s")] = 0.02
    deadline: Annotated[float, between(0.01, 0.05, "a time", "s")] = 0.05

    @cached_property
    def struct_row(self) -> "Rows[Gate]":
        """Bounds as a row for compiled functions."""
        return to_row(self)

    def rest(self) -> Command:
        """Return the command before the first: zero rates, drive off."""
        return Command(0, NEVER_NS, NEVER_NS, np.zeros(3), enabled=False)

    def admit(
        self,
        rates: Floats,
        last: Command,
        q: Floats,
        rcm: RcmStruct,
        now: int,
        speed_scale: float = 1.0,
    ) -> GateResult:
        """Turn requested joint rates into the next command.

        All rates are reduced by the same factor to the speed limit, so that the direction of the
        motion stays. Then each rate is bounded for its joint limit and for the slew limit.

        Parameters
        ----------
        rates : Floats
            Requested joint rates, (3,) rad/s, rad/s, mm/s; any value, also NaN.
        last : Command
            Last command; `rest` gives the one before the first.
        q : Floats
            Measured joints, (3,) rad, rad, mm.
        rcm : RcmStruct
            Mechanism with its joint limits: ``servo.rcm``, or
            ``mechanism.to_struct(tool.offset)``.
        now : int
            Time of the tick, ns.
        speed_scale : float
            Fraction of the full speed that is permitted, 0 to 1. At 0 the rates go to zero as fast
            as the slew limit allows.

        Returns
        -------
        GateResult
            Named tuple of `command`, the `Command` for the arm, and `finite`. The latter is False,
            and the rates are zero, if an input was not finite or no time had passed.
        """
        command = CommandStruct.from_source(last)
        row, gate = command.rows[0], self.struct_row[0]
        is_finite = make_command(row, rates, q, rcm, now, float(speed_scale), gate)
        return GateResult(to_command(command), is_finite)

    def stop(self, last: Command, now: int) -> Command:
        """Return the next command with zero rates and the drive off; ``now`` in ns."""
        command = CommandStruct.from_source(last)
        make_stop_command(command.rows[0], now, self.struct_row[0])
        return to_command(command)


class CommandStruct(Struct, source=Command):
    """Last command, as a row for compiled functions."""


def to_command(last: CommandStruct) -> Command:
    """Return the last command as a `Command`, as devices receive it."""
    return Command(**last.values())


@compiled
def make_command(
    last: CommandStruct,
    rates: Floats,
    q: Floats,
    rcm: RcmStruct,
    now: int,
    speed_scale: float,
    gate: "Gate",
) -> bool:
    """Turn requested joint rates into the next command.

    Parameters
    ----------
    last : CommandStruct
        Last command; overwritten by the next one.
    rates : Floats
        Requested joint rates, (3,) rad/s, rad/s, mm/s.
    q : Floats
        Measured joints, (3,) rad, rad, mm.
    rcm : RcmStruct
        Mechanism with its joint limits.
    now : int
        Time of the tick, ns.
    speed_scale : float
        Fraction of the full speed that is permitted. At 0 the rates go to zero as fast as the slew
        limit allows.
    gate : Gate
        Bounds.

    Returns
    -------
    bool
        False if an input was not finite or no time had passed; the rates are zero then.
    """
    dt = min((now - last.time) * 1e-9, gate.max_period)
    finite = limit_rates(rates, last.rates, q, rcm, gate, dt, speed_scale)
    stamp_command(last, True, now, gate)
    return finite


@compiled
def make_stop_command(last: CommandStruct, now: int, gate: "Gate") -> None:
    """Make the next command one with zero rates and the drive off."""
    fill(last.rates, 0.0)
    stamp_command(last, False, now, gate)


@compiled
def stamp_command(last: CommandStruct, enabled: bool, now: int, gate: "Gate") -> None:
    """Set number, time and deadline of the next command."""
    last.number, last.time, last.enabled = last.number + 1, now, enabled
    last.deadline = now + int(np.round(gate.deadline * 1e9))


@compiled
def limit_rates(
    rates: Floats,
    last_rates: Floats,
    q: Floats,
    rcm: RcmStruct,
    gate: "Gate",
    dt: float,
    speed_scale: float,
) -> bool:
    """Bound joint rates by the limits of speed, slew and joint range.

    Parameters
    ----------
    rates : Floats
        Requested joint rates, (3,) rad/s, rad/s, mm/s.
    last_rates : Floats
        Joint rates of the last command, (3,); overwritten by the bounded rates.
    q : Floats
        Measured joints, (3,) rad, rad, mm.
    rcm : RcmStruct
        Mechanism with its joint limits.
    gate : Gate
        Bounds.
    dt : float
        Time since the last command, s.
    speed_scale : float
        Fraction of the full speed that is permitted.

    Returns
    -------
    bool
        False if an input was not finite or no time had passed; the rates are zero then.
    """
    if not (all_finite(rates) and all_finite(q) and all_finite(last_rates) and dt > 0.0):
        fill(last_rates, 0.0)
        return False
    reduction = 1.0
    if speed_scale > 0.0:
        for i in range(3):
            reduction = max(reduction, abs(rates[i]) / (speed_scale * gate.speed[i]))
    for i in range(3):
        allowed = rates[i] / reduction if speed_scale > 0.0 else 0.0
        slew = gate.slew[i]
        # the roots of v²/a + v T = x are ±(√((a T / 2)² + a x) − a T / 2), with the slew a
        half = 0.5 * slew * (np.e * gate.latency + dt)
        max_rate = np.sqrt(half**2 + slew * max(rcm.upper[i] - q[i], 0.0)) - half
        min_rate = half - np.sqrt(half**2 + slew * max(q[i] - rcm.lower[i], 0.0))
        allowed = min(max(allowed, min_rate), max_rate)
        step = slew * dt * ROUNDING
        last_rates[i] = min(max(allowed, last_rates[i] - step), last_rates[i] + step)
    return True
