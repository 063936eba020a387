"""One disturbance of a rig, as a person writes it or as chance draws it.

It is written `kind:at=5,for=0.5,key=value`: it acts from `at` s after the run's start for `for` s,
or to the end.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from rcmservo.constraints import Limit, one_of
from rcmservo.errors import BadInput, require
from rcmservo.sim.disturbances.kinds import KINDS
from rcmservo.sim.disturbances.old_names import OLD, renewed
from rcmservo.sim.disturbances.parameters import Value, as_number, written

LONGEST = 1e6
"""s: no run has a time beyond this."""

PARAMETERS = Limit(lambda given: isinstance(given, Mapping), "values by the names of parameters")


@dataclass(frozen=True)
class Disturbance:
    """One thing that goes wrong with a rig. What is left out takes the kind's default."""

    kind: str
    """Its name in KINDS."""

    at: float = 0.0
    """s after the run's start."""

    duration: float | None = None
    """s for which it acts, or that it takes; inf to the end."""

    parameters: Mapping[str, Value] = field(default_factory=dict[str, Value])
    """Those of its kind, by their names."""

    def __post_init__(self) -> None:
        _require_kind(self.kind)
        PARAMETERS.require(f"{self.kind}: parameters", self.parameters)
        at, duration = _time(f"{self.kind}: at", self.at), _duration(self.kind, self.duration)
        values = _parameters(self.kind, self.parameters)
        for name, value in (("at", at), ("duration", duration), ("parameters", values)):
            object.__setattr__(self, name, value)

    @classmethod
    def parse(cls, text: str) -> "Disturbance":
        """The disturbance written as `kind:at=5,for=0.5,key=value`."""
        kind, _, rest = text.partition(":")
        require(kind.strip() not in OLD, "disturbance", kind, f"written {renewed(text)} now")
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
        """Return the disturbance of a study or a record, which may have an old name."""
        return cls.parse(renewed(text))

    def __str__(self) -> str:
        pairs: dict[str, Value] = {"at": self.at}
        if math.isfinite(self.lasts):
            pairs["for"] = self.lasts
        pairs |= self.parameters
        return f"{self.kind}:" + ",".join(f"{key}={written(pairs[key])}" for key in pairs)

    def number(self, name: str) -> float:
        """The parameter of this name, a number."""
        return float(self.parameters[name])

    @property
    def lasts(self) -> float:
        """Time for which it acts, s."""
        return math.inf if self.duration is None else self.duration

    @property
    def axis(self) -> int:
        """Which joint, from 0."""
        return int(self.number("axis")) - 1


def random_disturbances(
    random: np.random.Generator, duration: float, pictures: bool = False
) -> list[Disturbance]:
    """One to three disturbances by chance in a run of `duration` s, for a rig with or without
    pictures."""
    names = [name for name, kind in KINDS.items() if kind.pictures or not pictures]
    chosen = random.choice(names, size=random.integers(1, 4), replace=False).tolist()
    drawn = (_drawn(random, name, duration) for name in chosen)
    return sorted(drawn, key=lambda disturbance: disturbance.at)


def _drawn(random: np.random.Generator, name: str, duration: float) -> Disturbance:
    kind = KINDS[name]
    lasts = None if kind.lasts is None else round(random.uniform(*kind.likely), 3)
    if kind.lasts == 0.0 and random.uniform() < 0.5:
        lasts = 0.0
    values = {key: parameter.draw(random) for key, parameter in kind.parameters.items()}
    return Disturbance(name, round(random.uniform(0.0, 0.9 * duration), 3), lasts, values)


def _require_kind(name: str) -> None:
    if str(name) in OLD:
        raise BadInput("disturbance", name, f"written {renewed(name)} now")
    one_of(KINDS).require("disturbance", name)


def _time(where: str, value: object) -> float:
    """A time of the run as a number, s."""
    number = as_number(value)
    require(0.0 <= number <= LONGEST, where, value, f"a time in s from 0 to {LONGEST:g}")
    return number


def _duration(name: str, value: object) -> float:
    """Return the time for which a disturbance of this kind acts, s, if `value` is given; inf to
    the end."""
    where, usual = f"{name}: for", KINDS[name].lasts
    endless = isinstance(value, float) and value == math.inf
    if usual is None:
        require(value is None or endless, where, value, "left out: this cannot be undone")
        return math.inf
    if value is None or (endless and math.isinf(usual)):
        return usual
    number = as_number(value)
    if usual == 0.0:
        return _time(where, value)
    good = 0.0 < number <= LONGEST
    require(good, where, value, f"a time in s above 0 and at most {LONGEST:g}")
    return number


def _parameters(name: str, given: Mapping[str, Value]) -> dict[str, Value]:
    """All parameters of a kind: those given, and the defaults of the rest."""
    kind = KINDS[name]
    for key in given:
        if key not in kind.parameters:
            raise BadInput(f"{name}: key", key, "one of " + ", ".join(kind.keys))
    return {
        key: parameter.read(f"{name}: {key}", given.get(key, parameter.default))
        for key, parameter in kind.parameters.items()
    }
