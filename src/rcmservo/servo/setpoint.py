"""Target and operator's request at a tick, as compiled functions read them."""

from typing import Annotated, NamedTuple

from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import copy_into
from rcmservo.numerics.structs import Struct


class Setpoint(NamedTuple):
    """Target and operator's request at a tick.

    Parameters
    ----------
    points : Floats
        Raw markers (2, 2) of the target in px.
    q : Floats
        Joint values (3,) in rad, rad, mm during teaching.
    taught_at : int
        Time of teaching, ns.
    is_new : bool
        True if the target differs from that of the last tick.
    request : int
        Code of the operator's request: its position in `Request`.
    jog : Floats
        Requested joint rates (3,) in rad/s, rad/s, mm/s if the request is JOG.
    """

    points: Annotated[Floats, (2, 2)]
    q: Annotated[Floats, (3,)]
    taught_at: int
    is_new: bool
    request: int
    jog: Annotated[Floats, (3,)]


class SetpointRow(Struct, source=Setpoint):
    """Setpoint in the state; a row passes to a compiled function without reference counting."""


@compiled
def store_setpoint(row: SetpointRow, setpoint: Setpoint) -> None:
    """Copy a setpoint into the row of the state."""
    row.taught_at, row.is_new, row.request = setpoint.taught_at, setpoint.is_new, setpoint.request
    copy_into(row.points, setpoint.points)
    copy_into(row.q, setpoint.q)
    copy_into(row.jog, setpoint.jog)
