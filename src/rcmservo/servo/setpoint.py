"""Target and operator's request at a tick, as compiled functions read them."""

from typing import Annotated, NamedTuple

from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import put
from rcmservo.numerics.structs import Struct


class Setpoint(NamedTuple):
    """Target and operator's request at a tick.

    Parameters
    ----------
    points : Floats
        The target's markers (2, 2) raw px.
    q : Floats
        The joints (3,) while it was taught.
    shown : int
        When it was taught, ns.
    is_new : bool
        Whether it is another target than at the last tick.
    request : int
        Code of the operator's request: its position in Request.
    jog : Floats
        Requested joint rates (3,) rad/s, rad/s, mm/s where that is JOG.
    """

    points: Annotated[Floats, (2, 2)]
    q: Annotated[Floats, (3,)]
    shown: int
    is_new: bool
    request: int
    jog: Annotated[Floats, (3,)]


class SetpointRow(Struct, source=Setpoint):
    """Setpoint in the state. A row is passed on without counting who refers to it."""


@compiled
def store_setpoint(row: SetpointRow, given: Setpoint) -> None:
    """Copy the setpoint into a row."""
    row.shown, row.is_new, row.request = given.shown, given.is_new, given.request
    put(row.points, given.points)
    put(row.q, given.q)
    put(row.jog, given.jog)
