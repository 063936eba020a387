"""Distribution of scenes: the sections of a rig file, and ranges of numbers that vary by seed.

The section `[scene]` describes the distribution of camera, start and target. The table `vary` gives
a number of any other section a range, from which each seed draws a uniform value, for example
"drive.lag" = [0.01, 0.05]: of the tool, of the camera's noise, delay and lens, of encoders and
drives. A list of numbers has a list at both ends of its range. All values follow from the seed.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib.resources import files
from itertools import cycle, takewhile
from typing import Any, cast

import numpy as np

from rcmservo.config import toml_json_parsing
from rcmservo.config.rig_file import (
    SIMULATION_SECTIONS,
    RigDescription,
    decode_rig_tables,
    name_origin_in_errors,
)
from rcmservo.config.toml_json_parsing import Table, is_table
from rcmservo.errors import BadInput, require
from rcmservo.sim import RigSettings
from rcmservo.sim.rig_file import read_rig_settings

VARIABLE_SECTIONS = ("tool", *SIMULATION_SECTIONS)
"""Sections of a rig file whose numbers may vary."""

VARIATION_SEED_CHILD = 4
"""Index of the seed's child that varying numbers are drawn from; the rig uses 0 to 3."""

BUILT_IN_DISTRIBUTIONS = "paper", "random", "laparoscopic", "hard"
"""Names of the built-in distributions: files in `scenes/` that begin with their description."""

Picker = Callable[[float, float], float]
"""Function that picks one number from a range."""

Range = tuple[Any, Any]
"""Lower and upper end: two numbers, or two lists of them."""


@dataclass(frozen=True)
class Distribution:
    """Distribution that the scenes of a study are drawn from.

    Parameters
    ----------
    name : str
        Name in rows and reports.
    tables : Table
        Sections of a rig file.
    vary : Mapping[str, Range]
        Range of every number that varies, by section.key.
    """

    name: str
    tables: Table = field(default_factory=dict[str, Any])
    vary: Mapping[str, Range] = field(default_factory=dict[str, Range])

    def __post_init__(self) -> None:
        for name, ends in self.vary.items():
            section, _, key = name.partition(".")
            known = section in VARIABLE_SECTIONS and bool(key)
            expected = f"section.key, with a section among {', '.join(VARIABLE_SECTIONS)}"
            require(known, f"{self.name}.vary", name, expected)
            _require_range(f'{self.name}.vary."{name}"', ends)
        # Check every combination of the ends of a pair of numbers.
        for choices in ((min,), (max,), (min, max), (max, min)):
            pick = cycle(choices)
            self._at(lambda low, high, pick=pick: next(pick)(low, high))

    @cached_property
    def nominal(self) -> tuple[RigDescription, RigSettings]:
        """Laboratory with the middle of all ranges."""
        return self._at(_middle)

    def draw(self, seed: int) -> tuple[RigDescription, RigSettings]:
        """Draw the laboratory of a seed: the part that the robot knows, and the simulated rig."""
        if not self.vary:
            return self.nominal
        random = np.random.default_rng(
            np.random.SeedSequence(seed, spawn_key=(VARIATION_SEED_CHILD,))
        )
        return self._at(random.uniform, f", seed {seed}")

    def with_camera(self, noise: float | None, delay: float | None) -> "Distribution":
        """Return the distribution with this camera noise (px) and delay (s); None keeps its own."""
        given = {"point_noise": noise, "delay": delay}
        fixed = {key: value for key, value in given.items() if value is not None}
        camera = {**self.tables.get("camera", {}), **fixed}
        vary = {k: v for k, v in self.vary.items() if k.removeprefix("camera.") not in fixed}
        return Distribution(self.name, {**self.tables, "camera": camera}, vary)

    def _at(self, pick: Picker, where: str = "") -> tuple[RigDescription, RigSettings]:
        """Return the laboratory with the number that `pick` takes from every range."""
        tables = {name: dict(table) for name, table in self.tables.items()}
        for name, (low, high) in self.vary.items():
            section, _, key = name.partition(".")
            tables.setdefault(section, {})[key] = _pick(low, high, pick)
        with name_origin_in_errors(f"scenes {self.name}{where}"):
            lab = decode_rig_tables(tables)
            require(not lab.devices, "sections", ", ".join(lab.devices), "of a simulation")
            return lab, read_rig_settings(lab)


