"""Targets on disk: what was shown, when, and by which camera, arm, tool and markers.

    {"format": "rcmservo target 1", "sha256": "…", "taught": "2026-11-21T11:30:00Z",
     "markers_px": [[u1, v1], [u2, v2]], "joints": [rad, rad, mm], "setup": {"camera": "…", "width":
     640, "height": 480, "mechanism": {…}, "tool": {…}, "markers": {…}}}

Raw pixels mean something to the setup that saw them only. A file is taken whole, by that setup, or
not at all, with the reason in one sentence. The checksum finds accidents; it is no signature.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast

import numpy as np

from rcmservo.config.files import read_small, write_whole
from rcmservo.errors import UnusableFile, one_line, told
from rcmservo.guard.thresholds import Thresholds
from rcmservo.interfaces import Floats, Target
from rcmservo.method.kinematics import Kinematics
from rcmservo.method.tool import Tool
from rcmservo.tracking import MarkerLook

FORMAT = "rcmservo target 1"
MAX_SIZE = 64 * 1024
KEYS = ("format", "sha256", "taught", "markers_px", "joints", "setup")
TAUGHT = "%Y-%m-%dT%H:%M:%SZ"


@dataclass(frozen=True)
class Setup:
    """What a target is bound to.

    ``camera`` names the camera in its place, and a place that it is brought to anew has another
    name; ``width`` and ``height`` px are those of its picture.
    """

    camera: str
    width: int
    height: int
    mechanism: Kinematics
    tool: Tool
    markers: MarkerLook


class _Wrong(ValueError):
    """Why a target is refused."""


def save(path: Path, target: Target, setup: Setup) -> None:
    """Write a target as it was shown now."""
    content = {
        "format": FORMAT,
        "taught": datetime.now(UTC).strftime(TAUGHT),
        "markers_px": target.points.tolist(),
        "joints": target.q.tolist(),
        "setup": _told(setup),
    }
    try:
        _target(content, setup)
    except _Wrong as wrong:
        raise UnusableFile(path, f"is not written: the target {wrong}") from wrong
    first = {"format": FORMAT, "sha256": checksum(content)}
    write_whole(path, json.dumps({**first, **content}, indent=1) + "\n")


def load(path: Path, setup: Setup) -> Target:
    """The target in a file, for the setup that it was shown by."""
    data = read_small(path, MAX_SIZE, "a target")
    try:
        content = _parsed(data)
        if content.get("format") != FORMAT:
            raise _Wrong(f"is not a target of this version: its format must be {FORMAT!r}")
        _keys(content, KEYS, "")
        if content.pop("sha256") != checksum(content):
            raise _Wrong("is damaged or was changed: its checksum is wrong")
        return _target(content, setup)
    except _Wrong as wrong:
        raise UnusableFile(path, str(wrong)) from wrong
    except RecursionError as error:
        raise UnusableFile(path, "is nested too deeply") from error
    except (
        ValueError
    ) as error:  # of the parser, of the encoding, and of whole numbers with thousands of digits
        raise UnusableFile(path, f"is not valid JSON: {one_line(error)}") from error


def checksum(content: Mapping[str, Any]) -> str:
    """SHA-256 of what a target's file holds beside it, in hexadecimal; the same however the file is
    laid out."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _parsed(data: bytes) -> dict[str, Any]:
    """Strict JSON: an object without repeated keys, and no numbers that are none."""

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        table = dict(pairs)
        if len(table) < len(pairs):
            key = next(key for key, count in Counter(key for key, _ in pairs).items() if count > 1)
            raise _Wrong(f"has two of the key {told(key)}")
        return table

    def number(text: str) -> float:
        value = float(text)
        if not np.isfinite(value):
            raise _Wrong(f"holds the number {text[:30]}, which is not finite")
        return value

    content: Any = json.loads(
        data.decode(), object_pairs_hook=once, parse_constant=number, parse_float=number
    )
    if not isinstance(content, dict):
        raise _Wrong("is not a target")
    return cast(dict[str, Any], content)


