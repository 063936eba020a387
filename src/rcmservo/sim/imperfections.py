"""Imperfections of a real arm, its tool and its camera, and two arms that have them.

`Imperfections` are sizes; the directions and signs follow from the seed of the laboratory, so that
each seed is another arm of the same quality. sim/imperfect_markers.py applies them.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np

from rcmservo.constraints import Checked, Triple, angles, between, each, not_negative
from rcmservo.geometry.kinematics import FULL_TURN_RAD
from rcmservo.interfaces import Floats
from rcmservo.sim.imperfect_markers import ImperfectionsStruct

SEED_CHILD = 5
"""Child of the laboratory's seed that directions and signs are drawn from."""

UP_TO_50_MM = between(0.0, 50.0, "a length", "mm")
UP_TO_1_S = between(0.0, 1.0, "a time", "s")
UP_TO_HALF = between(0.0, 0.5, "a fraction")


@dataclass(frozen=True)
class Imperfections(Checked, section="imperfections"):
    """Sizes of the imperfections of a simulated arm, its tool and its camera; all zero by default.

    The servo knows none of them. Directions and signs follow from the seed.

    Parameters
    ----------
    axis_distance : float
        Distance between the two hinge axes, which should meet in the RCM, mm.
    insertion_distance : float
        Distance of the insertion axis from the RCM, mm.
    marker_distance : float
        Distance of each marker from the tool's axis, mm.
    roll : float
        Rotation of the tool about its axis per rotation of joint 1, rad/rad, from -10 to 10.
    spacing_error : float
        Relative error of the distance between the markers, from -0.5 to 0.5.
    insertion_error : float
        Actual minus reported insertion, from -50 to 50 mm.
    backlash : Triple
        Lost motion of each joint when it turns back, rad, rad, mm: the encoders are at the motors.
    friction_bend : float
        Deflection of the markers against a motion across the shaft, per speed, s: 0.02 is 0.02 mm
        per mm/s.
    tissue_bend : float
        Fraction by which tissue on one side of the middle of the workspace bends the tool back
        when it is pressed into it, from 0 to 0.5.
    port_motion : float
        Amplitude (mm) of a periodic motion of the RCM, as of a port that moves with the breath.
    gain_error : float
        Relative error of each joint's rate, up or down, from 0 to 0.5.
    report_period : float
        Time for which the arm repeats the joints that it has measured, with the time of each
        report, s.
    stamp_error : float
        Error of the frames' exposure times, early or late, s.
    read_out : float
        Time from the exposure of the first row of an image to that of the last, s.
    focus : float
        Amplitude of a slow relative change of the focal length, from 0 to 0.5.
    air : float
        Standard deviation of a slow motion of each marker in the image, px.

    Raises
    ------
    BadInput
        If a field is outside its range.

    Notes
    -----
    The last three are those of the camera without images.
    """

    axis_distance: Annotated[float, UP_TO_50_MM] = 0.0
    insertion_distance: Annotated[float, UP_TO_50_MM] = 0.0
    marker_distance: Annotated[float, UP_TO_50_MM] = 0.0
    roll: Annotated[float, between(-10.0, 10.0, "a ratio")] = 0.0
    spacing_error: Annotated[float, between(-0.5, 0.5, "a ratio")] = 0.0
    insertion_error: Annotated[float, between(-50.0, 50.0, "a length", "mm")] = 0.0
    backlash: Annotated[
        Triple,
        each(not_negative(), "three numbers that are not negative (rad, rad, mm)"),
        angles(FULL_TURN_RAD, first=2),
    ] = (0.0, 0.0, 0.0)
    friction_bend: Annotated[float, UP_TO_1_S] = 0.0
    tissue_bend: Annotated[float, UP_TO_HALF] = 0.0
    port_motion: Annotated[float, UP_TO_50_MM] = 0.0
    gain_error: Annotated[float, UP_TO_HALF] = 0.0
    report_period: Annotated[float, UP_TO_1_S] = 0.0
    stamp_error: Annotated[float, UP_TO_1_S] = 0.0
    read_out: Annotated[float, UP_TO_1_S] = 0.0
    focus: Annotated[float, UP_TO_HALF] = 0.0
    air: Annotated[float, between(0.0, 100.0, "a number of px")] = 0.0

    @property
    def is_ideal(self) -> bool:
        """True if the arm, the tool and the camera have no imperfection."""
        return self == Imperfections()

    def draw(self, seed: int) -> ImperfectionsStruct:
        """Return the imperfections of a seed's laboratory, with their directions and signs."""
        random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(SEED_CHILD,)))
        insertion = self.insertion_distance * draw_direction(random, 2)
        markers = [self.marker_distance * draw_direction(random, 2) for _ in range(2)]
        return ImperfectionsStruct.of(
            is_any=not self.is_ideal,
            axis_distance=self.axis_distance * random.choice([-1.0, 1.0]),
            shaft_offset=insertion,
            marker_offsets=np.array(markers) + insertion,
            roll=self.roll,
            spacing_ratio=1.0 + self.spacing_error,
            insertion_error=self.insertion_error,
            half_gap=0.5 * np.array(self.backlash),
            start_in_gap=random.uniform(-1.0, 1.0, 3),
            target_in_gap=random.uniform(-1.0, 1.0, 3),
            friction_bend=self.friction_bend,
            port=self.port_motion * draw_direction(random, 3),
            port_phase=random.uniform(0.0, 2.0 * np.pi),
            rate_ratios=1.0 + self.gain_error * random.choice([-1.0, 1.0], 3),
            report_period=round(self.report_period * 1e9),
            stamp_error=round(self.stamp_error * 1e9) * random.choice([-1, 1]),
            read_out=self.read_out,
            focus=self.focus,
            focus_phase=random.uniform(0.0, 2.0 * np.pi),
            tissue_bend=self.tissue_bend,
            tissue_side=draw_direction(random, 3),
        )


def draw_direction(random: np.random.Generator, size: int) -> Floats:
    """Return a random unit vector."""
    direction: Floats = random.standard_normal(size)
    return direction / np.linalg.norm(direction)


def describe_arm(scale: float) -> dict[str, dict[str, Any]]:
    """Return the sections of a rig file with a combination of imperfections, times `scale`."""
    angle, imperfections = (
        math.radians(0.15),
        Imperfections(
            axis_distance=0.5 * scale,
            marker_distance=0.7 * scale,
            gain_error=0.03 * scale,
            stamp_error=0.004 * scale,
            read_out=0.01 * scale,
            focus=0.0005 * scale,
            air=0.2 * scale,
        ),
    )
    backlash = [angle * scale, angle * scale, 0.1 * scale]
    table = {one.name: getattr(imperfections, one.name) for one in fields(imperfections)}
    return {"imperfections": table | {"backlash": backlash}, "drive": {"lag": 0.03 * scale}}


ARMS: Mapping[str, Mapping[str, Mapping[str, Any]]] = MappingProxyType(
    {"ideal": {}, "good": describe_arm(1.0), "worn": describe_arm(2.0)}
)
"""Sections of a rig file for each quality of an arm: `good` as of a well-kept one, `worn` twice as
far from the ideal."""
