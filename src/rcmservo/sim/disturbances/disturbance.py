"""Disturbance of a rig: its text form, its checks and random ones.

Its text is `kind:at=5,for=0.5,key=value`: it acts from `at` s after the run's start for `for` s, or
to the end of the run.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from rcmservo.constraints import Limit, one_of
from rcmservo.errors import BadInput, require
from rcmservo.sim.disturbances.kinds import DISTURBANCE_KINDS
from rcmservo.sim.disturbances.old_names import OLD_NAMES, translate_old_name
from rcmservo.sim.disturbances.parameters import Value, format_value, to_number

MAX_TIME_S = 1e6
"""Upper limit of the times of a run, s."""

PARAMETERS_LIMIT = Limit(
    lambda given: isinstance(given, Mapping), "values by the names of parameters"
)


@dataclass(frozen=True)
class Disturbance:
    """Fault of a simulated laboratory. Omitted values take the kind's defaults.

    Parameters
    ----------
    kind : str
        Name in `DISTURBANCE_KINDS`.
    at : float
        Start, s after the start of the run.
    duration : float or None
        Duration (s) of the disturbance or of the motion that it makes; inf lasts to the end of the
        run.
    parameters : Mapping[str, Value]
        Parameters of its kind, by name.

    Raises
    ------
    BadInput
        If the kind is unknown or a value is outside its range.
    """

    kind: str

    at: float = 0.0

    duration: float | None = None

    parameters: Mapping[str, Value] = field(default_factory=dict[str, Value])

    def __post_init__(self) -> None:
        _require_kind(self.kind)
        PARAMETERS_LIMIT.require(f"{self.kind}: parameters", self.parameters)
        at, duration = (
            _read_time(f"{self.kind}: at", self.at),
            _read_duration(self.kind, self.duration),
        )
        values = _read_parameters(self.kind, self.parameters)
        for name, value in (("at", at), ("duration", duration), ("parameters", values)):
            object.__setattr__(self, name, value)

    @classmethod
    def parse(cls, text: str) -> "Disturbance":
        """Return the disturbance of a text.

        Parameters
        ----------
        text : str
            Kind, times (s) and parameters: `kind:at=5,for=0.5,key=value`.

        Raises
        ------
        BadInput
            If the text has another form, or names a kind as earlier versions did.
        """
        kind, _, rest = text.partition(":")
        require(
            kind.strip() not in OLD_NAMES,
            "disturbance",
            kind,
            f"written {translate_old_name(text)} now",
        )
        given: dict[str, Value] = {}
        for item in rest.split(",") if rest else []:
            key, equals, value = (part.strip() for part in item.partition("="))
            pair = bool(key and equals and value)
            require(pair, f"{kind}: {item!r}", item, "of the form key=value")
            require(key not in given, f"{kind}: {key}", text, "given once")
            given[key] = value
        at, duration = given.pop("at", 0.0), given.pop("for", None)
        return cls(kind.strip(), at, duration, given)  # pyright: ignore[reportArgumentType]

    @classmethod
    def read(cls, text: str) -> "Disturbance":
        """Return the disturbance of a study or a record, whose kind may have an old name.

        Parameters
        ----------
        text : str
            Text as of `parse`, in the spelling of any version.
        """
        return cls.parse(translate_old_name(text))

    def __str__(self) -> str:
        pairs: dict[str, Value] = {"at": self.at}
        if math.isfinite(self.duration_s):
            pairs["for"] = self.duration_s
        pairs |= self.parameters
        return f"{self.kind}:" + ",".join(f"{key}={format_value(pairs[key])}" for key in pairs)

    def number(self, name: str) -> float:
        """Return the parameter `name`, a number."""
        return float(self.parameters[name])

    @property
    def duration_s(self) -> float:
        """Duration, s."""
        return math.inf if self.duration is None else self.duration

    @property
    def axis(self) -> int:
        """Index of the joint that it concerns, from 0."""
        return int(self.number("axis")) - 1


def sample_disturbances(
    random: np.random.Generator, duration: float, pictures: bool = False
) -> list[Disturbance]:
    """Return one to three random disturbances, in order of their start.

    Parameters
    ----------
    random : numpy.random.Generator
        Generator of random numbers.
    duration : float
        Length of the run, s.
    pictures : bool
        True if the rig's camera has images.
    """
    names = [name for name, kind in DISTURBANCE_KINDS.items() if kind.pictures or not pictures]
    chosen = random.choice(names, size=random.integers(1, 4), replace=False).tolist()
    sampled = (_sample(random, name, duration) for name in chosen)
    return sorted(sampled, key=lambda disturbance: disturbance.at)


def _sample(random: np.random.Generator, name: str, duration: float) -> Disturbance:
    kind = DISTURBANCE_KINDS[name]
    lasts = (
        None if kind.default_duration is None else round(random.uniform(*kind.sampled_duration), 3)
    )
    if kind.default_duration == 0.0 and random.uniform() < 0.5:
        lasts = 0.0
    values = {key: parameter.sample(random) for key, parameter in kind.parameters.items()}
    return Disturbance(name, round(random.uniform(0.0, 0.9 * duration), 3), lasts, values)


def _require_kind(name: str) -> None:
    if str(name) in OLD_NAMES:
        raise BadInput("disturbance", name, f"written {translate_old_name(name)} now")
    one_of(DISTURBANCE_KINDS).require("disturbance", name)


def _read_time(where: str, value: object) -> float:
    """Return a time (s) of the run as a number."""
    number = to_number(value)
    require(0.0 <= number <= MAX_TIME_S, where, value, f"a time in s from 0 to {MAX_TIME_S:g}")
    return number


def _read_duration(name: str, value: object) -> float:
    """Return the duration (s) of a disturbance of a kind; inf lasts to the end of the run."""
    where, default = f"{name}: for", DISTURBANCE_KINDS[name].default_duration
    endless = isinstance(value, float) and value == math.inf
    if default is None:
        require(value is None or endless, where, value, "left out: this cannot be undone")
        return math.inf
    if value is None or (endless and math.isinf(default)):
        return default
    number = to_number(value)
    if default == 0.0:
        return _read_time(where, value)
    valid = 0.0 < number <= MAX_TIME_S
    require(valid, where, value, f"a time in s above 0 and at most {MAX_TIME_S:g}")
    return number


def _read_parameters(name: str, given: Mapping[str, Value]) -> dict[str, Value]:
    """Return all parameters of a kind: the given ones, and the defaults of the others."""
    kind = DISTURBANCE_KINDS[name]
    for key in given:
        if key not in kind.parameters:
            raise BadInput(f"{name}: key", key, "one of " + ", ".join(kind.keys))
    return {
        key: parameter.read(f"{name}: {key}", given.get(key, parameter.default))
        for key, parameter in kind.parameters.items()
    }
