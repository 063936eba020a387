"""Table of the kinds of disturbance. Add a new kind here, in two steps.

1. Add a row to `DISTURBANCE_KINDS`. The kind's text form, checks, random samples and help follow.
2. Simulate its effect in the file of effects/ that the comment above its group of rows names. There
   `Schedule.active(time, "name of the kind")` yields the disturbances that act at a time.
"""

import math
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from rcmservo.safety.causes import Cause
from rcmservo.sim.disturbances.parameters import Choice, Number, Parameter, format_value


@dataclass(frozen=True)
class Kind:
    """Row of the table: one kind of disturbance.

    Parameters
    ----------
    effect : str
        Effect, as a sentence for the help text.
    causes : tuple[Cause, ...]
        Causes, warnings included, by which the servo reports it correctly. Empty if the servo
        cannot report any more.
    parameters : Mapping[str, Parameter]
        Parameters by name, in addition to the start `at` and the duration `for`.
    default_duration : float or None
        Default of `for` (s); inf lasts to the end of the run. 0: the effect is permanent, and `for`
        is the time in which it develops. None: it happens at once, and `for` is refused.
    sampled_duration : tuple[float, float]
        Least and greatest `for` (s) of random disturbances.
    works_with_images : bool
        False if only the camera without images can have it.
    """

    effect: str

    causes: tuple[Cause, ...]

    parameters: Mapping[str, Parameter] = field(default_factory=dict[str, Parameter])

    default_duration: float | None = math.inf

    sampled_duration: tuple[float, float] = (0.05, 2.0)

    works_with_images: bool = True

    @property
    def is_permanent(self) -> bool:
        """True if its effect is permanent, so that the servo may report it long after its end."""
        return self.default_duration == 0.0

    @property
    def keys(self) -> list[str]:
        """Keys that its text form ``kind:key=value,...`` accepts."""
        return ["at", *(["for"] if self.default_duration is not None else []), *self.parameters]

    @property
    def usage(self) -> str:
        """Keys of its text form with their defaults, as the help text shows them."""
        defaults = {key: parameter.default for key, parameter in self.parameters.items()}
        if self.default_duration is not None:
            defaults = {"for": self.default_duration, **defaults}
        given = [
            key if default == math.inf else f"{key}={format_value(default)}"
            for key, default in defaults.items()
        ]
        return ",".join(["at", *given])


LOST_MARKER_CAUSES = (
    Cause.MARKERS_LOST,
    Cause.MARKER_1_LOST,
    Cause.MARKER_2_LOST,
    Cause.WITHOUT_MARKER_1,
    Cause.WITHOUT_MARKER_2,
)
REJECTION_CAUSES = Cause.SURPRISED, Cause.STANDS_STILL, Cause.REJECTED
DRIFT_CAUSES = Cause.DRIFTS, Cause.IMPLAUSIBLE, Cause.ELSEWHERE
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


def make_camera_motion(effect: str, parameters: Mapping[str, Parameter]) -> Kind:
    """Return a kind that moves the camera: at once, or within `for` s, permanently."""
    causes = *CAMERA_MOTION_CAUSES, Cause.DIVERGED, Cause.NOT_EXPLORED
    return Kind(f"the camera {effect}", causes, parameters, 0.0, sampled_duration=(2.0, 8.0))


# Number(default, least, greatest, (least, greatest) of random samples, unit)
MARKER_PARAMETER = {"marker": Number(1, 1, 2, (1, 2), is_whole=True)}
AXIS_PARAMETER = {"axis": Number(1, 1, 3, (1, 3), is_whole=True)}

DISTURBANCE_KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        # The view of the camera: effects/camera_view.py, decoy_markers.py and smoke_and_blood.py
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
            works_with_images=False,
        ),
        # Motions of the camera: effects/camera_moves.py
        "camera_pan": make_camera_motion(
            "pans, so that the image moves by px",
            {"px": Number(20.0, 0.1, 1000.0, (8.0, 60.0), "px")},
        ),
        "camera_roll": make_camera_motion(
            "rolls about its optical axis",
            {"deg": Number(180.0, -360.0, 360.0, (-30.0, 180.0), "deg")},
        ),
        "camera_dolly": make_camera_motion(
            "moves along its optical axis", {"mm": Number(8.0, -200.0, 200.0, (-16.0, 16.0), "mm")}
        ),
        "camera_zoom": make_camera_motion(
            "zooms: its focal length grows by the fraction share",
            {"share": Number(0.02, -0.2, 1.0, (-0.05, 0.05))},
        ),
        "relocate": Kind(
            "the camera is moved to another side of the tool",
            CAMERA_MOTION_CAUSES,
            default_duration=None,
        ),
        # Frames on their way to the computer: effects/frame_delivery.py and frame_damage.py
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
        # The arm and its drives: effects/arm_faults.py
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
        # The process and the disk: effects/computer_faults.py
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
"""Kinds of disturbance by name, in groups by the file that simulates them."""

NOT_LIVE_KINDS = "nan_points", "corrupt", "stall", "jitter", "kill", "disk_full"

LIVE_KINDS = {name: kind for name, kind in DISTURBANCE_KINDS.items() if name not in NOT_LIVE_KINDS}
"""Kinds that a laboratory in wall time can have. It refuses the others, because its camera has
images, all of one size, and its process and disk are real."""


def expected_causes(kind: str) -> set[Cause]:
    """Return the causes by which the servo reports a disturbance of this kind correctly."""
    return set(DISTURBANCE_KINDS[kind].causes)


def describe_kinds() -> str:
    """Return a line of help for each kind that a camera with images can have."""
    return "\n".join(
        f"{f'{name}:{kind.usage}':<40} {kind.effect}{_describe_ranges(kind)}"
        for name, kind in DISTURBANCE_KINDS.items()
        if kind.works_with_images
    )


def document_kinds() -> str:
    """Return a list of all kinds with their effects and parameters, for a docstring."""
    entries: list[str] = []
    for name, kind in DISTURBANCE_KINDS.items():
        condition = "" if kind.works_with_images else ", only with pictures=False"
        effect = f"{kind.effect}{condition}{_describe_ranges(kind)}"
        entries += f"- {name}:{kind.usage}", textwrap.indent(textwrap.fill(effect, 92), "  ")
    return "\n".join(entries)


def _describe_ranges(kind: Kind) -> str:
    """Return the ranges of a kind's parameters in parentheses; empty if it has none."""
    ranges = [f"{key}: {parameter.expected}" for key, parameter in kind.parameters.items()]
    return f" ({'; '.join(ranges)})" if ranges else ""