def _keys(table: Mapping[str, Any], wanted: tuple[str, ...], where: str) -> None:
    """Refuse a table that lacks a key, or has one more."""
    for key in wanted:
        if key not in table:
            raise _Wrong(f"lacks {where}{key}")
    for key in table:
        if key not in wanted:
            raise _Wrong(f"has the unknown key {where}{told(key)}")


def _target(content: Mapping[str, Any], setup: Setup) -> Target:
    """The target in a content, all of it checked."""
    _time(content["taught"])
    _same(content["setup"], _told(setup), "")
    rows = _list(content["markers_px"], 2, "markers_px")
    points = np.array([_numbers(row, 2, f"markers_px[{i}]") for i, row in enumerate(rows)])
    q = np.array(_numbers(content["joints"], 3, "joints"))
    for i, (u, v) in enumerate(points):
        if not (-0.5 <= u <= setup.width - 0.5 and -0.5 <= v <= setup.height - 0.5):
            raise _Wrong(
                f"has marker {i + 1} at ({u:.6g}, {v:.6g}) px, outside the picture of "
                f"{setup.width} x {setup.height} px"
            )
    _within(q, setup.mechanism)
    return Target(points, q)


def _within(q: Floats, mechanism: Kinematics) -> None:
    """Refuse joints beyond their limits, by more than one may stand beyond them."""
    lower, upper = mechanism.limits.arrays
    slack = Thresholds.slack * (upper - lower)
    for i, name in enumerate(mechanism.joint_names):
        if not lower[i] - slack[i] <= q[i] <= upper[i] + slack[i]:
            raise _Wrong(
                f"has {name} at {q[i]:.6g}, beyond its limits {lower[i]:.6g} and {upper[i]:.6g}"
            )


def _time(taught: Any) -> None:
    try:
        datetime.strptime(taught, TAUGHT)
    except (TypeError, ValueError) as error:
        raise _Wrong(
            f"was taught at {told(taught)}, which is no time like 2026-11-21T11:30:00Z"
        ) from error


def _list(value: Any, length: int, where: str) -> list[Any]:
    items = cast(list[Any], value)
    if not isinstance(value, list) or len(items) != length:
        raise _Wrong(f"must have a list of {length} as {where}, not {told(items)}")
    return items


def _numbers(value: Any, length: int, where: str) -> list[float]:
    """A list of finite numbers."""
    numbers: list[float] = []
    for item in _list(value, length, where):
        if not _number(item) or not abs(item) < 1e12:
            raise _Wrong(f"must have {length} numbers as {where}, not {told(value)}")
        numbers.append(float(item))
    return numbers


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _told(setup: Setup) -> dict[str, Any]:
    """A setup in plain words and numbers, as they come back from JSON."""
    mechanism, tool = setup.mechanism, setup.tool
    table = {
        "camera": setup.camera,
        "width": setup.width,
        "height": setup.height,
        "mechanism": {"kind": mechanism.name, **asdict(mechanism)},
        "tool": {"kind": tool.name, **asdict(cast(Any, tool))},
        "markers": asdict(setup.markers),
    }
    return json.loads(json.dumps(table))


def _same(then: Any, now: Any, where: str) -> None:
    """Refuse what was taught with another setup, naming the first value that differs and both sides
    of it."""
    if _table(then) and _table(now):
        _same_table(then, now, where)
    elif not (type(then) is type(now) or (_number(then) and _number(now))) or then != now:
        what = where or "setup"
        raise _Wrong(
            f"was taught with {what} {told(then)}, this rig has {told(now)}: show the target again"
        )


def _table(value: Any) -> bool:
    return isinstance(value, dict)


def _same_table(then: dict[str, Any], now: dict[str, Any], where: str) -> None:
    start = where + "." if where else ""
    if "kind" in then and "kind" in now:
        _same(then["kind"], now["kind"], f"{start}kind")
    _keys(then, tuple(now), f"setup.{start}")
    for key, value in now.items():
        _same(then[key], value, f"{start}{key}")
