"""Disturbance of a simulated laboratory: its text form, its checks and random samples.

The text form is ``kind:at=5,for=0.5,key=value``. The disturbance acts from `at` s after the start
of the run for `for` s, or to the end of the run. disturbance_kinds.py lists the kinds with their
keys.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from rcmservo.constraints import Limit, one_of
from rcmservo.errors import require
from rcmservo.sim.disturbances.disturbance_kinds import DISTURBANCE_KINDS
from rcmservo.sim.disturbances.old_names import OLD_NAMES, translate_old_name
from rcmservo.sim.disturbances.parameters import Value, format_value, to_number

MAX_TIME_S = 1e6
"""Upper limit of the times of a run, s."""

PARAMETERS_LIMIT = Limit(lambda given: isinstance(given, Mapping), "values by names of parameters")


@dataclass(frozen=True)
class Disturbance:
    """Fault of a simulated laboratory. Omitted values take the defaults of its kind.

    Parameters
    ----------
    kind : str
        Name of the kind, as in the docstring of `rcmservo.sim`; ``rcmservo run --disturb help``
        lists them with their parameters.
    at : float
        Start, s after the start of the run; from 0 to 1e6.
    duration : float or None
        Duration (s) of the disturbance or of the motion that it makes, from 0 to 1e6; inf lasts to
        the end of the run. None takes the default of the kind.
    parameters : Mapping[str, Value]
        Parameters of the kind, by name: numbers or words.

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
        _require_kind(self.kind, str(self.kind))
        PARAMETERS_LIMIT.require(f"{self.kind}: parameters", self.parameters)
        checked = {
            "at": _read_time(f"{self.kind}: at", self.at),
            "duration": _read_duration(self.kind, self.duration),
            "parameters": _read_parameters(self.kind, self.parameters),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    @classmethod
    def parse(cls, text: str) -> "Disturbance":
        """Return the disturbance of a text.

        Parameters
        ----------
        text : str
            Kind, times (s) and parameters: ``kind:at=5,for=0.5,key=value``.

        Raises
        ------
        BadInput
            If the text has another form, or a kind has its name of an earlier version.
        """
        kind, _, items = text.partition(":")
        _require_kind(kind.strip(), text)
        values: dict[str, Value] = {}
        for item in items.split(",") if items else []:
            key, equals, value = (part.strip() for part in item.partition("="))
            is_pair = bool(key and equals and value)
            require(is_pair, f"{kind}: {item!r}", item, "of the form key=value")
            require(key not in values, f"{kind}: {key}", text, "given once")
            values[key] = value
        at, duration = values.pop("at", 0.0), values.pop("for", None)
        return cls(kind.strip(), at, duration, values)  # pyright: ignore[reportArgumentType]

    @classmethod
    def read(cls, text: str) -> "Disturbance":
        """Return the disturbance of a study or a record, which earlier versions may have written.

        Parameters
        ----------
        text : str
            Text as of `parse`, with the present or a former name of its kind.

        Raises
        ------
        BadInput
            If the text has another form.
        """
        return cls.parse(translate_old_name(text))

    def __str__(self) -> str:
        duration = {"for": self.duration_s} if math.isfinite(self.duration_s) else {}
        pairs = {"at": self.at, **duration, **self.parameters}
        return f"{self.kind}:" + ",".join(f"{key}={format_value(pairs[key])}" for key in pairs)

    def number(self, name: str) -> float:
        """Return the parameter `name`, a number."""
        return float(self.parameters[name])

    @property
    def duration_s(self) -> float:
        """Duration, s; inf lasts to the end of the run."""
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
    names = [
        name for name, kind in DISTURBANCE_KINDS.items() if kind.works_with_images or not pictures
    ]
    chosen_names = random.choice(names, size=random.integers(1, 4), replace=False).tolist()
    sampled = (_sample_disturbance(random, name, duration) for name in chosen_names)
    return sorted(sampled, key=lambda disturbance: disturbance.at)


def _sample_disturbance(random: np.random.Generator, name: str, run_length: float) -> Disturbance:
    """Return a random disturbance of a kind in a run of `run_length` s."""
    kind = DISTURBANCE_KINDS[name]
    duration = None
    if kind.default_duration is not None:
        duration = round(random.uniform(*kind.sampled_duration), 3)
    if kind.default_duration == 0.0 and random.uniform() < 0.5:
        duration = 0.0
    values = {key: parameter.sample(random) for key, parameter in kind.parameters.items()}
    return Disturbance(name, round(random.uniform(0.0, 0.9 * run_length), 3), duration, values)


def _require_kind(name: str, text: str) -> None:
    """Raise `BadInput` unless `name` is a kind; `text` is what the user wrote."""
    is_present = str(name) not in OLD_NAMES
    require(is_present, "disturbance", name, f"written {translate_old_name(text)} now")
    one_of(DISTURBANCE_KINDS).require("disturbance", name)


def _read_time(field_name: str, value: object) -> float:
    """Return a time (s) of the run as a number."""
    time_s = to_number(value)
    expected = f"a time in s from 0 to {MAX_TIME_S:g}"
    require(0.0 <= time_s <= MAX_TIME_S, field_name, value, expected)
    return time_s


def _read_duration(kind: str, value: object) -> float:
    """Return the duration (s) of a disturbance; inf lasts to the end of the run."""
    field_name, default = f"{kind}: for", DISTURBANCE_KINDS[kind].default_duration
    is_endless = isinstance(value, float) and value == math.inf
    if default is None:
        is_omitted = value is None or is_endless
        require(is_omitted, field_name, value, "left out: this cannot be undone")
        return math.inf
    if value is None or (is_endless and math.isinf(default)):
        return default
    if default == 0.0:
        return _read_time(field_name, value)
    duration_s = to_number(value)
    is_valid = 0.0 < duration_s <= MAX_TIME_S
    require(is_valid, field_name, value, f"a time in s above 0 and at most {MAX_TIME_S:g}")
    return duration_s


def _read_parameters(kind: str, given: Mapping[str, Value]) -> dict[str, Value]:
    """Return all parameters of a kind: the given ones, and the defaults of the others."""
    parameters = DISTURBANCE_KINDS[kind].parameters
    for key in given:
        expected = "one of " + ", ".join(DISTURBANCE_KINDS[kind].keys)
        require(key in parameters, f"{kind}: key", key, expected)
    return {
        key: parameter.read(f"{kind}: {key}", given.get(key, parameter.default))
        for key, parameter in parameters.items()
    }