def _middle(low: float, high: float) -> float:
    return 0.5 * (low + high)


def _pick(low: Any, high: Any, pick: Picker) -> Any:
    if isinstance(low, list):
        ends = zip(cast(list[Any], low), high, strict=True)
        return [_pick(a, b, pick) for a, b in ends]
    return float(pick(low, high))


def _require_range(where: str, ends: object) -> None:
    expected = "two finite numbers, least first, or two lists of them"
    try:
        numbers = np.array(ends, np.float64)
    except (TypeError, ValueError) as error:
        raise BadInput(where, ends, expected) from error
    is_pair = numbers.ndim >= 1 and len(numbers) == 2 and np.isfinite(numbers).all()
    require(bool(is_pair and (numbers[0] <= numbers[1]).all()), where, ends, expected)


def load_built_in(name: str) -> Distribution:
    """Return the built-in distribution with this name."""
    return parse_distribution(name, toml_json_parsing.parse_toml(_text(name).encode()), {})


def describe_built_in() -> Iterator[tuple[str, str]]:
    """Yield name and description of every built-in distribution."""
    for name in BUILT_IN_DISTRIBUTIONS:
        lines = _text(name).splitlines()
        yield name, " ".join(line.lstrip("# ") for line in takewhile(_is_comment, lines))


def _is_comment(line: str) -> bool:
    return line.startswith("#")


def _text(name: str) -> str:
    return (files("rcmservo.study.plan") / "scenes" / f"{name}.toml").read_text("utf-8")


def parse_distribution(name: str, table: Table, known: Mapping[str, Distribution]) -> Distribution:
    """Return the distribution that a table describes.

    Parameters
    ----------
    name : str
        Name in rows and reports.
    table : Table
        Sections of a rig file, `vary` with its ranges, and `like`: the name of another distribution
        whose sections and ranges it takes where it has none of its own.
    known : Mapping[str, Distribution]
        Distributions that `like` may name, in addition to the built-in ones.
    """
    own = dict(table)
    like, vary = own.pop("like", None), own.pop("vary", {})
    require(is_table(vary), f"{name}.vary", vary, "a table of ranges")
    for section, value in own.items():
        require(is_table(value), f"{name}.{section}", value, "a section of a rig file")
    if like is None:
        return Distribution(name, own, vary)
    base = find_distribution(str(like), known, f"{name}.like")
    sections = dict.fromkeys((*base.tables, *own))
    tables = {key: {**base.tables.get(key, {}), **own.get(key, {})} for key in sections}
    fixed = {f"{section}.{key}" for section, keys in own.items() for key in keys}
    varied = {key: ends for key, ends in base.vary.items() if key not in fixed}
    return Distribution(name, tables, {**varied, **vary})


def find_distribution(
    name: str, known: Mapping[str, Distribution], where: str, alternatives: str = ""
) -> Distribution:
    """Return the known or built-in distribution with this name.

    Parameters
    ----------
    name : str
        Name of the distribution.
    known : Mapping[str, Distribution]
        Distributions of the study.
    where : str
        Field that an error message names.
    alternatives : str
        Further valid entries of that field, for the error message.

    Raises
    ------
    BadInput
        If no distribution has this name.
    """
    if name in known:
        return known[name]
    names = ", ".join(dict.fromkeys((*known, *BUILT_IN_DISTRIBUTIONS)))
    require(name in BUILT_IN_DISTRIBUTIONS, where, name, f"one of {names}{alternatives}")
    return load_built_in(name)
