"""Speed cap of the tool: neither marker nor the tip exceeds a speed (mm/s).

It is `max_speed` of `SaturatedController` while exploring and servoing, but less towards a target
without joints. Jogging does not use this cap: the gate limits its joint rates.
"""

from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.geometry.kinematics import (
    Point,
    RcmStruct,
    compute_position_jacobian,
    compute_position_tuple,
)
from rcmservo.geometry.tool import ToolStruct, compute_max_tool_speed
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import multiply_vector

UNCHECKED_TARGET_SPEED = 8.0
"""Speed cap towards a target that no joints confirm, mm/s.

The tool moves by 2.7 mm in the time in which ten frames at 30 Hz confirm the motion.
"""


@compiled
def choose_speed_cap(controller: SaturatedController, target_is_unchecked: bool) -> float:
    """Return the speed (mm/s) that neither marker nor the tip may exceed."""
    if target_is_unchecked:
        return min(controller.max_speed, UNCHECKED_TARGET_SPEED)
    return controller.max_speed


@compiled
def cap_tool_speed(
    capped: Floats, v: Point, tool: ToolStruct, p1: Point, tip: float, max_speed: float
) -> None:
    """Write v mm/s of marker 1 at p1 mm, slowed until the fastest point of the tool keeps the cap.

    Parameters
    ----------
    capped : Floats
        Velocity (3,) mm/s that receives the result.
    v : Point
        Velocity of marker 1 that the controller requests, mm/s.
    tool : ToolStruct
        Tool with both markers.
    p1 : Point
        Position of marker 1, mm.
    tip : float
        Distance from marker 2 to the tip, mm.
    max_speed : float
        Speed cap, mm/s.
    """
    slowdown = max(1.0, compute_max_tool_speed(tool, p1, v, tip) / max_speed)
    for k in range(3):
        capped[k] = v[k] / slowdown


@compiled
def cap_joint_rates(
    capped: Floats,
    rates: Floats,
    rcm: RcmStruct,
    tool: ToolStruct,
    q: Floats,
    tip: float,
    max_speed: float,
) -> None:
    """Write joint rates, slowed until the fastest point of the tool keeps the cap.

    Parameters
    ----------
    capped : Floats
        Joint rates (3,) that receive the result, rad/s, rad/s, mm/s.
    rates : Floats
        Requested joint rates (3,).
    rcm : RcmStruct
        Mechanism, with marker 1 as the point on its tool.
    tool : ToolStruct
        Tool with both markers.
    q : Floats
        Joints (3,).
    tip : float
        Distance from marker 2 to the tip, mm.
    max_speed : float
        Speed cap, mm/s.
    """
    p1, v = (
        compute_position_tuple(rcm, q),
        multiply_vector(compute_position_jacobian(rcm, q), rates),
    )
    slowdown = max(1.0, compute_max_tool_speed(tool, p1, v, tip) / max_speed)
    for i in range(3):
        capped[i] = rates[i] / slowdown
