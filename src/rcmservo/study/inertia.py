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

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats
from rcmservo.method.kinematics import SPHERICAL, Kinematics, Point
from rcmservo.rows import Row, real, reals, whole
from rcmservo.sim.arm import AXES, PHYSICS, UNIT, model_of

Tilt = tuple[float, float]
"""cos and sin of twice the inner joint's angle."""


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
    model, units = PHYSICS.MjModel.from_xml_string(model_of(mechanism)), np.square(UNIT)
    (first, second, tool), mass = model.body_inertia[1:], model.body_mass[3]
    order, own, strength = list(AXES[mechanism.name][3]), np.empty(3), np.empty(3)
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


@compiled
def tilt_at(angle: float) -> Tilt:
    """The tilt with the inner joint at an `angle`."""
    return np.cos(2.0 * angle), np.sin(2.0 * angle)


@compiled
def tilted(tilt: Tilt, by: float) -> Tilt:
    """The tilt a step later: to the third power of the small angle, in a third of the time."""
    (c, s), t = tilt, 2.0 * by
    cos, sin = 1.0 - t * t / 2.0, t - t * t * t / 6.0
    return c * cos - s * sin, s * cos + c * sin


@compiled
def heavy(a: Inertia, z: float, tilt: Tilt, h: float) -> Point:
    """M + h k of outer hinge, inner hinge and slide, with the slide at z."""
    far, outer = a.mass * z * z, a.outer
    share = 0.5 * (1.0 - a.upright * tilt[0])  # sin²α
    M_outer, M_inner = a.own[outer] + (a.rod + far) * share, a.own[1 - outer] + far
    k = a.strength
    return M_outer + h * k[outer], M_inner + h * k[1 - outer], a.own[2] + h * k[2]


@compiled
def turning(a: Inertia, z: float, tilt: Tilt, v: Point) -> Point:
    """c of outer hinge, inner hinge and slide at the rates v, with the slide at z."""
    turn, swing, slide = v
    share, slope = 0.5 * (1.0 - a.upright * tilt[0]), a.upright * tilt[1]  # sin²α, its derivative
    growth, tool = 2.0 * a.mass * z * slide, a.rod + a.mass * z * z
    return (
        (tool * slope * swing + growth * share) * turn,
        growth * swing - 0.5 * tool * slope * turn * turn,
        -a.mass * z * (share * turn * turn + swing * swing),
    )


@compiled
def nearer(inverse: float, number: float) -> float:
    """1/number from nearly that, by a step of Newton's: much quicker than to divide, and as good
    where it has changed by a thousandth."""
    return inverse * (2.0 - number * inverse)
