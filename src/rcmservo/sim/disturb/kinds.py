"""The kinds of disturbance: what happens, with which parameters, and which causes name it rightly.

The table KINDS is the only place that knows the kinds.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from rcmservo.guard.causes import Cause
from rcmservo.sim.disturb.parameters import Choice, Number, Parameter, written


@dataclass(frozen=True)
class Kind:
    """One kind of disturbance."""

    does: str
    """What happens, in words."""

    causes: tuple[Cause, ...]
    """Those that a person would accept as naming it, warnings included. None for one after which
    the servo says nothing any more."""

    parameters: Mapping[str, Parameter] = field(default_factory=dict[str, Parameter])
    """By their names."""

    lasts: float | None = math.inf
    """The `for` s where none is given; None where it cannot be undone."""

    likely: tuple[float, float] = (0.05, 2.0)
    """The least and the greatest `for` s that chance draws."""

    pictures: bool = True
    """False if only a camera that tells points can suffer it."""

    stays: bool = False
    """Whether what it brought about stays when it is over, and may be noticed long after."""

    @property
    def keys(self) -> list[str]:
        """What can be given of it, by name."""
        return ["at", *(["for"] if self.lasts is not None else []), *self.parameters]

    @property
    def usage(self) -> str:
        """What can be given of it, with the defaults."""
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
MOVING = *MOVED, Cause.DIVERGED, Cause.NOT_EXPLORED
TOO_OLD = Cause.STALE, Cause.AGEING
LATE_LOOP = Cause.LATE_TICK, Cause.OVERRUN, Cause.DRIVE_OFF
NOT_FOLLOWING = (Cause.NOT_FOLLOWING,)

EITHER = {"marker": Number(1, 1, 2, (1, 2), whole=True)}
AXIS = {"axis": Number(1, 1, 3, (1, 3), whole=True)}

KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "marker_loss": Kind(
            "a marker is not there any more; 0: neither is",
            LOST,
            {"marker": Number(0, 0, 2, (0, 2), whole=True)},
        ),
        "swap": Kind("each marker looks like the other", (Cause.SWAPPED, *UNLIKELY)),
        "false_marker": Kind(
            "a marker is hidden, and something that looks like it appears some way off",
            UNLIKELY,
            {**EITHER, "px": Number(60.0, 1.0, 1000.0, (15.0, 150.0), "px")},
        ),
        "flicker": Kind(
            "the same in every second frame only",
            MISLED,
            {**EITHER, "px": Number(60.0, 1.0, 1000.0, (6.0, 150.0), "px")},
        ),
        "slide": Kind(
            "a marker is hidden, and something that looks like it slides away from it",
            (*MISLED, *LOST),
            {**EITHER, "speed": Number(5.0, 0.1, 1000.0, (2.0, 10.0), "px/s")},
            likely=(2.0, 8.0),
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
        "smoke": Kind(
            "smoke drifts before the camera, too dense to see through", LOST, likely=(1.0, 4.0)
        ),
        "stain": Kind(
            "blood is splashed on the lens where the markers are seen", LOST, likely=(0.5, 3.0)
        ),
        "bump": Kind(
            "somebody bumps into the camera: the picture jumps by so much and stays there",
            MOVED,
            {"px": Number(20.0, 0.1, 500.0, (8.0, 60.0), "px")},
            lasts=None,
        ),
        "roll": Kind(
            "the camera is rolled about its line of sight",
            MOVED,
            {"deg": Number(180.0, -180.0, 180.0, (10.0, 180.0), "deg")},
            lasts=None,
        ),
        "relocate": Kind(
            "the camera is moved elsewhere and sees the tool from another side", MOVED, lasts=None
        ),
        "pan": Kind(
            "the camera turns slowly in some direction: the picture moves at speed, and stays "
            "where it is then",
            MOVING,
            {"speed": Number(10.0, 0.1, 1000.0, (2.0, 20.0), "px/s")},
            lasts=4.5,
            likely=(2.0, 6.0),
            stays=True,
        ),
        "rolling": Kind(
            "the camera rolls slowly about its line of sight, and stays where it is then",
            MOVING,
            {"speed": Number(1.0, -90.0, 90.0, (-4.0, 4.0), "deg/s")},
            lasts=8.0,
            likely=(2.0, 8.0),
            stays=True,
        ),
        "dolly": Kind(
            "the camera moves slowly along its line of sight, and stays where it is then",
            MOVING,
            {"speed": Number(2.0, -50.0, 50.0, (-4.0, 4.0), "mm/s")},
            lasts=4.0,
            likely=(2.0, 6.0),
            stays=True,
        ),
        "zoom": Kind(
            "the camera's focal length grows by a share of itself",
            MOVING,
            {"share": Number(0.02, -0.2, 1.0, (-0.05, 0.05))},
            lasts=None,
            stays=True,
        ),
        "stuck": Kind("the camera stands still: no frame comes", TOO_OLD),
        "delay": Kind(
            "every frame comes later by another time of up to s",
            (Cause.LATE, *TOO_OLD),
            {"s": Number(0.2, 0.0, 1.0, (0.05, 0.4), "s")},
        ),
        "latency": Kind(
            "all frames come later by the same time s",
            (Cause.LATE, *TOO_OLD),
            {"s": Number(0.15, 0.0, 1.0, (0.02, 0.4), "s")},
        ),
        "frame_drop": Kind(
            "a share of the frames is lost on the way",
            TOO_OLD,
            {"share": Number(0.5, 0.0, 1.0, (0.3, 0.95))},
        ),
        "repeat": Kind("the same frame comes again and again", (Cause.FRAMES_NOT_NEW, *TOO_OLD)),
        "shuffle": Kind(
            "of every two frames the later comes first", (Cause.FRAMES_NOT_NEW, *TOO_OLD)
        ),
        "clock_step": Kind(
            "the camera's clock is wrong by s",
            (Cause.FRAMES_CLOCK, Cause.AGEING),
            {"s": Number(3600.0, -1e6, 1e6, (-3600.0, 3600.0), "s")},
        ),
        "clocks_apart": Kind(
            "the camera's clock is s ahead of the computer's: exposures are told wrongly, arrivals "
            "are not",
            (Cause.FRAMES_CLOCK, Cause.JOINTS_UNKNOWN, Cause.LATE, *TOO_OLD, *MISLED),
            {"s": Number(-0.03, -1.0, 1.0, (-0.06, 0.06), "s")},
        ),
        "corrupt": Kind(
            "frames come damaged: of another size, half missing, with flipped bits, or empty",
            (Cause.FRAMES_DAMAGED, Cause.AGEING, *UNLIKELY, *LOST),
            {"what": Choice("noise", ("size", "half", "noise", "none"))},
        ),
        "axis_stuck": Kind("an axis is blocked", NOT_FOLLOWING, AXIS),
        "axis_reversed": Kind("an axis turns the other way than commanded", NOT_FOLLOWING, AXIS),
        "gain": Kind(
            "an axis moves so many times as fast as commanded",
            NOT_FOLLOWING,
            {**AXIS, "factor": Number(3.0, 0.0, 10.0, (2.0, 5.0))},
        ),
        "creep": Kind(
            "an axis moves beside what it is asked for, in deg/s for axes 1 and 2, in mm/s for "
            "axis 3",
            (Cause.CREEPS, *NOT_FOLLOWING),
            {**AXIS, "speed": Number(1.0, -20.0, 20.0, (0.3, 5.0), "deg/s or mm/s")},
        ),
        "encoder_reversed": Kind(
            "an encoder counts the wrong way", (*NOT_FOLLOWING, Cause.DIVERGED), AXIS
        ),
        "encoder_zero": Kind(
            "an encoder's zero is wrong: in deg for axes 1 and 2, in mm for axis 3",
            (*NOT_FOLLOWING, Cause.DIVERGED, Cause.BEYOND_LIMIT, Cause.NOT_EXPLORED),
            {**AXIS, "offset": Number(5.0, -90.0, 90.0, (2.0, 10.0), "deg or mm")},
        ),
        "encoder_nan": Kind(
            "an encoder tells what is not a number", (Cause.JOINTS_NOT_FINITE,), AXIS
        ),
        "arm_silent": Kind(
            "the arm neither answers nor hears", (Cause.ARM_SILENT, Cause.DRIVE_OFF)
        ),
        "arm_clock": Kind(
            "the arm's clock is wrong by s",
            (Cause.ARM_SILENT, Cause.DRIVE_OFF),
            {"s": Number(-1.0, -1e6, 1e6, (-3600.0, 3600.0), "s")},
        ),
        "drive_off": Kind("somebody presses the emergency stop", (Cause.DRIVE_OFF,)),
        "overrun": Kind(
            "one tick takes longer by `for`", LATE_LOOP, lasts=0.1, likely=(0.006, 0.3)
        ),
        "jitter": Kind(
            "every tick comes later by another time of up to s",
            LATE_LOOP,
            {"s": Number(0.01, 0.0, 1.0, (0.003, 0.05), "s")},
        ),
        "hang": Kind(
            "the process is stopped for `for`, and goes on",
            LATE_LOOP,
            lasts=0.5,
            likely=(0.02, 1.5),
        ),
        "kill": Kind("the process is killed: nothing is sent from then on", (), lasts=None),
        "disk_full": Kind("the disk is full", (Cause.NOT_RECORDED,)),
    }
)


IN_RUNS_ONLY = frozenset(
    {"nan_points", "corrupt", "overrun", "jitter", "hang", "kill", "disk_full"}
)
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
