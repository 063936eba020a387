"""What can be done to a simulated rig: every kind of disturbance, its parameters, and the causes
that name it rightly.

A disturbance is written `kind:at=5,for=0.5,key=value`: it acts from `at` s after the run's start
for `for` s, or to the end. The table KINDS is the only place that knows the kinds; what they do is
in the file of the interface where they arise: view.py (what the camera sees), delivery.py (how its
frames come), arm.py and process.py.
"""

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from rcmservo.errors import BadInput, require
from rcmservo.guard.states import Cause

LONGEST = 1e6
"""s from which on a time is no part of a run."""

Value = float | str


@dataclass(frozen=True)
class Number:
    """A parameter that is a number in `unit`, from `low` to `high`; ``likely`` bounds what chance
    draws."""

    default: float
    low: float
    high: float
    likely: tuple[float, float]
    unit: str = ""
    whole: bool = False

    def read(self, where: str, value: object) -> float:
        """The value as a number, if it is one within the bounds."""
        number = _number(value)
        good = self.low <= number <= self.high and (not self.whole or number.is_integer())
        require(good, where, value, self.right)
        return number

    def draw(self, random: np.random.Generator) -> float:
        """A value by chance."""
        low, high = self.likely
        return (
            float(random.integers(int(low), int(high) + 1))
            if self.whole
            else float(f"{random.uniform(low, high):.3g}")
        )

    @property
    def right(self) -> str:
        """What would be right, in words."""
        kind = "a whole number" if self.whole else "a number"
        return f"{kind}{f' of {self.unit}' if self.unit else ''} from {self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class Choice:
    """A parameter that is one of a few words."""

    default: str
    words: tuple[str, ...]

    def read(self, where: str, value: object) -> str:
        """The value, if it is one of the words."""
        require(value in self.words, where, value, self.right)
        return str(value)

    def draw(self, random: np.random.Generator) -> str:
        """A word by chance."""
        return str(random.choice(self.words))

    @property
    def right(self) -> str:
        """What would be right, in words."""
        return "one of " + ", ".join(self.words)


@dataclass(frozen=True)
class Kind:
    """One kind of disturbance.

    ``does`` says in words what happens; ``causes`` are those that a person would accept as naming
    it, warnings included. ``lasts`` is the `for` s where none is given, None where it cannot be
    undone; ``likely`` bounds the `for` s that chance draws. ``pictures`` False marks what only a
    camera that delivers points can suffer.
    """

    does: str
    causes: frozenset[Cause]
    parameters: Mapping[str, Number | Choice] = field(default_factory=dict[str, Number | Choice])
    lasts: float | None = math.inf
    likely: tuple[float, float] = (0.05, 2.0)
    pictures: bool = True


def _kind(
    does: str,
    *causes: Cause,
    parameters: Mapping[str, Number | Choice] | None = None,
    **rest: object,
) -> Kind:
    return Kind(does, frozenset(causes), parameters or {}, **rest)  # pyright: ignore[reportArgumentType]


LOST = Cause.MARKERS_LOST, Cause.MARKER_1_LOST, Cause.MARKER_2_LOST
MOVED = Cause.CAMERA_MOVED, Cause.TARGET_OLD, Cause.REJECTED, Cause.SURPRISED, *LOST
LATE_LOOP = Cause.LATE_TICK, Cause.OVERRUN, Cause.DRIVE_OFF

AXIS = Number(1, 1, 3, (1, 3), whole=True)
SHARE = Number(0.5, 0.0, 1.0, (0.3, 0.95))

KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "marker_loss": _kind(
            "a marker is not there any more; 0: neither is",
            *LOST,
            parameters={"marker": Number(0, 0, 2, (0, 2), whole=True)},
        ),
        "swap": _kind(
            "each marker looks like the other", Cause.SWAPPED, Cause.SURPRISED, Cause.REJECTED
        ),
        "false_marker": _kind(
            "a marker is hidden, and something that looks like it appears some way off",
            Cause.SURPRISED,
            Cause.REJECTED,
            parameters={
                "marker": Number(1, 1, 2, (1, 2), whole=True),
                "px": Number(60.0, 1.0, 1000.0, (15.0, 150.0), "px"),
            },
        ),
        "nan_points": _kind(
            "the tracker gives coordinates that are not finite", *LOST, pictures=False
        ),
        "smoke": _kind(
            "smoke drifts before the camera, too dense to see through", *LOST, likely=(1.0, 4.0)
        ),
        "stain": _kind(
            "blood is splashed on the lens where the markers are seen", *LOST, likely=(0.5, 3.0)
        ),
        "bump": _kind(
            "somebody bumps into the camera: the picture jumps by so much and stays there",
            *MOVED,
            parameters={"px": Number(20.0, 0.1, 500.0, (8.0, 60.0), "px")},
            lasts=None,
        ),
        "roll": _kind(
            "the camera is rolled about its line of sight",
            *MOVED,
            parameters={"deg": Number(180.0, -180.0, 180.0, (10.0, 180.0), "deg")},
            lasts=None,
        ),
        "relocate": _kind(
            "the camera is moved elsewhere and sees the tool from another side", *MOVED, lasts=None
        ),
        "stuck": _kind("the camera stands still: no frame comes", Cause.STALE, Cause.AGEING),
        "delay": _kind(
            "every frame comes later by another time of up to s",
            *(Cause.LATE, Cause.STALE, Cause.AGEING),
            parameters={"s": Number(0.2, 0.0, 1.0, (0.05, 0.4), "s")},
        ),
        "latency": _kind(
            "all frames come later by the same time s",
            *(Cause.LATE, Cause.STALE, Cause.AGEING),
            parameters={"s": Number(0.15, 0.0, 1.0, (0.02, 0.4), "s")},
        ),
        "frame_drop": _kind(
            "a share of the frames is lost on the way",
            Cause.STALE,
            Cause.AGEING,
            parameters={"share": SHARE},
        ),
        "repeat": _kind(
            "the same frame comes again and again", Cause.FRAMES_NOT_NEW, Cause.STALE, Cause.AGEING
        ),
        "shuffle": _kind(
            "of every two frames the later comes first",
            Cause.FRAMES_NOT_NEW,
            Cause.STALE,
            Cause.AGEING,
        ),
        "clock_step": _kind(
            "the camera's clock is wrong by s",
            *(Cause.FRAMES_CLOCK, Cause.AGEING),
            parameters={"s": Number(3600.0, -1e6, 1e6, (-3600.0, 3600.0), "s")},
        ),
        "corrupt": _kind(
            "frames come damaged: of another size, half missing, with flipped bits, or empty",
            *(Cause.FRAMES_DAMAGED, Cause.AGEING, Cause.REJECTED, Cause.SURPRISED, *LOST),
            parameters={"what": Choice("noise", ("size", "half", "noise", "none"))},
        ),
        "axis_stuck": _kind("an axis is blocked", Cause.NOT_FOLLOWING, parameters={"axis": AXIS}),
        "axis_reversed": _kind(
            "an axis turns the other way than commanded",
            Cause.NOT_FOLLOWING,
            parameters={"axis": AXIS},
        ),
        "gain": _kind(
            "an axis moves so many times as fast as commanded",
            Cause.NOT_FOLLOWING,
            parameters={"axis": AXIS, "factor": Number(3.0, 0.0, 10.0, (2.0, 5.0))},
        ),
        "encoder_reversed": _kind(
            "an encoder counts the wrong way",
            *(Cause.NOT_FOLLOWING, Cause.DIVERGED),
            parameters={"axis": AXIS},
        ),
        "encoder_zero": _kind(
            "an encoder's zero is wrong: in deg for axes 1 and 2, in mm for axis 3",
            *(Cause.NOT_FOLLOWING, Cause.DIVERGED, Cause.BEYOND_LIMIT, Cause.NOT_EXPLORED),
            parameters={"axis": AXIS, "offset": Number(5.0, -90.0, 90.0, (2.0, 10.0), "deg or mm")},
        ),
        "encoder_nan": _kind(
            "an encoder tells what is not a number",
            Cause.JOINTS_NOT_FINITE,
            parameters={"axis": AXIS},
        ),
        "arm_silent": _kind("the arm neither answers nor hears", Cause.ARM_SILENT, Cause.DRIVE_OFF),
        "drive_off": _kind("somebody presses the emergency stop", Cause.DRIVE_OFF),
        "overrun": _kind(
            "one tick takes longer by `for`", *LATE_LOOP, lasts=0.1, likely=(0.006, 0.3)
        ),
        "jitter": _kind(
            "every tick comes later by another time of up to s",
            *LATE_LOOP,
            parameters={"s": Number(0.01, 0.0, 1.0, (0.003, 0.05), "s")},
        ),
        "hang": _kind(
            "the process is stopped for `for`, and goes on",
            *LATE_LOOP,
            lasts=0.5,
            likely=(0.02, 1.5),
        ),
        "kill": _kind("the process is killed: nothing is sent from then on", lasts=None),
        "disk_full": _kind("the disk is full", Cause.NOT_RECORDED),
    }
)


