"""Equations of motion of the simulated arm, as the physics simulator MuJoCo solves them.

The arm has two hinges and a slide along the tool. The axes of the hinges intersect at right angles
in the RCM (remote centre of motion), the fixed point that the tool passes through.
The tool is a rod of mass m whose centre is z from the RCM. With the angle α between the axis of the
outer hinge and the tool, the mass matrix is diagonal:

    M_outer = fixed + (rod + m z²) sin²α,    M_inner = fixed + m z²,    M_slide = fixed

A velocity drive of gain k accelerates its joint from the rate v to the rate u. The Coriolis and
centrifugal terms c follow from Lagrange's equations. One step h of MuJoCo's integrator
"implicitfast" is

    v ← v + h (k (u − v) − c) / (M + h k)

Angles are in rad and lengths in mm. For the slide, masses and gains are therefore 1e-6 of their
values in SI units.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from rcmservo.geometry.kinematics import SPHERICAL, Kinematics, Point
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.structs import Row, real, reals, whole
from rcmservo.sim.arm import MJCF_AXES, MUJOCO_UNITS, UNTYPED_MUJOCO, write_mjcf


class InertiaStruct(Row):
    """Masses and drive gains of an arm."""

    outer_joint: int = whole("", "index of the hinge that carries the other one: 0 or 1")
    cosine_sign: float = real("", "1 if the inner angle is zero on the outer axis, -1 if across it")
    fixed: Floats = reals(3, "kg m², kg m², 1e-6 kg", "part of each joint's inertia in any pose")
    rod: float = real("kg m²", "moment of the tool across its axis minus that along its axis")
    mass: float = real("1e-6 kg", "mass of the tool")
    drive_gain: Floats = reals(3, "N m s, N m s, 1e-6 N s/m", "velocity gain of each joint's drive")


@cache
def compute_inertia(mechanism: Kinematics) -> InertiaStruct:
    """Return the masses and drive gains of the simulated arm of a mechanism."""
    model = UNTYPED_MUJOCO.MjModel.from_xml_string(write_mjcf(mechanism))
    units = np.square(MUJOCO_UNITS)
    (first_link, second_link, tool), mass = model.body_inertia[1:], model.body_mass[3]
    joint_order, fixed, gain = list(MJCF_AXES[mechanism.name][3]), np.empty(3), np.empty(3)
    moved_inertia = first_link[0] + second_link[0] + tool[2], second_link[0] + tool[0], mass
    fixed[joint_order] = model.dof_armature + moved_inertia
    gain[joint_order] = model.actuator_gainprm[:, 0]
    return InertiaStruct.of(
        outer_joint=joint_order[0],
        cosine_sign=1.0 if mechanism.kind == SPHERICAL else -1.0,
        fixed=fixed * units,
        rod=tool[0] - tool[2],
        mass=mass * units[2],
        drive_gain=gain * units,
    )


class LinearisedDynamics(NamedTuple):
    """Equations of motion about a configuration, linear in the slide and the inner hinge.

    They hold for the few ms that the arm spends near the configuration. The linearisation error is
    about a millionth. Triples are in the order outer hinge, inner hinge, slide.

    Parameters
    ----------
    z : float
        Slide of the configuration, mm.
    angle : float
        Angle of the inner hinge of the configuration, rad.
    gain : Point
        h/(M + h k) of each joint.
    gain_z : tuple[float, float]
        Derivative of the gains of both hinges with respect to the slide, 1/mm.
    gain_angle : float
        Derivative of the gain of the outer hinge with respect to the inner angle, 1/rad.
    c : Point
        Coefficients a, b, e of the Coriolis and centrifugal terms: of the outer hinge
        2 v_outer (a v_inner + b v_slide), of the inner hinge 2 e v_slide v_inner - a v_outer², of
        the slide -(b v_outer² + e v_inner²).
    c_z : Point
        Derivatives of a, b, e with respect to the slide, 1/mm.
    c_angle : tuple[float, float]
        Derivatives of a and b with respect to the inner angle, 1/rad.
    """

    z: float
    angle: float
    gain: Point
    gain_z: tuple[float, float]
    gain_angle: float
    c: Point
    c_z: Point
    c_angle: tuple[float, float]


@compiled
def linearise_dynamics(arm: InertiaStruct, z: float, angle: float, h: float) -> LinearisedDynamics:
    """Return the equations about slide `z` (mm) and inner `angle` (rad) for steps of `h` s.

    The symbols are those of the module: o is the outer hinge, k the gains of the drives, m the mass
    of the tool. The derivative of sin²α with respect to the inner angle is ± sin 2α.
    """
    o, k, m = arm.outer_joint, arm.drive_gain, arm.mass
    cos_2_alpha = arm.cosine_sign * np.cos(2.0 * angle)
    squared_sine = 0.5 * (1.0 - cos_2_alpha)
    squared_sine_slope = arm.cosine_sign * np.sin(2.0 * angle)
    offset_moment, moment_slope = m * z * z, 2.0 * m * z
    tool_moment = arm.rod + offset_moment
    outer_gain = h / (arm.fixed[o] + tool_moment * squared_sine + h * k[o])
    inner_gain = h / (arm.fixed[1 - o] + offset_moment + h * k[1 - o])
    return LinearisedDynamics(
        z,
        angle,
        (outer_gain, inner_gain, h / (arm.fixed[2] + h * k[2])),
        (
            -outer_gain * outer_gain * moment_slope * squared_sine / h,
            -inner_gain * inner_gain * moment_slope / h,
        ),
        -outer_gain * outer_gain * tool_moment * squared_sine_slope / h,
        (0.5 * tool_moment * squared_sine_slope, m * z * squared_sine, m * z),
        (0.5 * moment_slope * squared_sine_slope, m * squared_sine, m),
        (tool_moment * cos_2_alpha, m * z * squared_sine_slope),
    )
