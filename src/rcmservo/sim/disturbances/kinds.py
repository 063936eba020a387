"""The kinds of disturbance: what happens, with which parameters, and which causes name it rightly.

The table KINDS is the only place that knows the kinds.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from rcmservo.guard.causes import Cause
from rcmservo.sim.disturbances.parameters import Choice, Number, Parameter, written


@dataclass(frozen=True)
class Kind:
    """One kind of disturbance."""

    does: str
    """The effect, in words."""

    causes: tuple[Cause, ...]
    """Those that a person would accept as naming it, warnings included. None for one after which
    the servo says nothing any more."""

    parameters: Mapping[str, Parameter] = field(default_factory=dict[str, Parameter])
    """By their names."""

    lasts: float | None = math.inf
    """The `for` s where none is given; 0 for what happens at once or in a time that is given, and
    stays; None where it cannot be undone and takes no time."""

    likely: tuple[float, float] = (0.05, 2.0)
    """The least and the greatest `for` s that chance draws."""

    pictures: bool = True
    """False if only a camera that tells points can suffer it."""

    @property
    def stays(self) -> bool:
        """True if its effect stays when it is over, and may be noticed long after."""
        return self.lasts == 0.0

    @property
    def keys(self) -> list[str]:
        """Names of all that can be given."""
        return ["at", *(["for"] if self.lasts is not None else []), *self.parameters]

    @property
    def usage(self) -> str:
        """All that can be given, with the defaults."""
        keys = [f"{key}={written(one.default)}" for key, one in self.parameters.items()]
        if self.lasts is not None:
            keys.insert(0, "for" if math.isinf(self.lasts) else f"for={self.lasts:g}")
        return ",".join(["at", *keys])


WITHOUT = Cause.WITHOUT_MARKER_1, Cause.WITHOUT_MARKER_2
LOST = Cause.MARKERS_LOST, Cause.MARKER_1_LOST, Cause.MARKER_2_LOST, *WITHOUT
UNLIKELY = Cause.SURPRISED, Cause.REJECTED
SEEN_OTHERWISE = Cause.DRIFTS, Cause.ELSEWHERE
MOVED = Cause.CAMERA_MOVED, Cause.TARGET_OLD, *SEEN_OTHERWISE, *UNLIKELY, *LOST
MISLED = *UNLIKELY, *SEEN_OTHERWISE, Cause.DIVERGED, Cause.NOT_EXPLORED
TOO_OLD = Cause.STALE, Cause.AGEING
LATE_LOOP = Cause.LATE_TICK, Cause.OVERRUN, Cause.DRIVE_OFF
NOT_FOLLOWING = (Cause.NOT_FOLLOWING,)


def moved(does: str, parameters: Mapping[str, Parameter]) -> Kind:
    """Return the kind of a camera that `does` something: at once, or within `for` s, for good."""
    causes = *MOVED, Cause.DIVERGED, Cause.NOT_EXPLORED
    return Kind(f"the camera {does}", causes, parameters, lasts=0.0, likely=(2.0, 8.0))


EITHER = {"marker": Number(1, 1, 2, (1, 2), whole=True)}
AXIS = {"axis": Number(1, 1, 3, (1, 3), whole=True)}

KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "occlusion": Kind(
            "a marker, or with 0 both, is hidden by an object; smoke before the camera and blood "
            "on its lens hide both",
            LOST,
            {
                "by": Choice("object", ("object", "smoke", "blood")),
                "marker": Number(0, 0, 2, (0, 2), whole=True),
            },
            likely=(0.05, 4.0),
        ),
        "swap": Kind("each marker looks like the other", (Cause.SWAPPED, *UNLIKELY)),
        "decoy": Kind(
            "a marker is hidden, and something that looks like it appears px from it, which moves "
            "away at speed; in every frame, or in every second one",
            (*MISLED, *LOST),
            {
                **EITHER,
                "px": Number(60.0, 0.0, 1000.0, (6.0, 150.0), "px"),
                "speed": Number(0.0, 0.0, 1000.0, (0.0, 10.0), "px/s"),
                "every": Number(1, 1, 2, (1, 2), whole=True),
            },
            likely=(0.05, 8.0),
        ),
        "freeze": Kind(
            "the picture is frozen while frames come with fresh numbers and times; 1 or 2: that "
            "marker only stays where it is seen",
            (Cause.FROZEN, *MISLED, Cause.FRAMES_NOT_NEW),
            {"marker": Number(0, 0, 2, (0, 2), whole=True)},
            likely=(0.5, 4.0),
        ),
        "nan_points": Kind(
            "the tracker gives coordinates that are not finite", LOST, pictures=False
        ),
        "camera_pan": moved(
            "turns across its line of sight, so that the picture moves by px",
            {"px": Number(20.0, 0.1, 1000.0, (8.0, 60.0), "px")},
        ),
        "camera_roll": moved(
            "turns about its line of sight",
            {"deg": Number(180.0, -360.0, 360.0, (-30.0, 180.0), "deg")},
        ),
        "camera_dolly": moved(
            "moves along its line of sight", {"mm": Number(8.0, -200.0, 200.0, (-16.0, 16.0), "mm")}
        ),
        "camera_zoom": moved(
            "has a focal length that grows by a share of itself",
            {"share": Number(0.02, -0.2, 1.0, (-0.05, 0.05))},
        ),
        "relocate": Kind(
            "the camera is moved elsewhere and sees the tool from another side", MOVED, lasts=None
        ),
        "frame_drop": Kind(
            "a share of the frames is lost on the way; 1: all",
            TOO_OLD,
            {"share": Number(0.5, 0.0, 1.0, (0.3, 1.0))},
        ),
        "latency": Kind(
            "all frames come later by s, and each by another time of up to jitter",
            (Cause.LATE, *TOO_OLD),
            {
                "s": Number(0.15, 0.0, 1.0, (0.0, 0.4), "s"),
                "jitter": Number(0.0, 0.0, 1.0, (0.0, 0.4), "s"),
            },
        ),
        "frame_order": Kind(
            "the same frame comes again and again, or of every two frames the later comes first",
            (Cause.FRAMES_NOT_NEW, *TOO_OLD),
            {"what": Choice("repeated", ("repeated", "swapped"))},
        ),
        "corrupt": Kind(
            "frames come damaged: of another size, half missing, with flipped bits, or empty",
            (Cause.FRAMES_DAMAGED, Cause.AGEING, *UNLIKELY, *LOST),
            {"what": Choice("noise", ("size", "half", "noise", "none"))},
        ),
        "camera_clock": Kind(
            "the camera's clock is s ahead of the computer's, for all its times or for exposures "
            "only",
            (Cause.FRAMES_CLOCK, Cause.JOINTS_UNKNOWN, Cause.LATE, *TOO_OLD, *MISLED),
            {
                "s": Number(-0.03, -1e6, 1e6, (-0.06, 0.06), "s"),
                "of": Choice("all", ("all", "exposures")),
            },
        ),
        "gain": Kind(
            "an axis moves so many times as fast as commanded; 0: it is blocked, -1: reversed",
            NOT_FOLLOWING,
            {**AXIS, "factor": Number(3.0, -10.0, 10.0, (-2.0, 5.0))},
        ),
        "creep": Kind(
            "an axis moves in addition to its command, in deg/s for axes 1 and 2, in mm/s for "
            "axis 3",
            (Cause.CREEPS, *NOT_FOLLOWING),
            {**AXIS, "speed": Number(1.0, -20.0, 20.0, (0.3, 5.0), "deg/s or mm/s")},
        ),
        "encoder": Kind(
            "an encoder counts so many times the motion, and from a zero that is wrong by offset: "
            "in deg for axes 1 and 2, in mm for axis 3",
            (*NOT_FOLLOWING, Cause.DIVERGED, Cause.BEYOND_LIMIT, Cause.NOT_EXPLORED),
            {
                **AXIS,
                "factor": Number(-1.0, -10.0, 10.0, (-1.0, 1.0)),
                "offset": Number(0.0, -90.0, 90.0, (2.0, 10.0), "deg or mm"),
            },
        ),
        "encoder_nan": Kind(
            "an encoder reports what is not a number", (Cause.JOINTS_NOT_FINITE,), AXIS
        ),
        "arm_silent": Kind(
            "the arm neither answers nor hears", (Cause.ARM_SILENT, Cause.DRIVE_OFF)
        ),
        "arm_clock": Kind(
            "the arm's clock is wrong by s",
            (Cause.ARM_SILENT, Cause.DRIVE_OFF),
            {"s": Number(-1.0, -1e6, 1e6, (-3600.0, 3600.0), "s")},
        ),
        "drive_off": Kind("the emergency stop is pressed", (Cause.DRIVE_OFF,)),
        "stall": Kind(
            "the process is held up for `for`: between two ticks, or in one before its command",
            LATE_LOOP,
            {"where": Choice("between", ("between", "tick"))},
            lasts=0.5,
            likely=(0.006, 1.5),
        ),
        "jitter": Kind(
            "every tick comes later by another time of up to s",
            LATE_LOOP,
            {"s": Number(0.01, 0.0, 1.0, (0.003, 0.05), "s")},
        ),
        "kill": Kind("the process is killed: nothing is sent from then on", (), lasts=None),
        "disk_full": Kind("the disk is full", (Cause.NOT_RECORDED,)),
    }
)


IN_RUNS_ONLY = frozenset({"nan_points", "corrupt", "stall", "jitter", "kill", "disk_full"})
"""Kinds that nobody brings about in a laboratory that runs in wall time: its camera has pictures,
all of one size, and the process and the disk are real ones there."""


def causes_of(kind: str) -> set[Cause]:
    """The causes that a person would accept as naming a disturbance of this kind."""
    return set(KINDS[kind].causes)


def describe() -> str:
    """One line for each kind that a rig with pictures can suffer: how it is written, and what it
    does."""
    return "\n".join(_described(name, kind) for name, kind in KINDS.items() if kind.pictures)


def _described(name: str, kind: Kind) -> str:
    bounds = "; ".join(f"{key}: {one.right}" for key, one in kind.parameters.items())
    return f"{f'{name}:{kind.usage}':<40} {kind.does}{f' ({bounds})' if bounds else ''}"
