"""Study files: TOML that `rcmservo study FILE` reads.

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

Without `methods` the study compares all methods of the file; without `scenes` it uses all
distributions of the file.
"""

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from rcmservo.config import toml_json_parsing
from rcmservo.config.atomic_files import read_limited
from rcmservo.config.strict_decoding import decode_settings
from rcmservo.config.toml_json_parsing import is_table
from rcmservo.errors import require
from rcmservo.study.plan.conditions import StudyConditions
from rcmservo.study.plan.distribution import Distribution, find_distribution, parse_distribution
from rcmservo.study.plan.method import UserEstimators, make_default_method, parse_method
from rcmservo.study.plan.plan import StudyPlan

MAX_STUDY_FILE_BYTES = 1_000_000
"""Largest size of a study file, bytes."""


@dataclass(frozen=True, kw_only=True)
class StudyFile(StudyConditions):
    """Content of a study file, with the options of the command line in place of its settings.

    Parameters
    ----------
    methods : tuple[str, ...] or None
        Names of the methods to compare; None for all of `method`.
    scenes : tuple[str, ...] or None
        Names of the distributions of scenes; None for all of `distribution`.
    method : dict[str, Any]
        Methods that the file defines, by name.
    distribution : dict[str, Any]
        Distributions that the file defines, by name.
    search : dict[str, Any]
        Settings that `rcmservo tune` searches; a study ignores them.
    tune : dict[str, Any]
        Length and goal of that search.
    """

    methods: tuple[str, ...] | None = None
    scenes: tuple[str, ...] | None = None
    method: dict[str, Any] = field(default_factory=dict[str, Any])
    distribution: dict[str, Any] = field(default_factory=dict[str, Any])
    search: dict[str, Any] = field(default_factory=dict[str, Any])
    tune: dict[str, Any] = field(default_factory=dict[str, Any])


def read_study_file(path: Path) -> StudyFile:
    """Read a study file."""
    content = read_limited(path, MAX_STUDY_FILE_BYTES, "a study")
    with toml_json_parsing.name_file_in_errors(path, "TOML"):
        return decode_settings(StudyFile, toml_json_parsing.parse_toml(content), "study")


def make_plan(request: StudyFile, estimators: UserEstimators) -> StudyPlan:
    """Return the plan of a study file, with the user-defined `estimators` by name."""
    for section in ("method", "distribution"):
        for name, table in getattr(request, section).items():
            require(is_table(table), f"{section}.{name}", table, "a table")
    method_tables = request.method.items()
    methods = {name: parse_method(name, table, estimators) for name, table in method_tables}
    distributions: dict[str, Distribution] = {}
    for name, table in request.distribution.items():
        distributions[name] = parse_distribution(name, table, distributions)
    method_names = request.methods if request.methods is not None else tuple(methods or ("dlt",))
    scenes = request.scenes if request.scenes is not None else tuple(distributions or ("random",))
    return StudyPlan(
        methods=tuple(methods.get(n) or make_default_method(n, estimators) for n in method_names),
        scenes=tuple(_find_or_read_distribution(name, distributions) for name in scenes),
        **{f.name: getattr(request, f.name) for f in fields(StudyConditions)},
    )


def _find_or_read_distribution(name: str, distributions: dict[str, Distribution]) -> Distribution:
    """Return the distribution with a name, or that of a rig file by its path."""
    if name in distributions or not name.endswith(".toml"):
        return find_distribution(name, distributions, "scenes", ", or a rig file")
    path = Path(name)
    content = read_limited(path, MAX_STUDY_FILE_BYTES, "a rig file")
    with toml_json_parsing.name_file_in_errors(path, "TOML"):
        return parse_distribution(path.stem, toml_json_parsing.parse_toml(content), distributions)
