"""The inertia of the simulated arm: the equations of motion that MuJoCo solves for it.

Two hinges whose axes cross at right angles in the RCM, and a slide along the tool, a rod of mass m
whose middle is z from the RCM. With α the angle from the outer hinge's axis to the tool, the mass
matrix is diagonal:

    M_outer = own + (rod + m z²) sin²α,    M_inner = own + m z²,    M_slide = own

A velocity drive of strength k pulls its joint from the rate v to the rate u; what turning and
sliding do to each other is c, from Lagrange's equations. A step of MuJoCo's "implicitfast" is

    v ← v + h (k (u − v) − c) / (M + h k)

All in rad and mm: of the slide, masses and strengths count 1e-6 of what they are in m.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from rcmservo.geometry.kinematics import SPHERICAL, Kinematics, Point
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.structs import Row, real, reals, whole
from rcmservo.sim.arm import MJCF_AXES, MUJOCO_UNITS, UNTYPED_MUJOCO, write_mjcf


class Inertia(Row):
    """The masses of an arm, and how strong its drives are."""

    outer: int = whole("", "which of the first two joints turns the other one")
    upright: float = real("", "1 where the inner one counts from the outer axis, -1 from across it")
    own: Floats = reals(3, "kg m², kg m², 1e-6 kg", "what each joint moves in any pose")
    rod: float = real("kg m²", "the tool's moment across itself, less that along itself")
    mass: float = real("1e-6 kg", "of the tool")
    strength: Floats = reals(3, "N m s, N m s, 1e-6 N s/m", "of each joint's drive")


@cache
def inertia_of(mechanism: Kinematics) -> Inertia:
    """That of the simulated arm."""
    model, units = (
        UNTYPED_MUJOCO.MjModel.from_xml_string(write_mjcf(mechanism)),
        np.square(MUJOCO_UNITS),
    )
    (first, second, tool), mass = model.body_inertia[1:], model.body_mass[3]
    order, own, strength = list(MJCF_AXES[mechanism.name][3]), np.empty(3), np.empty(3)
    moved = first[0] + second[0] + tool[2], second[0] + tool[0], mass
    own[order] = model.dof_armature + moved
    strength[order] = model.actuator_gainprm[:, 0]
    return Inertia.of(
        outer=order[0],
        upright=1.0 if mechanism.kind == SPHERICAL else -1.0,
        own=own * units,
        rod=tool[0] - tool[2],
        mass=mass * units[2],
        strength=strength * units,
    )


class Near(NamedTuple):
    """The equations about a place, for the few ms that the arm is near it: linear in the way of
    slide and inner hinge from there, what they leave out being a millionth.

    Parameters
    ----------
    z : float
        The slide there, mm.
    angle : float
        The inner hinge there, rad.
    by : Point
        h/(M + h k) of outer hinge, inner hinge and slide.
    by_z : tuple[float, float]
        How those of the hinges change with the slide, by mm.
    by_angle : float
        How that of the outer one changes with the inner hinge's angle, by rad.
    c : Point
        Numbers a, b, e: c of the outer hinge is 2 v_outer (a v_inner + b v_slide), of the inner one
        2 e v_slide v_inner - a v_outer², and of the slide -(b v_outer² + e v_inner²).
    c_z : Point
        How they change with the slide, by mm.
    c_angle : tuple[float, float]
        How the first two change with the inner hinge's angle, by rad.
    """

    z: float
    angle: float
    by: Point
    by_z: tuple[float, float]
    by_angle: float
    c: Point
    c_z: Point
    c_angle: tuple[float, float]


@compiled
def near(arm: Inertia, z: float, angle: float, h: float) -> Near:
    """The equations with the slide at z and the inner joint at an `angle`."""
    o, k, m = arm.outer, arm.strength, arm.mass
    turned = arm.upright * np.cos(2.0 * angle)
    share = 0.5 * (1.0 - turned)  # sin²α
    slope = arm.upright * np.sin(2.0 * angle)  # its derivative
    far, growth = m * z * z, 2.0 * m * z
    tool = arm.rod + far
    outer = h / (arm.own[o] + tool * share + h * k[o])
    inner = h / (arm.own[1 - o] + far + h * k[1 - o])
    return Near(
        z,
        angle,
        (outer, inner, h / (arm.own[2] + h * k[2])),
        (-outer * outer * growth * share / h, -inner * inner * growth / h),
        -outer * outer * tool * slope / h,
        (0.5 * tool * slope, m * z * share, m * z),
        (0.5 * growth * slope, m * share, m),
        (tool * turned, m * z * slope),
    )
