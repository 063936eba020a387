"""Target file: a taught target, when it was taught, and with which camera, arm, tool and markers.

    {"format": "rcmservo target 1", "sha256": "…", "taught": "2026-11-21T11:30:00Z",
     "markers_px": [[u1, v1], [u2, v2]], "sizes_px": [R1, R2], "joints": [rad, rad, mm], "setup":
     {"camera": "…", "width": 640, "height": 480, "mechanism": {…}, "tool": {…}, "markers": {…}}}

Raw pixels (without correction of the lens distortion) are valid only for the setup with which they
were measured. A file is therefore loaded only for this setup; otherwise the error names the
difference. The checksum detects accidental changes; it is no signature.
"""

import hashlib
import json
from dataclasses import asdict, dataclass, is_dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast

import numpy as np

from rcmservo.config.atomic_files import read_limited, write_atomically
from rcmservo.config.strict_decoding import decode_settings
from rcmservo.config.toml_json_parsing import (
    UNKNOWN_RADII,
    InvalidText,
    MarkerRadii,
    Table,
    convert_unknown_to_null,
    is_table,
    name_file_in_errors,
    parse_json,
)
from rcmservo.errors import BadInput, UnusableFile, quote_value, require, shorten_to_line
from rcmservo.geometry.kinematics import Kinematics
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Target
from rcmservo.safety.target_checks import (
    require_joints_within_limits,
    require_markers_in_image,
    require_possible_markers,
)
from rcmservo.safety.thresholds import Thresholds
from rcmservo.tracking import MarkerAppearance

TARGET_FORMAT = "rcmservo target 1"
MAX_TARGET_FILE_BYTES = 64 * 1024
TIME_FORMAT = "%Y-%m-%dT%H:%M:%SZ"  # in UTC


@dataclass(frozen=True)
class TargetSetup:
    """Camera, arm, tool and markers for which a target is valid.

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
    markers : MarkerAppearance or Table
        Appearance of the markers, or the section of the user-defined tracker that detects them.
    slack : float
        Distance by which a joint may be beyond its limit, as a fraction of its range. The file does
        not contain it, so a target stays valid if this value changes.
    """

    camera: str
    width: int
    height: int
    mechanism: Kinematics
    tool: Tool
    markers: MarkerAppearance | Table
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
    setup : Table
        `TargetSetup` with which the target was taught, as JSON values.
    sizes_px : MarkerRadii
        Apparent radii of marker 1 and of marker 2, px; null where unknown.
    """

    taught: str
    markers_px: tuple[tuple[float, float], tuple[float, float]]
    joints: tuple[float, float, float]
    setup: Table
    sizes_px: MarkerRadii = UNKNOWN_RADII

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
        "sizes_px": convert_unknown_to_null(target.sizes),
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
    with name_file_in_errors(path, "JSON"):
        try:
            return _make_target(_decode_content(parse_json(data.decode())), setup)
        except BadInput as error:
            raise UnusableFile(path, str(error)) from error


def compute_checksum(content: object) -> str:
    """Return the SHA-256 of a target file's content in hexadecimal, whatever its layout."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _decode_content(table: object) -> TargetContent:
    """Return the content of a target file from its JSON; check format and checksum."""
    if not is_table(table) or table.get("format") != TARGET_FORMAT:
        expected = f"its format must be {TARGET_FORMAT!r}"
        raise InvalidText(f"is not a target of this version: {expected}")
    checksum, content = table.get("sha256"), {k: v for k, v in table.items() if k != "sha256"}
    if checksum != compute_checksum(content):
        raise InvalidText("is damaged or was changed: its checksum differs")
    del content["format"]
    return decode_settings(TargetContent, content, "target")


def _make_target(content: TargetContent, setup: TargetSetup) -> Target:
    """Return the target of a content after checking every value."""
    _require_equal_setups(content.setup, _describe_setup(setup), "")
    points, q = np.array(content.markers_px), np.array(content.joints)
    require_possible_markers("target.markers_px", points)
    require_markers_in_image("target.markers_px", points, setup.width, setup.height)
    for i, radius in enumerate(content.sizes_px):
        is_valid = radius is None or 0.0 < radius <= setup.width
        require(is_valid, f"target.sizes_px[{i}]", radius, "a positive radius within the image")
    require_joints_within_limits("target.joints", q, setup.mechanism, setup.slack)
    return Target(points, q, sizes=np.array(content.sizes_px, dtype=np.float64))


def _describe_setup(setup: TargetSetup) -> object:
    """Return a setup as JSON values; each part that has a name gets it as the key `kind`."""

    def convert_part(part: Any) -> Table | str:
        kind = {"kind": part.name} if hasattr(part, "name") else {}
        # what is no dataclass is a date in the section of a user-defined tracker
        return kind | asdict(cast(Any, part)) if is_dataclass(part) else str(part)

    stored = {name: value for name, value in vars(setup).items() if name != "slack"}
    return json.loads(json.dumps(stored, default=convert_part))


def _require_equal_setups(taught: object, present: object, path: str) -> None:
    """Raise `InvalidText` with the first value that differs between two setups, given as JSON."""
    if is_table(taught) and is_table(present):
        # the key `kind` first, because a different kind explains all other differences
        for key in sorted({**present, **taught}, key="kind".__ne__):
            key_path = f"{path}.{key}" if path else key
            _require_equal_setups(taught.get(key), present.get(key), key_path)
    elif isinstance(taught, bool) is not isinstance(present, bool) or taught != present:
        raise InvalidText(
            f"was taught with {shorten_to_line(path) or 'setup'} {quote_value(taught)}, "
            f"this rig has {quote_value(present)}: teach the target again"
        )
