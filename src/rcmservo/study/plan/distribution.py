"""Distribution of scenes: the sections of a rig file, and ranges of numbers that vary by seed.

The section `[scene]` describes the distribution of camera, start and target. The table `vary` gives
a number of any other section a range, from which each seed draws a uniform value, for example
"drive.lag" = [0.01, 0.05]: of the tool, of the camera's noise, delay and lens, of encoders and
drives. A list of numbers has a list at both ends of its range. All values follow from the seed.

To add a built-in distribution: write a TOML file in scenes/ that begins with its description as a
comment, and add its name to `BUILT_IN_DISTRIBUTIONS`.
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
from rcmservo.sim.imperfections import ARMS
from rcmservo.sim.rig_file import read_rig_settings

VARIABLE_SECTIONS = ("tool", *SIMULATION_SECTIONS)
"""Sections of a rig file whose numbers may vary."""

VARIATION_SEED_CHILD = 4
"""Child of the seed that varying numbers are drawn from; the rig uses the children 0 to 3."""

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
            is_known = section in VARIABLE_SECTIONS and bool(key)
            expected = f"section.key, with a section among {', '.join(VARIABLE_SECTIONS)}"
            require(is_known, f"{self.name}.vary", name, expected)
            _require_range(f'{self.name}.vary."{name}"', ends)
        # decode the laboratory with every combination of the ends of a pair of numbers
        for choices in ((min,), (max,), (min, max), (max, min)):
            pick_end = cycle(choices)
            self._decode_lab(lambda low, high, pick_end=pick_end: next(pick_end)(low, high))

    @cached_property
    def nominal(self) -> tuple[RigDescription, RigSettings]:
        """Laboratory with the middle of all ranges."""
        return self._decode_lab(lambda low, high: 0.5 * (low + high))

    def draw(self, seed: int) -> tuple[RigDescription, RigSettings]:
        """Draw the laboratory of a seed: the part that the robot knows, and the simulated rig."""
        if not self.vary:
            return self.nominal
        child_seed = np.random.SeedSequence(seed, spawn_key=(VARIATION_SEED_CHILD,))
        return self._decode_lab(np.random.default_rng(child_seed).uniform, f", seed {seed}")

    def with_camera(self, noise: float | None, delay: float | None) -> "Distribution":
        """Return the distribution with this camera noise (px) and delay (s); None keeps its own."""
        requested = {"point_noise": noise, "delay": delay}
        fixed = {key: value for key, value in requested.items() if value is not None}
        camera = {**self.tables.get("camera", {}), **fixed}
        vary = {k: ends for k, ends in self.vary.items() if k.removeprefix("camera.") not in fixed}
        return Distribution(self.name, {**self.tables, "camera": camera}, vary)

    def with_arm(self, arm: str) -> "Distribution":
        """Return the distribution with an arm of this quality, one of `ARMS`."""
        is_free = not ARMS[arm] or "imperfections" not in self.tables
        expected = f"ideal: the scenes {self.name} have imperfections of their own"
        require(is_free, "arm", arm, expected)
        tables = {
            section: {**self.tables.get(section, {}), **content}
            for section, content in ARMS[arm].items()
        }
        return Distribution(self.name, {**self.tables, **tables}, self.vary)

    def _decode_lab(self, pick: Picker, origin: str = "") -> tuple[RigDescription, RigSettings]:
        """Return the laboratory with the number that `pick` takes from every range.

        Error messages name the distribution, followed by the text `origin`.
        """
        tables = {name: dict(table) for name, table in self.tables.items()}
        for name, (low, high) in self.vary.items():
            section, _, key = name.partition(".")
            tables.setdefault(section, {})[key] = _pick_numbers(low, high, pick)
        with name_origin_in_errors(f"scenes {self.name}{origin}"):
            lab = decode_rig_tables(tables)
            require(not lab.devices, "sections", ", ".join(lab.devices), "of a simulation")
            return lab, read_rig_settings(lab)


def _pick_numbers(low: Any, high: Any, pick: Picker) -> Any:
    """Return a number from a range, or a list of numbers from a range of lists."""
    if isinstance(low, list):
        ranges = zip(cast(list[Any], low), high, strict=True)
        return [_pick_numbers(*ends, pick) for ends in ranges]
    return float(pick(low, high))


def _require_range(field_name: str, ends: object) -> None:
    """Raise `BadInput`, naming the field, unless the ends are a valid `Range`."""
    expected = "two finite numbers, least first, or two lists of them"
    try:
        numbers = np.array(ends, np.float64)
    except (TypeError, ValueError) as error:
        raise BadInput(field_name, ends, expected) from error
    is_pair = numbers.ndim >= 1 and len(numbers) == 2 and np.isfinite(numbers).all()
    is_range = bool(is_pair and (numbers[0] <= numbers[1]).all())
    require(is_range, field_name, ends, expected)


def load_built_in(name: str) -> Distribution:
    """Return the built-in distribution with this name."""
    return parse_distribution(name, toml_json_parsing.parse_toml(_read_built_in(name).encode()), {})


def describe_built_in() -> Iterator[tuple[str, str]]:
    """Yield name and description of every built-in distribution."""
    for name in BUILT_IN_DISTRIBUTIONS:
        lines = _read_built_in(name).splitlines()
        comment = takewhile(lambda line: line.startswith("#"), lines)
        yield name, " ".join(line.lstrip("# ") for line in comment)


def _read_built_in(name: str) -> str:
    return (files("rcmservo.study.plan") / "scenes" / f"{name}.toml").read_text("utf-8")


def parse_distribution(
    name: str, table: Table, distributions: Mapping[str, Distribution]
) -> Distribution:
    """Return the distribution that a table describes.

    Parameters
    ----------
    name : str
        Name in rows and reports.
    table : Table
        Sections of a rig file, `vary` with its ranges, and `like`: the name of another distribution
        whose sections and ranges it takes where it has none of its own.
    distributions : Mapping[str, Distribution]
        Distributions that `like` may name, in addition to the built-in ones.
    """
    sections = dict(table)
    like, vary = sections.pop("like", None), sections.pop("vary", {})
    require(is_table(vary), f"{name}.vary", vary, "a table of ranges")
    for section, content in sections.items():
        require(is_table(content), f"{name}.{section}", content, "a section of a rig file")
    if like is None:
        return Distribution(name, sections, vary)
    base = find_distribution(str(like), distributions, f"{name}.like")
    names = dict.fromkeys((*base.tables, *sections))
    tables = {key: {**base.tables.get(key, {}), **sections.get(key, {})} for key in names}
    fixed = {f"{section}.{key}" for section, content in sections.items() for key in content}
    inherited = {key: ends for key, ends in base.vary.items() if key not in fixed}
    return Distribution(name, tables, {**inherited, **vary})


def find_distribution(
    name: str, distributions: Mapping[str, Distribution], field_name: str, alternatives: str = ""
) -> Distribution:
    """Return the distributions or built-in distribution with this name.

    Parameters
    ----------
    name : str
        Name of the distribution.
    distributions : Mapping[str, Distribution]
        Distributions of the study.
    field_name : str
        Field that an error message names.
    alternatives : str
        Further valid entries of that field, for the error message.

    Raises
    ------
    BadInput
        If no distribution has this name.
    """
    if name in distributions:
        return distributions[name]
    names = ", ".join(dict.fromkeys((*distributions, *BUILT_IN_DISTRIBUTIONS)))
    require(name in BUILT_IN_DISTRIBUTIONS, field_name, name, f"one of {names}{alternatives}")
    return load_built_in(name)
