"""Table of the kinds of disturbance: their parameters, and the causes that name them correctly.

The effect of a kind is coded where it arises: arm_faults.py, camera_moves.py, camera_view.py,
computer_faults.py, decoy_markers.py, frame_damage.py, frame_delivery.py or smoke_and_blood.py.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from rcmservo.safety.causes import Cause
from rcmservo.sim.disturbances.parameters import Choice, Number, Parameter, format_value


@dataclass(frozen=True)
class Kind:
    """Kind of disturbance.

    Parameters
    ----------
    effect : str
        Effect, as a sentence.
    causes : tuple[Cause, ...]
        Causes that name it correctly, warnings included; none if the servo cannot report any more.
    parameters : Mapping[str, Parameter]
        Parameters by name.
    default_duration : float or None
        Default of `for` (s). 0: it happens at once, or within a given time, and is permanent. None:
        it happens at once and cannot be undone.
    sampled_duration : tuple[float, float]
        Least and greatest `for` (s) of random disturbances.
    pictures : bool
        False if only a camera without images can have it.
    """

    effect: str

    causes: tuple[Cause, ...]

    parameters: Mapping[str, Parameter] = field(default_factory=dict[str, Parameter])

    default_duration: float | None = math.inf

    sampled_duration: tuple[float, float] = (0.05, 2.0)

    pictures: bool = True

    @property
    def is_permanent(self) -> bool:
        """True if its effect is permanent and may be noticed long after its end."""
        return self.default_duration == 0.0

    @property
    def keys(self) -> list[str]:
        """Names of all keys of its text."""
        return ["at", *(["for"] if self.default_duration is not None else []), *self.parameters]

    @property
    def usage(self) -> str:
        """Text with all keys and their defaults."""
        keys = [
            f"{key}={format_value(parameter.default)}" for key, parameter in self.parameters.items()
        ]
        if self.default_duration is not None:
            keys.insert(
                0, "for" if math.isinf(self.default_duration) else f"for={self.default_duration:g}"
            )
        return ",".join(["at", *keys])


ONE_MARKER_CAUSES = Cause.WITHOUT_MARKER_1, Cause.WITHOUT_MARKER_2
LOST_MARKER_CAUSES = (
    Cause.MARKERS_LOST,
    Cause.MARKER_1_LOST,
    Cause.MARKER_2_LOST,
    *ONE_MARKER_CAUSES,
)
REJECTION_CAUSES = Cause.SURPRISED, Cause.REJECTED
DRIFT_CAUSES = Cause.DRIFTS, Cause.ELSEWHERE
CAMERA_MOTION_CAUSES = (
    Cause.CAMERA_MOVED,
    Cause.TARGET_OLD,
    *DRIFT_CAUSES,
    *REJECTION_CAUSES,
    *LOST_MARKER_CAUSES,
)
WRONG_MARKER_CAUSES = *REJECTION_CAUSES, *DRIFT_CAUSES, Cause.DIVERGED, Cause.NOT_EXPLORED
STALE_FRAME_CAUSES = Cause.STALE, Cause.AGEING
LATE_LOOP_CAUSES = Cause.LATE_TICK, Cause.OVERRUN, Cause.DRIVE_OFF
FOLLOWING_CAUSES = (Cause.NOT_FOLLOWING,)


def camera_motion_kind(effect: str, parameters: Mapping[str, Parameter]) -> Kind:
    """Return a kind that moves the camera: at once, or within `for` s, permanently."""
    causes = *CAMERA_MOTION_CAUSES, Cause.DIVERGED, Cause.NOT_EXPLORED
    return Kind(
        f"the camera {effect}",
        causes,
        parameters,
        default_duration=0.0,
        sampled_duration=(2.0, 8.0),
    )


MARKER_PARAMETER = {"marker": Number(1, 1, 2, (1, 2), is_whole=True)}
AXIS_PARAMETER = {"axis": Number(1, 1, 3, (1, 3), is_whole=True)}

DISTURBANCE_KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "occlusion": Kind(
            "a marker, or with 0 both, is hidden by an object; smoke in front of the camera and "
            "blood on its lens hide both",
            LOST_MARKER_CAUSES,
            {
                "by": Choice("object", ("object", "smoke", "blood")),
                "marker": Number(0, 0, 2, (0, 2), is_whole=True),
            },
            sampled_duration=(0.05, 4.0),
        ),
        "swap": Kind("each marker looks like the other", (Cause.SWAPPED, *REJECTION_CAUSES)),
        "decoy": Kind(
            "a marker is hidden, and an object that looks like it appears px from it and moves "
            "away at speed; in every frame, or in every second one",
            (*WRONG_MARKER_CAUSES, *LOST_MARKER_CAUSES),
            {
                **MARKER_PARAMETER,
                "px": Number(60.0, 0.0, 1000.0, (6.0, 150.0), "px"),
                "speed": Number(0.0, 0.0, 1000.0, (0.0, 10.0), "px/s"),
                "every": Number(1, 1, 2, (1, 2), is_whole=True),
            },
            sampled_duration=(0.05, 8.0),
        ),
        "freeze": Kind(
            "the image is frozen while frames have fresh numbers and times; 1 or 2: only that "
            "marker stays where it is in the image",
            (Cause.FROZEN, *WRONG_MARKER_CAUSES, Cause.FRAMES_NOT_NEW),
            {"marker": Number(0, 0, 2, (0, 2), is_whole=True)},
            sampled_duration=(0.5, 4.0),
        ),
        "nan_points": Kind(
            "the tracker reports coordinates that are not finite",
            LOST_MARKER_CAUSES,
            pictures=False,
        ),
        "camera_pan": camera_motion_kind(
            "pans, so that the image moves by px",
            {"px": Number(20.0, 0.1, 1000.0, (8.0, 60.0), "px")},
        ),
        "camera_roll": camera_motion_kind(
            "rolls about its optical axis",
            {"deg": Number(180.0, -360.0, 360.0, (-30.0, 180.0), "deg")},
        ),
        "camera_dolly": camera_motion_kind(
            "moves along its optical axis", {"mm": Number(8.0, -200.0, 200.0, (-16.0, 16.0), "mm")}
        ),
        "camera_zoom": camera_motion_kind(
            "zooms: its focal length grows by the fraction share",
            {"share": Number(0.02, -0.2, 1.0, (-0.05, 0.05))},
        ),
        "relocate": Kind(
            "the camera is moved to another side of the tool",
            CAMERA_MOTION_CAUSES,
            default_duration=None,
        ),
        "frame_drop": Kind(
            "the fraction share of the frames is lost; 1: all",
            STALE_FRAME_CAUSES,
            {"share": Number(0.5, 0.0, 1.0, (0.3, 1.0))},
        ),
        "latency": Kind(
            "all frames are late by s, and each by a further random time up to jitter",
            (Cause.LATE, *STALE_FRAME_CAUSES),
            {
                "s": Number(0.15, 0.0, 1.0, (0.0, 0.4), "s"),
                "jitter": Number(0.0, 0.0, 1.0, (0.0, 0.4), "s"),
            },
        ),
        "frame_order": Kind(
            "the same frame is repeated, or two consecutive frames are swapped",
            (Cause.FRAMES_NOT_NEW, *STALE_FRAME_CAUSES),
            {"what": Choice("repeated", ("repeated", "swapped"))},
        ),
        "corrupt": Kind(
            "frames are damaged: another size, half missing, flipped bits, or empty",
            (Cause.FRAMES_DAMAGED, Cause.AGEING, *REJECTION_CAUSES, *LOST_MARKER_CAUSES),
            {"what": Choice("noise", ("size", "half", "noise", "none"))},
        ),
        "camera_clock": Kind(
            "the camera's clock is s ahead of the computer's, for all its times or for exposures "
            "only",
            (
                Cause.FRAMES_CLOCK,
                Cause.JOINTS_UNKNOWN,
                Cause.LATE,
                *STALE_FRAME_CAUSES,
                *WRONG_MARKER_CAUSES,
            ),
            {
                "s": Number(-0.03, -1e6, 1e6, (-0.06, 0.06), "s"),
                "of": Choice("all", ("all", "exposures")),
            },
        ),
        "gain": Kind(
            "an axis moves at factor times its commanded rate; 0: it is blocked, -1: reversed",
            FOLLOWING_CAUSES,
            {**AXIS_PARAMETER, "factor": Number(3.0, -10.0, 10.0, (-2.0, 5.0))},
        ),
        "creep": Kind(
            "an axis moves in addition to its command, in deg/s for axes 1 and 2, in mm/s for "
            "axis 3",
            (Cause.CREEPS, *FOLLOWING_CAUSES),
            {**AXIS_PARAMETER, "speed": Number(1.0, -20.0, 20.0, (0.3, 5.0), "deg/s or mm/s")},
        ),
        "encoder": Kind(
            "an encoder reports factor times the motion, plus offset: in deg for axes 1 and 2, in "
            "mm for axis 3",
            (*FOLLOWING_CAUSES, Cause.DIVERGED, Cause.BEYOND_LIMIT, Cause.NOT_EXPLORED),
            {
                **AXIS_PARAMETER,
                "factor": Number(-1.0, -10.0, 10.0, (-1.0, 1.0)),
                "offset": Number(0.0, -90.0, 90.0, (2.0, 10.0), "deg or mm"),
            },
        ),
        "encoder_nan": Kind("an encoder reports NaN", (Cause.JOINTS_NOT_FINITE,), AXIS_PARAMETER),
        "arm_silent": Kind(
            "the arm neither answers nor accepts commands", (Cause.ARM_SILENT, Cause.DRIVE_OFF)
        ),
        "arm_clock": Kind(
            "the arm's clock is s ahead",
            (Cause.ARM_SILENT, Cause.DRIVE_OFF),
            {"s": Number(-1.0, -1e6, 1e6, (-3600.0, 3600.0), "s")},
        ),
        "drive_off": Kind("the emergency stop is pressed", (Cause.DRIVE_OFF,)),
        "stall": Kind(
            "the process stalls for `for`: between two ticks, or within a tick before its command",
            LATE_LOOP_CAUSES,
            {"where": Choice("between", ("between", "tick"))},
            default_duration=0.5,
            sampled_duration=(0.006, 1.5),
        ),
        "jitter": Kind(
            "every tick is late by a random time up to s",
            LATE_LOOP_CAUSES,
            {"s": Number(0.01, 0.0, 1.0, (0.003, 0.05), "s")},
        ),
        "kill": Kind("the process is killed and sends nothing more", (), default_duration=None),
        "disk_full": Kind("the disk is full", (Cause.NOT_RECORDED,)),
    }
)
"""Kinds of disturbance by name."""


NOT_LIVE_KINDS = frozenset({"nan_points", "corrupt", "stall", "jitter", "kill", "disk_full"})
"""Kinds that a laboratory in wall time cannot have: its camera has images, all of one size, and its
process and disk are real."""


def expected_causes(kind: str) -> set[Cause]:
    """Return the causes that name a disturbance of this kind correctly."""
    return set(DISTURBANCE_KINDS[kind].causes)


def describe_kinds() -> str:
    """Return one line with text and effect for each kind of a rig whose camera has images."""
    return "\n".join(
        _format_kind(name, kind) for name, kind in DISTURBANCE_KINDS.items() if kind.pictures
    )


def _format_kind(name: str, kind: Kind) -> str:
    bounds = "; ".join(f"{key}: {parameter.expected}" for key, parameter in kind.parameters.items())
    return f"{f'{name}:{kind.usage}':<40} {kind.effect}{f' ({bounds})' if bounds else ''}"