@dataclass(frozen=True)
class Disturbance:
    """One thing that happens to a rig: its ``kind`` in KINDS, from ``at`` s after the start for
    ``duration`` s, and the ``parameters`` of its kind; those left out take their defaults."""

    kind: str
    at: float = 0.0
    duration: float | None = None
    parameters: Mapping[str, Value] = field(default_factory=dict[str, Value])

    def __post_init__(self) -> None:
        near = difflib.get_close_matches(self.kind, KINDS, 1)
        hint = f" (did you mean {near[0]}?)" if near else ""
        require(self.kind in KINDS, "disturbance", self.kind, "one of " + ", ".join(KINDS) + hint)
        kind = KINDS[self.kind]
        at = _time(f"{self.kind}: at", self.at)
        duration = _duration(self.kind, kind, self.duration)
        for key in self.parameters:
            if key not in kind.parameters:
                raise BadInput(f"{self.kind}: key", key, _keys(kind))
        values = {
            key: parameter.read(f"{self.kind}: {key}", self.parameters.get(key, parameter.default))
            for key, parameter in kind.parameters.items()
        }
        for name, value in (("at", at), ("duration", duration), ("parameters", values)):
            object.__setattr__(self, name, value)

    @classmethod
    def parse(cls, text: str) -> "Disturbance":
        """The disturbance written as `kind:at=5,for=0.5,key=value`."""
        kind, _, rest = text.partition(":")
        given: dict[str, Value] = {}
        for item in rest.split(",") if rest else []:
            key, equals, value = (part.strip() for part in item.partition("="))
            require(
                bool(key and equals and value), f"{kind}: {item!r}", item, "of the form key=value"
            )
            require(key not in given, f"{kind}: {key}", text, "given once")
            given[key] = value
        at, duration = given.pop("at", 0.0), given.pop("for", None)
        return cls(kind.strip(), at, duration, given)  # pyright: ignore[reportArgumentType]

    def __str__(self) -> str:
        pairs: dict[str, Value] = {"at": self.at}
        if math.isfinite(self.lasts):
            pairs["for"] = self.lasts
        pairs |= self.parameters
        return f"{self.kind}:" + ",".join(
            f"{key}={_written(value)}" for key, value in pairs.items()
        )

    def number(self, name: str) -> float:
        """The parameter of this name, a number."""
        return float(self.parameters[name])

    @property
    def lasts(self) -> float:
        """How long it acts, s."""
        return math.inf if self.duration is None else self.duration

    @property
    def axis(self) -> int:
        """Which joint, from 0."""
        return int(self.number("axis")) - 1


def describe() -> str:
    """One line for each kind that a rig with pictures can suffer: how it is written, and what it
    does."""
    lines: list[str] = []
    for name, kind in KINDS.items():
        if not kind.pictures:
            continue
        keys = [
            f"{key}={_written(parameter.default)}" for key, parameter in kind.parameters.items()
        ]
        if kind.lasts is not None:
            keys.insert(0, "for" if math.isinf(kind.lasts) else f"for={kind.lasts:g}")
        usage = f"{name}:" + ",".join(["at", *keys])
        bounds = "; ".join(
            f"{key}: {parameter.right}" for key, parameter in kind.parameters.items()
        )
        lines.append(f"{usage:<40} {kind.does}{f' ({bounds})' if bounds else ''}")
    return "\n".join(lines)


def causes_of(kind: str) -> set[Cause]:
    """The causes that a person would accept as naming a disturbance of this kind, warnings
    included.

    Empty for one after which the servo says nothing any more.
    """
    return set(KINDS[kind].causes)


def random_disturbances(
    random: np.random.Generator, duration: float, pictures: bool = False
) -> list[Disturbance]:
    """One to three disturbances by chance in a run of `duration` s, for a rig with or without
    pictures."""
    names = [name for name, kind in KINDS.items() if kind.pictures or not pictures]
    chosen = random.choice(names, size=random.integers(1, 4), replace=False).tolist()
    return sorted(
        (_drawn(random, name, duration) for name in chosen), key=lambda disturbance: disturbance.at
    )


def _drawn(random: np.random.Generator, name: str, duration: float) -> Disturbance:
    kind = KINDS[name]
    lasts = None if kind.lasts is None else round(random.uniform(*kind.likely), 3)
    values = {key: parameter.draw(random) for key, parameter in kind.parameters.items()}
    return Disturbance(name, round(random.uniform(0.0, 0.9 * duration), 3), lasts, values)


def _number(value: object) -> float:
    """The value as a number; NaN where it is none."""
    try:
        return (
            float(value)
            if isinstance(value, int | float | str) and not isinstance(value, bool)
            else math.nan
        )
    except ValueError:
        return math.nan


def _time(where: str, value: object) -> float:
    number = _number(value)
    require(0.0 <= number <= LONGEST, where, value, f"a time in s from 0 to {LONGEST:g}")
    return number


def _duration(name: str, kind: Kind, value: object) -> float:
    if kind.lasts is None:
        require(
            value is None or value == math.inf,
            f"{name}: for",
            value,
            "left out: this cannot be undone",
        )
        return math.inf
    if value is None or (value == math.inf and math.isinf(kind.lasts)):
        return kind.lasts
    number = _number(value)
    require(
        0.0 < number <= LONGEST,
        f"{name}: for",
        value,
        f"a time in s above 0 and at most {LONGEST:g}",
    )
    return number


def _keys(kind: Kind) -> str:
    return "one of " + ", ".join(
        ["at", *(["for"] if kind.lasts is not None else []), *kind.parameters]
    )


def _written(value: Value) -> str:
    return value if isinstance(value, str) else f"{value:.12g}"
