"""Target file: a taught target, the time of teaching, and the camera, arm, tool and markers used.

    {"format": "rcmservo target 1", "sha256": "…", "taught": "2026-11-21T11:30:00Z",
     "markers_px": [[u1, v1], [u2, v2]], "sizes_px": [R1, R2], "joints": [rad, rad, mm], "setup":
     {"camera": "…", "width": 640, "height": 480, "mechanism": {…}, "tool": {…}, "markers": {…}}}

Raw pixels are valid only for the setup that they were measured with. A file is therefore loaded
only for this setup; otherwise the error names the difference. The checksum detects accidental
changes; it is no signature.
"""

import hashlib
import json
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.config import toml_json_parsing
from rcmservo.config.atomic_files import read_limited, write_atomically
from rcmservo.config.strict_decoding import decode_settings
from rcmservo.errors import BadInput, UnusableFile, one_line, quoted, require
from rcmservo.geometry.kinematics import Kinematics
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Target
from rcmservo.safety.thresholds import Thresholds
from rcmservo.tracking import MarkerAppearance

TARGET_FORMAT = "rcmservo target 1"
MAX_TARGET_FILE_BYTES = 64 * 1024
TIME_FORMAT = "%Y-%m-%dT%H:%M:%SZ"


@dataclass(frozen=True)
class TargetSetup:
    """Setup for which a target is valid.

    Parameters
    ----------
    camera : str
        Name of the camera at its position. After the camera was moved, it has another name.
    width : int
        Width of the camera's image, px.
    height : int
        Height of the camera's image, px.
    mechanism : Kinematics
        Kinematics of the arm that holds the tool.
    tool : Tool
        Positions of the markers on the tool.
    markers : MarkerAppearance
        Appearance of the markers.
    slack : float
        Distance by which a joint may be beyond its limit, as a fraction of its range. A target is
        also valid with another value.
    """

    camera: str
    width: int
    height: int
    mechanism: Kinematics
    tool: Tool
    markers: MarkerAppearance
    slack: float = Thresholds.limit_tolerance


@dataclass(frozen=True)
class TargetContent:
    """Content of a target file in addition to its format and checksum.

    Parameters
    ----------
    taught : str
        Time at which the file was written, in UTC, such as 2026-11-21T11:30:00Z.
    markers_px : tuple[tuple[float, float], tuple[float, float]]
        Coordinates (u, v) of marker 1 and of marker 2, raw px.
    joints : tuple[float, float, float]
        Joints while the target was taught, rad, rad, mm.
    setup : texts.Table
        `TargetSetup` with which the target was taught, as JSON values.
    sizes_px : texts.MarkerRadii
        Apparent radii of marker 1 and of marker 2, px; null where unknown.
    """

    taught: str
    markers_px: tuple[tuple[float, float], tuple[float, float]]
    joints: tuple[float, float, float]
    setup: toml_json_parsing.Table
    sizes_px: toml_json_parsing.MarkerRadii = toml_json_parsing.UNKNOWN_RADII

    def __post_init__(self) -> None:
        try:
            datetime.strptime(self.taught, TIME_FORMAT)
        except ValueError as error:
            raise BadInput("taught", self.taught, "a time like 2026-11-21T11:30:00Z") from error


def save_target(path: Path, target: Target, setup: TargetSetup) -> None:
    """Write a target that was taught now.

    Raises
    ------
    UnusableFile
        If the target is invalid for the setup, or the file cannot be written.
    """
    content = {
        "taught": datetime.now(UTC).strftime(TIME_FORMAT),
        "markers_px": target.points.tolist(),
        "sizes_px": toml_json_parsing.radii_to_json(target.sizes),
        "joints": target.q.tolist(),
        "setup": _describe_setup(setup),
    }
    try:
        _make_target(decode_settings(TargetContent, content, "target"), setup)
    except BadInput as error:
        raise UnusableFile(path, f"is not written: {error}") from error
    content = {"format": TARGET_FORMAT, **content}
    first = {"format": TARGET_FORMAT, "sha256": compute_checksum(content)}
    write_atomically(path, json.dumps({**first, **content}, indent=1) + "\n")


