"""Equations of motion of the simulated arm, as the physics simulator MuJoCo solves them.

The compiled plant of a study integrates them (plant_kernel.py), instead of MuJoCo.

The arm has two hinges and a slide along the tool. The axes of the hinges intersect at right angles
in the RCM (remote centre of motion), the fixed point that the tool passes through. The tool is a
rod of mass m whose centre is at the distance z from the RCM along the rod; z is the joint value of
the slide. With the angle α between the axis of the outer hinge and the tool, the mass matrix is
diagonal:

    M_outer = I_outer + (ΔI + m z²) sin²α
    M_inner = I_inner + m z²
    M_slide = m_slide

I_outer, I_inner and m_slide collect the contributions of links, tool and motors that do not depend
on the pose; q_inner below is the angle of the inner hinge.
ΔI is the moment of inertia of the tool across its axis minus that along its axis, both about the
tool's centre.

The velocity drive of a joint exerts the torque or force k (r − v), where k is its gain, r the rate
that it regulates to and v the rate of the joint. The Coriolis and centrifugal terms c follow from
Lagrange's equations. One step of length h of MuJoCo's integrator "implicitfast" is, for each joint,

    v ← v + h/(M + h k) (k (r − v) − c)

The rates are in rad/s and mm/s. In these units the masses are in kg m²/mm² and the gain of the
slide's drive is in N m s/mm²: both are 1e-6 of their values in kg and N s/m.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from rcmservo.constraints import Triple
from rcmservo.geometry.kinematics import SPHERICAL, Kinematics
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.structs import Row, real, reals, whole
from rcmservo.sim.arm import MJCF_AXES, MUJOCO_UNITS, UNTYPED_MUJOCO, write_mjcf


class InertiaStruct(Row):
    """Inertias and drive gains of an arm; the arrays are in the order of the joints in q."""

    outer_joint: int = whole("", "index of the hinge that carries the other one: 0 or 1")
    cosine_sign: float = real(
        "",
        "cos 2α / cos 2 q_inner: 1 if the tool lies along the outer axis at q_inner = 0, "
        "-1 if it is perpendicular to it there",
    )
    constant_inertia: Floats = reals(
        3, "kg m², kg m², kg m²/mm²", "I_outer, I_inner and m_slide: the same in any pose"
    )
    rod_inertia_difference: float = real(
        "kg m²", "ΔI: the tool's moment of inertia across its axis minus that along its axis"
    )
    mass: float = real("kg m²/mm²", "mass m of the tool")
    drive_gain: Floats = reals(3, "N m s, N m s, N m s/mm²", "gain k of each joint's drive")


@cache
def compute_inertia(mechanism: Kinematics) -> InertiaStruct:
    """Return the inertias and drive gains that MuJoCo has for the simulated arm of a mechanism."""
    model = UNTYPED_MUJOCO.MjModel.from_xml_string(write_mjcf(mechanism))
    unit_factors = np.square(MUJOCO_UNITS)
    first_link_inertia, second_link_inertia, tool_inertia = model.body_inertia[1:]
    tool_mass = model.body_mass[3]
    joint_order = list(MJCF_AXES[mechanism.name][3])
    moved_inertia = (
        first_link_inertia[0] + second_link_inertia[0] + tool_inertia[2],
        second_link_inertia[0] + tool_inertia[0],
        tool_mass,
    )
    constant_inertia, drive_gain = np.empty(3), np.empty(3)
    constant_inertia[joint_order] = model.dof_armature + moved_inertia
    drive_gain[joint_order] = model.actuator_gainprm[:, 0]
    return InertiaStruct.of(
        outer_joint=joint_order[0],
        cosine_sign=1.0 if mechanism.kind == SPHERICAL else -1.0,
        constant_inertia=constant_inertia * unit_factors,
        rod_inertia_difference=tool_inertia[0] - tool_inertia[2],
        mass=tool_mass * unit_factors[2],
        drive_gain=drive_gain * unit_factors,
    )


class LinearisedDynamics(NamedTuple):
    """Coefficients of the equations of motion, linear in z and q_inner about a configuration.

    They hold for the few ms that the arm spends near the configuration. Within 5 ms at 0.4 rad/s
    and 50 mm/s, the relative error of the step factors is about 1e-6 and that of the Coriolis
    coefficients about 2e-5. Triples are in the order outer hinge, inner hinge, slide. With the
    rates v, the Coriolis and centrifugal terms are

        c_outer = 2 v_outer (a v_inner + b v_slide)
        c_inner = 2 e v_slide v_inner − a v_outer²
        c_slide = −(b v_outer² + e v_inner²)

    Parameters
    ----------
    z : float
        Slide of the configuration, mm.
    inner_angle : float
        Angle q_inner of the configuration, rad.
    step_factor : Triple
        h/(M + h k) of each joint: change of the rate in a step by a unit of torque or force.
    step_factor_by_z : tuple[float, float]
        Derivatives of the step factors of outer and inner hinge with respect to z, per mm.
    step_factor_by_angle : float
        Derivative of the step factor of the outer hinge with respect to q_inner, per rad.
    coriolis : Triple
        Coefficients a in kg m², b and e in kg m²/mm.
    coriolis_by_z : Triple
        Derivatives of a, b and e with respect to z, per mm.
    coriolis_by_angle : tuple[float, float]
        Derivatives of a and b with respect to q_inner, per rad.
    """

    z: float
    inner_angle: float
    step_factor: Triple
    step_factor_by_z: tuple[float, float]
    step_factor_by_angle: float
    coriolis: Triple
    coriolis_by_z: Triple
    coriolis_by_angle: tuple[float, float]


@compiled
def linearise_dynamics(
    parameters: InertiaStruct, z: float, inner_angle: float, h: float
) -> LinearisedDynamics:
    """Return the coefficients of the equations of motion about a configuration.

    The symbols are those of the module. The derivative of sin²α with respect to q_inner is
    cosine_sign sin 2 q_inner.

    Parameters
    ----------
    parameters : InertiaStruct
        Inertias and drive gains of the arm.
    z : float
        Slide, mm.
    inner_angle : float
        Angle q_inner of the inner hinge, rad.
    h : float
        Length of a step, s.

    Returns
    -------
    LinearisedDynamics
        Coefficients and their derivatives.
    """
    outer, inner = parameters.outer_joint, 1 - parameters.outer_joint
    constant, k, m = parameters.constant_inertia, parameters.drive_gain, parameters.mass
    cos_2_alpha = parameters.cosine_sign * np.cos(2.0 * inner_angle)
    sin2_alpha = 0.5 * (1.0 - cos_2_alpha)
    sin2_alpha_slope = parameters.cosine_sign * np.sin(2.0 * inner_angle)
    parallel_axis_inertia, parallel_axis_slope = m * z * z, 2.0 * m * z
    tool_inertia = parameters.rod_inertia_difference + parallel_axis_inertia
    outer_factor = h / (constant[outer] + tool_inertia * sin2_alpha + h * k[outer])
    inner_factor = h / (constant[inner] + parallel_axis_inertia + h * k[inner])
    return LinearisedDynamics(
        z=z,
        inner_angle=inner_angle,
        step_factor=(outer_factor, inner_factor, h / (constant[2] + h * k[2])),
        step_factor_by_z=(
            -outer_factor * outer_factor * parallel_axis_slope * sin2_alpha / h,
            -inner_factor * inner_factor * parallel_axis_slope / h,
        ),
        step_factor_by_angle=-outer_factor * outer_factor * tool_inertia * sin2_alpha_slope / h,
        coriolis=(0.5 * tool_inertia * sin2_alpha_slope, m * z * sin2_alpha, m * z),
        coriolis_by_z=(0.5 * parallel_axis_slope * sin2_alpha_slope, m * sin2_alpha, m),
        coriolis_by_angle=(tool_inertia * cos_2_alpha, m * z * sin2_alpha_slope),
    )
