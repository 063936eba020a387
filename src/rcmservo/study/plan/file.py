"""A study as a TOML file: what `rcmservo study FILE` reads.

    methods = ["dlt", "careful"]
    scenes = ["random", "far"]
    noise = [0.3, 1.0]

    [method.careful]
    estimator = { kind = "projection", rate = 1.0 }
    controller = { gain = 2.0 }

    [distribution.far]
    like = "random"
    scene = { distance = [250.0, 400.0] }
    vary = { "camera.delay" = [0.01, 0.05] }

Without `methods`, or `scenes`, all that the file describes are tried.
"""

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from rcmservo.config import texts
from rcmservo.config.atomic_files import read_small
from rcmservo.config.strict_decoding import decode
from rcmservo.config.texts import is_table
from rcmservo.errors import BadInput, require
from rcmservo.study.plan.conditions import StudyConditions
from rcmservo.study.plan.distribution import Distribution, chosen, distribution_from
from rcmservo.study.plan.method import Own, StudyMethod, method_from, named
from rcmservo.study.plan.plan import StudyPlan

LARGEST = 1_000_000
"""Bytes of a file."""


@dataclass(frozen=True, kw_only=True)
class StudyFile(StudyConditions):
    """A study as a file, and the command line above it, request it.

    Parameters
    ----------
    methods : tuple[str, ...] or None
        Names of what is tried; None for all of `method`.
    scenes : tuple[str, ...] or None
        Names of what scenes are drawn from; None for all of `distribution`.
    method : dict[str, Any]
        Methods of its own, by their names.
    distribution : dict[str, Any]
        Distributions of its own, by their names.
    search : dict[str, Any]
        What `rcmservo tune` searches; a study leaves it alone.
    tune : dict[str, Any]
        How it does.
    """

    methods: tuple[str, ...] | None = None
    scenes: tuple[str, ...] | None = None
    method: dict[str, Any] = field(default_factory=dict[str, Any])
    distribution: dict[str, Any] = field(default_factory=dict[str, Any])
    search: dict[str, Any] = field(default_factory=dict[str, Any])
    tune: dict[str, Any] = field(default_factory=dict[str, Any])


def load(path: Path) -> StudyFile:
    """What a file asks for."""
    data = read_small(path, LARGEST, "a study")
    with texts.reading(path, "TOML"):
        return decode(StudyFile, texts.toml(data), "study")


def plan_of(asked: StudyFile, own: Own) -> StudyPlan:
    """The plan that is asked for."""
    methods = {name: _method(name, table, own) for name, table in asked.method.items()}
    scenes: dict[str, Distribution] = {}
    for name, table in asked.distribution.items():
        require(is_table(table), f"distribution.{name}", table, "a table")
        scenes[name] = distribution_from(name, table, scenes)
    tried = asked.methods if asked.methods is not None else tuple(methods or ("dlt",))
    drawn = asked.scenes if asked.scenes is not None else tuple(scenes or ("random",))
    return StudyPlan(
        methods=tuple(methods.get(name) or named(name, own) for name in tried),
        scenes=tuple(_scenes(name, scenes) for name in drawn),
        **{f.name: getattr(asked, f.name) for f in fields(StudyConditions)},
    )


def _method(name: str, table: object, own: Own) -> StudyMethod:
    if not is_table(table):
        raise BadInput(f"method.{name}", table, "a table")
    return method_from(name, table, own)


def _scenes(name: str, known: dict[str, Distribution]) -> Distribution:
    """The distribution of a name, or a rig file's by its path."""
    if name in known or not name.endswith(".toml"):
        return chosen(name, known, "scenes", ", or a rig file")
    path = Path(name)
    data = read_small(path, LARGEST, "a rig file")
    with texts.reading(path, "TOML"):
        return distribution_from(path.stem, texts.toml(data), known)
