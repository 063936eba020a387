"""A laboratory described in a TOML file: what the robot knows of itself, and what a simulation of
it needs.

The file's sections are the settings dataclasses, its keys their fields. Everything is checked:
unknown sections and keys, wrong types and numbers that are not finite are refused with a sentence
that names the key. (TOML itself refuses repeated keys.)
"""

import difflib
import math
import re
import tomllib
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, asdict, dataclass, field, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from rcmservo.config.files import read_small
from rcmservo.errors import BadInput, UnusableFile, one_line, told
from rcmservo.guard.gate import Gate
from rcmservo.guard.thresholds import Thresholds
from rcmservo.method.kinematics import JointLimits, Kinematics, PitchYawRcm, SphericalRcm
from rcmservo.method.tool import RigidTool, ScaledTool, Tool
from rcmservo.tracking import MarkerLook

MAX_SIZE = 64 * 1024
MAX_LINE = 1000
"""Characters of a line: a key of ten thousand parts keeps the parser busy for minutes."""

MECHANISMS = {"spherical": SphericalRcm, "pitch-yaw": PitchYawRcm}
TOOLS = {"rigid": RigidTool, "scaled": ScaledTool}
ROBOT_SECTIONS = ("mechanism", "tool", "markers", "gate", "thresholds")
SIMULATION_SECTIONS = ("camera", "drive", "look", "scene")
BARE = re.compile(r"[A-Za-z0-9_-]{1,60}")
"""A key that TOML needs no quotes for."""

Settings = TypeVar("Settings")
Table = Mapping[str, Any]


def default_markers() -> MarkerLook:
    """The built-in rig's markers: seen well on red tissue and told apart by colour."""
    return MarkerLook(colour_1="green", colour_2="blue", radius_1=3.5, radius_2=3.5)


@dataclass(frozen=True)
class Lab:
    """A laboratory: the robot's knowledge of itself, how its markers look, and the sections for a
    simulation of it."""

    mechanism: Kinematics = field(default_factory=SphericalRcm)
    tool: Tool = field(default_factory=lambda: RigidTool(spacing=30.0))
    markers: MarkerLook = field(default_factory=default_markers)
    gate: Gate = field(default_factory=Gate)
    thresholds: Thresholds = field(default_factory=Thresholds)
    simulation: Table = field(default_factory=dict[str, Any])


def load_lab(path: Path) -> Lab:
    """The laboratory in a TOML file; what the file leaves out is as in the built-in one."""
    try:
        with told_with(path):
            return _lab(_read(path))
    except RecursionError as error:
        raise UnusableFile(path, "is nested too deeply") from error


@contextmanager
def told_with(path: Path) -> Generator[None]:
    """What is wrong with a value that is used in here is told with the file that holds it."""
    try:
        yield
    except BadInput as error:
        raise BadInput(f"{path}: {error.field}", error.value, error.right) from error


def _lab(tables: Table) -> Lab:
    known = (*ROBOT_SECTIONS, *SIMULATION_SECTIONS)
    for name, table in tables.items():
        if name not in known or not isinstance(table, dict):
            raise BadInput(
                f"section {_key(name)}", table, f"one of the sections {', '.join(known)}"
            )
    default = Lab()
    gate, thresholds = tables.get("gate"), tables.get("thresholds")
    return Lab(
        mechanism=_mechanism(tables["mechanism"]) if "mechanism" in tables else default.mechanism,
        tool=_chosen(TOOLS, tables["tool"], "tool") if "tool" in tables else default.tool,
        markers=build(
            MarkerLook, {**asdict(default.markers), **tables.get("markers", {})}, "markers"
        ),
        gate=build(Gate, gate, "gate") if gate is not None else default.gate,
        thresholds=build(Thresholds, thresholds, "thresholds")
        if thresholds is not None
        else default.thresholds,
        simulation={name: tables[name] for name in SIMULATION_SECTIONS if name in tables},
    )


