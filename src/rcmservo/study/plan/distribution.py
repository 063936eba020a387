"""A distribution of scenes: the sections of a rig file, and which of their numbers vary from seed
to seed.

`[scene]` tells what camera, start and target are drawn from. Under `vary`, any number of the other
sections has a range that it is drawn from evenly, "drive.lag" = [0.01, 0.05] say: of the tool, of
the camera's noise, delay and lens, of encoders and drives. A list of numbers has a list at either
end. All of it comes from the seed alone.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib.resources import files
from itertools import cycle
from typing import Any, cast

import numpy as np

from rcmservo.config import texts
from rcmservo.config.rig_file import SIMULATION_SECTIONS, Lab, lab_from, told_with
from rcmservo.config.texts import Table, is_table
from rcmservo.errors import BadInput, require
from rcmservo.sim import RigSettings
from rcmservo.sim.rig_file import read_rig_settings

VARIED = ("tool", *SIMULATION_SECTIONS)
"""Sections whose numbers may vary."""

CHILD = 4
"""The child of a scene's seed that what varies is drawn from; the first four are the rig's."""

BUILT_IN = "paper", "random", "laparoscopic", "hard"
"""Those that have a name; each is a file beside this one, and says what it is."""

Pick = Callable[[float, float], float]
"""Takes one number of a range."""

Range = tuple[Any, Any]
"""Least and greatest: two numbers, or two lists of them."""


@dataclass(frozen=True)
class Distribution:
    """What the scenes of a study are drawn from.

    Parameters
    ----------
    name : str
        In rows and reports.
    tables : Table
        The sections of a rig file.
    vary : Mapping[str, Range]
        The range of every number that varies, by section.key.
    """

    name: str
    tables: Table = field(default_factory=dict[str, Any])
    vary: Mapping[str, Range] = field(default_factory=dict[str, Range])

    def __post_init__(self) -> None:
        for name, ends in self.vary.items():
            section, _, key = name.partition(".")
            known = section in VARIED and bool(key)
            right = f"section.key, with a section among {', '.join(VARIED)}"
            require(known, f"{self.name}.vary", name, right)
            _require_range(f'{self.name}.vary."{name}"', ends)
        for turns in ((min,), (max,), (min, max), (max, min)):  # ends of pairs, each with each
            pick = cycle(turns)
            self._at(lambda low, high, pick=pick: next(pick)(low, high))

    @cached_property
    def fixed(self) -> tuple[Lab, RigSettings]:
        """The laboratory in the middle of all ranges."""
        return self._at(_middle)

    def laboratory(self, seed: int) -> tuple[Lab, RigSettings]:
        """The laboratory of a seed; the robot knows its own part of it."""
        if not self.vary:
            return self.fixed
        random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(CHILD,)))
        return self._at(random.uniform, f", seed {seed}")

    def seen(self, noise: float | None, delay: float | None) -> "Distribution":
        """The same before a camera with this noise, px, and delay, s, where they are given."""
        given = {"point_noise": noise, "delay": delay}
        chosen = {key: value for key, value in given.items() if value is not None}
        camera = {**self.tables.get("camera", {}), **chosen}
        rest = {k: v for k, v in self.vary.items() if k.removeprefix("camera.") not in chosen}
        return Distribution(self.name, {**self.tables, "camera": camera}, rest)

    def _at(self, pick: Pick, where: str = "") -> tuple[Lab, RigSettings]:
        """The laboratory with a number picked from every range."""
        tables = {name: dict(table) for name, table in self.tables.items()}
        for name, (low, high) in self.vary.items():
            section, _, key = name.partition(".")
            tables.setdefault(section, {})[key] = _picked(low, high, pick)
        with told_with(f"scenes {self.name}{where}"):
            lab = lab_from(tables)
            require(not lab.devices, "sections", ", ".join(lab.devices), "of a simulation")
            return lab, read_rig_settings(lab)


def _middle(low: float, high: float) -> float:
    return 0.5 * (low + high)


def _picked(low: Any, high: Any, pick: Pick) -> Any:
    if isinstance(low, list):
        ends = zip(cast(list[Any], low), high, strict=True)
        return [_picked(a, b, pick) for a, b in ends]
    return float(pick(low, high))


def _require_range(where: str, ends: object) -> None:
    right = "two finite numbers, least first, or two lists of them"
    try:
        numbers = np.array(ends, np.float64)
    except (TypeError, ValueError) as error:
        raise BadInput(where, ends, right) from error
    good = numbers.ndim >= 1 and len(numbers) == 2 and np.isfinite(numbers).all()
    require(bool(good and (numbers[0] <= numbers[1]).all()), where, ends, right)


def built_in(name: str) -> Distribution:
    """The distribution of this name."""
    return distribution_from(name, texts.toml(_text(name).encode()), {})


def described() -> Iterator[tuple[str, str]]:
    """The name of every built-in distribution, and what it is."""
    for name in BUILT_IN:
        lines = _text(name).splitlines()
        about = [line.lstrip("# ") for line in lines[: next(_first(lines), len(lines))]]
        yield name, " ".join(about)


def _first(lines: list[str]) -> Iterator[int]:
    return (i for i, line in enumerate(lines) if not line.startswith("#"))


def _text(name: str) -> str:
    return (files("rcmservo.study.plan") / "scenes" / f"{name}.toml").read_text("utf-8")


def distribution_from(name: str, table: Table, known: Mapping[str, Distribution]) -> Distribution:
    """The distribution in a table: sections of a rig file, `vary`, and `like`, the name of one
    whose sections and ranges it takes over where it has none of its own.
    """
    own = dict(table)
    like, vary = own.pop("like", None), own.pop("vary", {})
    require(is_table(vary), f"{name}.vary", vary, "a table of ranges")
    for section, value in own.items():
        require(is_table(value), f"{name}.{section}", value, "a section of a rig file")
    if like is None:
        return Distribution(name, own, vary)
    base = chosen(str(like), known, f"{name}.like")
    sections = dict.fromkeys((*base.tables, *own))
    tables = {key: {**base.tables.get(key, {}), **own.get(key, {})} for key in sections}
    fixed = {f"{section}.{key}" for section, keys in own.items() for key in keys}
    varied = {key: ends for key, ends in base.vary.items() if key not in fixed}
    return Distribution(name, tables, {**varied, **vary})


def chosen(
    name: str, known: Mapping[str, Distribution], where: str, beside: str = ""
) -> Distribution:
    """The distribution of a name: one that is `known`, or a built-in one. What could be named
    `beside` these is for who named another one.
    """
    if name in known:
        return known[name]
    names = ", ".join(dict.fromkeys((*known, *BUILT_IN)))
    require(name in BUILT_IN, where, name, f"one of {names}{beside}")
    return built_in(name)