def load_target(path: Path, setup: TargetSetup) -> Target:
    """Return the target in a file.

    Raises
    ------
    UnusableFile
        If the file is damaged, or the target was taught with another setup.
    """
    data = read_limited(path, MAX_TARGET_FILE_BYTES, "a target")
    with toml_json_parsing.name_file_in_errors(path, "JSON"):
        try:
            return _make_target(_decode_content(toml_json_parsing.parse_json(data.decode())), setup)
        except BadInput as error:
            raise UnusableFile(path, str(error)) from error


def compute_checksum(content: object) -> str:
    """Return the SHA-256 of a target file's content in hexadecimal, whatever its layout."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _decode_content(table: object) -> TargetContent:
    """Return the content of a target file from its JSON; check format and checksum."""
    if not toml_json_parsing.is_table(table) or table.get("format") != TARGET_FORMAT:
        raise toml_json_parsing.InvalidText(
            f"is not a target of this version: its format must be {TARGET_FORMAT!r}"
        )
    rest = {key: value for key, value in table.items() if key != "sha256"}
    if table.get("sha256") != compute_checksum(rest):
        raise toml_json_parsing.InvalidText("is damaged or was changed: its checksum differs")
    return decode_settings(
        TargetContent, {key: rest[key] for key in rest if key != "format"}, "target"
    )


def _make_target(content: TargetContent, setup: TargetSetup) -> Target:
    """Return the target of a content after checking every value."""
    _require_equal_setups(content.setup, _describe_setup(setup), "")
    max_u, max_v = setup.width - 0.5, setup.height - 0.5
    for i, (u, v) in enumerate(content.markers_px):
        inside = -0.5 <= u <= max_u and -0.5 <= v <= max_v
        size = f"within the image of {setup.width} x {setup.height} px"
        require(inside, f"target.markers_px[{i}]", (u, v), size)
    for i, radius in enumerate(content.sizes_px):
        is_valid = radius is None or 0.0 < radius <= setup.width
        require(is_valid, f"target.sizes_px[{i}]", radius, "a positive radius within the image")
    _require_joints_within_limits(content.joints, setup)
    sizes = np.array(content.sizes_px, dtype=np.float64)
    return Target(np.array(content.markers_px), np.array(content.joints), sizes=sizes)


def _require_joints_within_limits(q: tuple[float, float, float], setup: TargetSetup) -> None:
    """Raise `BadInput` for a joint beyond its limit by more than `slack`."""
    lower, upper = setup.mechanism.limits.arrays
    slack = setup.slack * (upper - lower)
    for i, name in enumerate(setup.mechanism.joint_names):
        is_within = lower[i] - slack[i] <= q[i] <= upper[i] + slack[i]
        expected = f"{name} within its limits {lower[i]:.6g} and {upper[i]:.6g}"
        require(bool(is_within), f"target.joints[{i}]", q[i], expected)


def _describe_setup(setup: TargetSetup) -> object:
    """Return a setup as JSON values."""
    bound = {name: value for name, value in vars(setup).items() if name != "slack"}
    return json.loads(json.dumps(bound, default=_convert_to_table))


def _convert_to_table(part: Any) -> toml_json_parsing.Table:
    """Return the settings of a part of a setup as a table, with its kind where it has one."""
    kind = {"kind": part.name} if hasattr(part, "name") else {}
    return {**kind, **asdict(part)}


def _require_equal_setups(then: object, now: object, where: str) -> None:
    """Raise `InvalidText` with the first value that differs between two setups."""
    if toml_json_parsing.is_table(then) and toml_json_parsing.is_table(now):
        for key in sorted(
            {**now, **then}, key="kind".__ne__
        ):  # a different kind is the most informative difference
            _require_equal_setups(then.get(key), now.get(key), f"{where}.{key}" if where else key)
    elif isinstance(then, bool) is not isinstance(now, bool) or then != now:
        raise toml_json_parsing.InvalidText(
            f"was taught with {one_line(where) or 'setup'} {quoted(then)}, "
            f"this rig has {quoted(now)}: teach the target again"
        )
