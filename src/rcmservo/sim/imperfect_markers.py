"""Places and images of the markers on an imperfect arm, for Python and for compiled functions.

The two hinge axes pass each other, the insertion axis misses the RCM, the markers are off the
tool's axis, the shaft bends and the port moves. The tool's lateral axes a and b are orthogonal to
its direction n: a is the direction in which an ideal tool moves about its inner hinge.
"""

import numpy as np

from rcmservo.geometry.kinematics import (
    SPHERICAL,
    Point,
    RcmStruct,
    compute_axis_tuple,
    compute_position_tuple,
)
from rcmservo.geometry.tool import ToolStruct, compute_second_marker_tuple
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.structs import Row, flag, real, reals, whole

BEND_INTERVAL_NS = 2_000_000
"""Time (ns) over which the speed that bends the shaft is measured."""

PORT_PERIOD_S, FOCUS_PERIOD_S = 4.0, 7.0
"""Periods (s) of the motion of the port and of the focal length."""


class ImperfectionsStruct(Row):
    """Imperfections of one arm, tool and camera."""

    is_any: bool = flag("one of them is not zero")
    axis_distance: float = real("mm", "distance between the hinge axes, with its sign")
    shaft_offset: Floats = reals(2, "mm", "insertion axis along a and b from the RCM")
    marker_offsets: Floats = reals((2, 2), "mm", "each marker along a and b, without roll")
    roll: float = real("rad/rad", "rotation about the tool's axis per rotation of joint 1")
    spacing_ratio: float = real("", "distance between the markers divided by the nominal one")
    insertion_error: float = real("mm", "actual minus reported insertion")
    half_gap: Floats = reals(3, "rad, rad, mm", "half of the backlash")
    start_in_gap: Floats = reals(3, "", "place of the tool in the gap at the start, -1 to 1")
    target_in_gap: Floats = reals(3, "", "the same while the target is taught")
    friction_bend: float = real("s", "deflection against a lateral motion, per speed")
    tissue_bend: float = real("", "fraction by which tissue bends the tool back")
    tissue_side: Floats = reals(3, "", "direction into the tissue")
    port: Floats = reals(3, "mm", "amplitude of the RCM's motion")
    port_phase: float = real("rad", "phase of this motion")
    rate_ratios: Floats = reals(3, "", "actual rate of a joint divided by the commanded one")
    report_period: int = whole("ns", "time for which reported joints are repeated")
    stamp_error: int = whole("ns", "reported minus true exposure time")
    read_out: float = real("s", "from the exposure of the first row to that of the last")
    focus: float = real("", "amplitude of the relative change of the focal length")
    focus_phase: float = real("rad", "phase of this change")


NO_IMPERFECTIONS = ImperfectionsStruct.of(rate_ratios=1.0, spacing_ratio=1.0)
"""An ideal arm."""


@compiled
def compute_lateral_axes(rcm: RcmStruct, q: Floats) -> tuple[Point, Point, Point]:
    """Return a, b and the direction in which the inner hinge axis passes the outer one."""
    s1, c1, s2, c2 = np.sin(q[0]), np.cos(q[0]), np.sin(q[1]), np.cos(q[1])
    if rcm.kind == SPHERICAL:
        return (c1 * c2, c1 * s2, -s1), (-s2, c2, 0.0), (c2, s2, 0.0)
    return (-s2 * s1, -c2, s2 * c1), (c1, 0.0, s1), (-s1, 0.0, c1)


@compiled
def move_across(
    errors: ImperfectionsStruct, rcm: RcmStruct, q: Floats, p: Point, offset: Floats, roll: float
) -> Point:
    """Return a point p of an ideal arm, moved by the axes' distance and by `offset` (2,) mm."""
    a, b, passing = compute_lateral_axes(rcm, q)
    cosine, sine, distance = np.cos(roll), np.sin(roll), errors.axis_distance
    along_a = cosine * offset[0] - sine * offset[1]
    along_b = sine * offset[0] + cosine * offset[1]
    return (
        p[0] + distance * passing[0] + along_a * a[0] + along_b * b[0],
        p[1] + distance * passing[1] + along_a * a[1] + along_b * b[1],
        p[2] + distance * passing[2] + along_a * a[2] + along_b * b[2],
    )


