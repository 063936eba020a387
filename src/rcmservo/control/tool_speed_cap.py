"""Speed cap of the tool: while servoing, neither marker nor the tip exceeds `max_speed` (mm/s).

`max_speed` is a setting of `SaturatedController`. Exploration and jogging do not use this cap: the
gate limits their joint rates.
"""

from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.geometry.kinematics import Point
from rcmservo.geometry.tool import ToolStruct, compute_max_tool_speed
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled


@compiled
def cap_tool_speed(
    capped: Floats, v: Point, tool: ToolStruct, p1: Point, controller: SaturatedController
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
    controller : SaturatedController
        Controller, of which `tip` (mm) and `max_speed` (mm/s) are used.
    """
    speed = compute_max_tool_speed(tool, p1, v, controller.tip)
    slowdown = max(1.0, speed / controller.max_speed)
    for k in range(3):
        capped[k] = v[k] / slowdown