def _read(path: Path) -> dict[str, Any]:
    data = read_small(path, MAX_SIZE, "a rig file")
    try:
        text = data.decode()
        if max(map(len, text.split("\n"))) > MAX_LINE:
            raise UnusableFile(path, f"has a line of more than {MAX_LINE} characters")
        return tomllib.loads(text)
    except (
        ValueError
    ) as error:  # of the parser, of the encoding, and of whole numbers with thousands of digits
        raise UnusableFile(path, f"is not valid TOML: {one_line(error)}") from error


def _mechanism(table: Table) -> Kinematics:
    """[mechanism] holds the kind, the limits' ends and the insertion's zero."""
    rest = dict(table)
    ends = {key: rest.pop(key) for key in ("lower", "upper") if key in rest}
    cls = cast(type[Kinematics], MECHANISMS.get(str(rest.get("kind"))) or SphericalRcm)
    if ends:
        usual = cast(Any, cls)().limits
        rest["limits"] = build(
            JointLimits, {"lower": usual.lower, "upper": usual.upper, **ends}, "mechanism"
        )
    return _chosen(MECHANISMS, rest, "mechanism")


def _chosen(kinds: Mapping[str, type[Settings]], table: Table, where: str) -> Settings:
    """The settings of the class that the table's `kind` names."""
    rest = dict(table)
    kind = rest.pop("kind", None)
    if not isinstance(kind, str) or kind not in kinds:
        raise BadInput(f"{where}.kind", kind, "one of " + ", ".join(kinds))
    return build(kinds[kind], rest, where)


def build(cls: type[Settings], table: Table, where: str) -> Settings:
    """An instance of a settings dataclass from a table of its fields, strictly."""
    hints = get_type_hints(cls)
    names = [f.name for f in fields(cast(Any, cls))]
    for key, value in table.items():
        if key not in names:
            near = difflib.get_close_matches(key, names, 1)
            hint = f" (did you mean {near[0]}?)" if near else ""
            raise BadInput(
                f"{where}.{_key(key)}", value, f"left out or one of {', '.join(names)}{hint}"
            )
    for f in fields(cast(Any, cls)):
        if f.name not in table and f.default is MISSING and f.default_factory is MISSING:
            raise BadInput(f"{where}.{f.name}", None, "given")
    return cls(**{key: _value(hints[key], value, f"{where}.{key}") for key, value in table.items()})


def _value(hint: Any, value: Any, where: str) -> Any:
    """The value as the field's type wants it: finite numbers, tuples of the right length, one of
    the choices."""
    origin, args = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return _value(next(arg for arg in args if arg is not NoneType), value, where)
    if origin is Literal:
        return _checked(value in args, where, value, "one of " + ", ".join(map(repr, args)))
    if origin is tuple:
        good = isinstance(value, list | tuple) and len(cast(list[Any], value)) == len(args)
        items = cast(list[Any], _checked(good, where, value, f"a list of {len(args)}"))
        return tuple(
            _value(arg, item, f"{where}[{i}]")
            for i, (arg, item) in enumerate(zip(args, items, strict=True))
        )
    if hint is float:
        return float(_checked(_finite(value), where, value, "a finite number"))
    if hint is int:
        return _checked(
            isinstance(value, int) and not isinstance(value, bool), where, value, "a whole number"
        )
    if isinstance(hint, type):
        return _checked(isinstance(value, hint), where, value, f"of type {hint.__name__}")
    raise TypeError(f"{where}: a field of type {hint} cannot be read from a file")


def _checked(good: bool, where: str, value: Any, right: str) -> Any:
    if not good:
        raise BadInput(where, value, right)
    return value


def _finite(value: Any) -> bool:
    """Whether the value is a number that a float can hold."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def _key(name: str) -> str:
    """A key as a sentence tells it: quoted if it is no plain word, and not all of a long one."""
    return name if BARE.fullmatch(name) else told(name[:60])
