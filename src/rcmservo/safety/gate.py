"""The last gate before anything moves: finite, within speed, inside the joint limits, and never a
jump.

Joint rates come in from the law or from exploration; only what leaves here is a Command, and a
plant takes nothing else. Every check is written so that NaN fails it.

Towards a limit at the distance x a joint's speed v keeps v²/a + v T <= x: half of its slew limit a
stops it in time, and T = e · latency + dt is what a loop with that latency needs to close in on the
limit without passing it.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, NamedTuple, cast

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
from rcmservo.geometry.kinematics import Rcm
from rcmservo.interfaces import Command, Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, fill
from rcmservo.numerics.structs import Rows, Struct, as_row

ROUNDING = 1.0 + 1e-12
"""A rate that the slew brings to zero but for rounding is brought to zero."""

FASTEST_TURN = 4.0 * np.pi
"""rad/s. No arm of this kind turns twice in a second: a larger bound was given in degrees."""


@compiled
def within(
    rates: Floats,
    last: Floats,
    q: Floats,
    rcm: Rcm,
    gate: "Gate",
    dt: float,
    share: float,
) -> bool:
    """Write the joint rates (3,) that may be sent over the `last` ones; whether all that came in
    was finite and time had passed.
    """
    if not (all_finite(rates) and all_finite(q) and all_finite(last) and dt > 0.0):
        fill(last, 0.0)
        return False
    slower = 1.0
    if share > 0.0:
        for i in range(3):
            slower = max(slower, abs(rates[i]) / (share * gate.speed[i]))
    for i in range(3):
        allowed = rates[i] / slower if share > 0.0 else 0.0
        slew = gate.slew[i]
        half = 0.5 * slew * (np.e * gate.latency + dt)
        up = np.sqrt(half**2 + slew * max(rcm.upper[i] - q[i], 0.0)) - half
        down = half - np.sqrt(half**2 + slew * max(q[i] - rcm.lower[i], 0.0))
        allowed = min(max(allowed, down), up)
        step = slew * dt * ROUNDING
        last[i] = min(max(allowed, last[i] - step), last[i] + step)
    return True


class CommandStruct(Struct, source=Command):
    """The last command in compiled functions."""


def command_of(last: CommandStruct) -> Command:
    """The last command as devices take it."""
    return Command(**last.values())


@compiled
def issue(last: CommandStruct, enabled: bool, now: int, gate: "Gate") -> None:
    """Number and times of the next command."""
    last.number, last.time, last.enabled = last.number + 1, now, enabled
    last.deadline = now + int(np.round(gate.deadline * 1e9))


@compiled
def admit(
    last: CommandStruct,
    rates: Floats,
    q: Floats,
    rcm: Rcm,
    now: int,
    share: float,
    gate: "Gate",
) -> bool:
    """Make the wanted joint rates (3,) a command, from the last one and the measured q (3,).

    ``share`` of the full speed may be used; at 0 the rates go to zero as fast as the slew allows.
    False where something that came in was not finite or no time had passed: then it is zero.
    """
    dt = min((now - last.time) * 1e-9, gate.max_period)
    finite = within(rates, last.rates, q, rcm, gate, dt, share)
    issue(last, True, now, gate)
    return finite


@compiled
def stop(last: CommandStruct, now: int, gate: "Gate") -> None:
    """Zero at once, with the drive off."""
    fill(last.rates, 0.0)
    issue(last, False, now, gate)


class Passed(NamedTuple):
    """What the gate let through.

    Parameters
    ----------
    command : Command
        What the arm may be sent.
    finite : bool
        Whether all numbers that came in were finite and time had passed. If not, the command is
        zero at once.
    """

    command: Command
    finite: bool


@dataclass(frozen=True)
class Gate(Checked, section="gate"):
    """Bounds on every command.

    Parameters
    ----------
    speed : Triple
        Bound on each joint's rate, rad/s, rad/s, mm/s.
    slew : Triple
        Bound on its change, rad/s², rad/s², mm/s².
    latency : float
        How long the arm may go on at its last speed before a command takes hold, s.
    max_period : float
        Longest time over which one command may change, s: a late tick must not allow a jump.
    deadline : float
        Time after its tick from which on a command is void, s.
    """

    name = "gate"

    speed: Annotated[
        Triple, three_positive("rad/s, rad/s, mm/s"), angles(FASTEST_TURN, first=2, unit="rad/s")
    ] = (1.0, 1.0, 80.0)
    slew: Annotated[Triple, three_positive("rad/s², rad/s², mm/s²")] = (10.0, 10.0, 800.0)
    latency: Annotated[float, not_negative("time in s")] = 0.05
    max_period: Annotated[float, positive("time in s")] = 0.02
    deadline: Annotated[float, between(0.01, 0.05, "a time", "s")] = 0.05

    @cached_property
    def row(self) -> "Rows[Gate]":
        """The bounds for compiled functions."""
        return as_row(self)

    def rest(self) -> Command:
        """The command before the first: stand still, drive off."""
        return Command(
            number=0, time=-1_000_000_000, deadline=-1_000_000_000, rates=np.zeros(3), enabled=False
        )

    def admit(
        self,
        rates: Floats,
        last: Command,
        q: Floats,
        rcm: Rcm,
        now: int,
        share: float = 1.0,
    ) -> Passed:
        """`admit`, from a Command to a Command."""
        row = CommandStruct.from_source(last)
        finite = admit(cast(Any, row.rows)[0], rates, q, rcm, now, float(share), self.row[0])
        return Passed(command_of(row), finite)

    def stop(self, last: Command, now: int) -> Command:
        """Zero at once, with the drive off."""
        row = CommandStruct.from_source(last)
        stop(cast(Any, row.rows)[0], now, self.row[0])
        return command_of(row)