@compiled
def place_on_axis(
    errors: ImperfectionsStruct, rcm: RcmStruct, tool: ToolStruct, q: Floats, p1: Point, k: int
) -> Point:
    """Return marker k on the axis of the tool, mm, with the errors of insertion and spacing.

    p1 mm is marker 1 without them.
    """
    n, more_mm, p2 = compute_axis_tuple(rcm, q), errors.insertion_error, p1
    if k == 1:
        p2, ratio = compute_second_marker_tuple(tool, p1), errors.spacing_ratio
        p2 = (
            p1[0] + ratio * (p2[0] - p1[0]),
            p1[1] + ratio * (p2[1] - p1[1]),
            p1[2] + ratio * (p2[2] - p1[2]),
        )
    return p2[0] + more_mm * n[0], p2[1] + more_mm * n[1], p2[2] + more_mm * n[2]


@compiled
def bend_by_tissue(errors: ImperfectionsStruct, rcm: RcmStruct, q: Floats, p: Point) -> Point:
    """Return a point p mm of a tool that tissue on one side of the workspace's middle bends back.

    The deflection across the shaft is the fraction `tissue_bend` of the point's depth in it.
    """
    lower, upper, t, n = rcm.lower, rcm.upper, errors.tissue_side, compute_axis_tuple(rcm, q)
    middle = (
        0.5 * (lower[0] + upper[0]),
        0.5 * (lower[1] + upper[1]),
        0.5 * (lower[2] + upper[2]),
    )
    p_0 = compute_position_tuple(rcm, middle)
    depth = t[0] * (p[0] - p_0[0]) + t[1] * (p[1] - p_0[1]) + t[2] * (p[2] - p_0[2])
    along, bend = t[0] * n[0] + t[1] * n[1] + t[2] * n[2], errors.tissue_bend * max(depth, 0.0)
    return (
        p[0] - bend * (t[0] - along * n[0]),
        p[1] - bend * (t[1] - along * n[1]),
        p[2] - bend * (t[2] - along * n[2]),
    )


@compiled
def place_resting_marker(
    errors: ImperfectionsStruct, rcm: RcmStruct, tool: ToolStruct, q: Floats, k: int
) -> Point:
    """Return marker k on a shaft that is straight, with the port in its middle, mm."""
    p = compute_position_tuple(rcm, q)
    if not errors.is_any:
        return compute_second_marker_tuple(tool, p) if k == 1 else p
    p = place_on_axis(errors, rcm, tool, q, p, k)
    p = move_across(errors, rcm, q, p, errors.marker_offsets[k], errors.roll * q[0])
    return bend_by_tissue(errors, rcm, q, p)


@compiled
def place_marker(
    errors: ImperfectionsStruct,
    rcm: RcmStruct,
    tool: ToolStruct,
    q: Floats,
    q_before: Floats,
    time: int,
    k: int,
) -> Point:
    """Return the position of marker k at `time` ns, mm from the middle of the port.

    The joints are q (3,) then, and were `q_before` (3,) BEND_INTERVAL_NS earlier.
    """
    p = place_resting_marker(errors, rcm, tool, q, k)
    if not errors.is_any:
        return p
    before, n = place_resting_marker(errors, rcm, tool, q_before, k), compute_axis_tuple(rcm, q)
    dx, dy, dz = p[0] - before[0], p[1] - before[1], p[2] - before[2]
    along = dx * n[0] + dy * n[1] + dz * n[2]
    bend = errors.friction_bend / (BEND_INTERVAL_NS * 1e-9)
    breath = np.sin(2.0 * np.pi * time * 1e-9 / PORT_PERIOD_S + errors.port_phase)
    return (
        p[0] - bend * (dx - along * n[0]) + breath * errors.port[0],
        p[1] - bend * (dy - along * n[1]) + breath * errors.port[1],
        p[2] - bend * (dz - along * n[2]) + breath * errors.port[2],
    )


@compiled
def compute_focus(errors: ImperfectionsStruct, time: int) -> float:
    """Return the focal length at `time` ns, divided by its mean."""
    return 1.0 + errors.focus * np.sin(
        2.0 * np.pi * time * 1e-9 / FOCUS_PERIOD_S + errors.focus_phase
    )


@compiled
def compute_row_delay(errors: ImperfectionsStruct, row: float, height: int) -> int:
    """Return the time (ns) from the middle of an exposure to that of a row of the image."""
    if not 0.0 <= row <= height:
        return 0
    return int(np.round(errors.read_out * (row / height - 0.5) * 1e9))


@compiled
def follow_with_backlash(errors: ImperfectionsStruct, motors: Floats, joints: Floats) -> None:
    """Move the `joints` (3,) of the tool as far as the gaps make them follow the `motors` (3,)."""
    for i in range(3):
        half = errors.half_gap[i]
        joints[i] = min(max(joints[i], motors[i] - half), motors[i] + half)
