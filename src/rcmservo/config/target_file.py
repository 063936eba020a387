"""Targets on disk: what was shown, when, and by which camera, arm, tool and markers.

    {"format": "rcmservo target 1", "sha256": "…", "taught": "2026-11-21T11:30:00Z",
     "markers_px": [[u1, v1], [u2, v2]], "sizes_px": [R1, R2], "joints": [rad, rad, mm], "setup":
     {"camera": "…", "width": 640, "height": 480, "mechanism": {…}, "tool": {…}, "markers": {…}}}

Raw pixels mean something to the setup that saw them only. A file is taken whole, by that setup, or
not at all, with the reason in one sentence. The checksum finds accidents; it is no signature.
"""

import hashlib
import json
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.config import texts
from rcmservo.config.atomic_files import read_small, write_whole
from rcmservo.config.strict_decoding import decode
from rcmservo.errors import BadInput, UnusableFile, one_line, quoted, require
from rcmservo.geometry.kinematics import Kinematics
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Target
from rcmservo.safety.thresholds import Thresholds
from rcmservo.tracking import MarkerAppearance

FORMAT = "rcmservo target 1"
MAX_SIZE = 64 * 1024
TAUGHT = "%Y-%m-%dT%H:%M:%SZ"


@dataclass(frozen=True)
class Setup:
    """What a target is bound to.

    Parameters
    ----------
    camera : str
        Names the camera in its place. A place that it is brought to anew has another name.
    width : int
        Of its picture, px.
    height : int
        Of its picture, px.
    mechanism : Kinematics
        The kinematics of the arm that holds the tool.
    tool : Tool
        Where the markers are on the tool.
    markers : MarkerLook
        What the markers look like.
    slack : float
        Share of a joint's range by which it may stand beyond its limit. A target is not bound to
        it.
    """

    camera: str
    width: int
    height: int
    mechanism: Kinematics
    tool: Tool
    markers: MarkerAppearance
    slack: float = Thresholds.slack


@dataclass(frozen=True)
class Content:
    """What a file holds beside its format and checksum.

    Parameters
    ----------
    taught : str
        When the file was written, in UTC: a time like 2026-11-21T11:30:00Z.
    markers_px : tuple[tuple[float, float], tuple[float, float]]
        (u, v) raw px of marker 1, then of marker 2.
    joints : tuple[float, float, float]
        rad, rad, mm while the target was shown.
    setup : texts.Table
        The Setup that it was shown by, in plain words and numbers.
    sizes_px : texts.Sizes
        Apparent radii, px, of marker 1 and of marker 2; null where not known.
    """

    taught: str
    markers_px: tuple[tuple[float, float], tuple[float, float]]
    joints: tuple[float, float, float]
    setup: texts.Table
    sizes_px: texts.Sizes = texts.NO_SIZES

    def __post_init__(self) -> None:
        try:
            datetime.strptime(self.taught, TAUGHT)
        except ValueError as error:
            raise BadInput("taught", self.taught, "a time like 2026-11-21T11:30:00Z") from error


def save(path: Path, target: Target, setup: Setup) -> None:
    """Write a target as it was shown now."""
    content = {
        "taught": datetime.now(UTC).strftime(TAUGHT),
        "markers_px": target.points.tolist(),
        "sizes_px": texts.sizes(target.sizes),
        "joints": target.q.tolist(),
        "setup": _told(setup),
    }
    try:
        _target(decode(Content, content, "target"), setup)
    except BadInput as error:
        raise UnusableFile(path, f"is not written: {error}") from error
    content = {"format": FORMAT, **content}
    first = {"format": FORMAT, "sha256": checksum(content)}
    write_whole(path, json.dumps({**first, **content}, indent=1) + "\n")


def load(path: Path, setup: Setup) -> Target:
    """The target in a file, for the setup that it was shown by."""
    data = read_small(path, MAX_SIZE, "a target")
    with texts.reading(path, "JSON"):
        try:
            return _target(_content(texts.from_json(data.decode())), setup)
        except BadInput as error:
            raise UnusableFile(path, str(error)) from error


def checksum(content: object) -> str:
    """SHA-256 of what a target's file holds beside it, in hexadecimal; the same however the file is
    laid out.
    """
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _content(table: object) -> Content:
    """What a file's JSON tells, if it is a target's and whole."""
    if not texts.is_table(table) or table.get("format") != FORMAT:
        raise texts.Refused(f"is not a target of this version: its format must be {FORMAT!r}")
    rest = {key: value for key, value in table.items() if key != "sha256"}
    if table.get("sha256") != checksum(rest):
        raise texts.Refused("is damaged or was changed: its checksum is wrong")
    return decode(Content, {key: rest[key] for key in rest if key != "format"}, "target")


def _target(content: Content, setup: Setup) -> Target:
    """The target in a content, all of it checked."""
    _same(content.setup, _told(setup), "")
    right, below = setup.width - 0.5, setup.height - 0.5
    for i, (u, v) in enumerate(content.markers_px):
        inside = -0.5 <= u <= right and -0.5 <= v <= below
        size = f"within the picture of {setup.width} x {setup.height} px"
        require(inside, f"target.markers_px[{i}]", (u, v), size)
    for i, radius in enumerate(content.sizes_px):
        good = radius is None or 0.0 < radius <= setup.width
        require(good, f"target.sizes_px[{i}]", radius, "a positive radius within the picture")
    _within(content.joints, setup)
    sizes = np.array(content.sizes_px, dtype=np.float64)
    return Target(np.array(content.markers_px), np.array(content.joints), sizes=sizes)


def _within(q: tuple[float, float, float], setup: Setup) -> None:
    """Refuse joints beyond their limits, by more than one may stand beyond them."""
    lower, upper = setup.mechanism.limits.arrays
    slack = setup.slack * (upper - lower)
    for i, name in enumerate(setup.mechanism.joint_names):
        good = lower[i] - slack[i] <= q[i] <= upper[i] + slack[i]
        right = f"{name} within its limits {lower[i]:.6g} and {upper[i]:.6g}"
        require(bool(good), f"target.joints[{i}]", q[i], right)


def _told(setup: Setup) -> object:
    """A setup in plain words and numbers, as they come back from JSON."""
    bound = {name: value for name, value in vars(setup).items() if name != "slack"}
    return json.loads(json.dumps(bound, default=_table))


def _table(part: Any) -> texts.Table:
    """Return the settings of a part of a setup, with its kind where it has one."""
    kind = {"kind": part.name} if hasattr(part, "name") else {}
    return {**kind, **asdict(part)}


def _same(then: object, now: object, where: str) -> None:
    """Refuse what was taught with another setup, naming the first value that differs and both sides
    of it.
    """
    if texts.is_table(then) and texts.is_table(now):
        for key in sorted({**now, **then}, key="kind".__ne__):  # the kind says most
            _same(then.get(key), now.get(key), f"{where}.{key}" if where else key)
    elif isinstance(then, bool) is not isinstance(now, bool) or then != now:
        raise texts.Refused(
            f"was taught with {one_line(where) or 'setup'} {quoted(then)}, "
            f"this rig has {quoted(now)}: teach the target again"
        )
