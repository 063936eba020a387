"""Manifest of a study's folder: study.json, which describes every run.

Any run can be repeated from it. A comparison with the manifest of a new study lists the settings
that have changed.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Any

from rcmservo.config import toml_json_parsing
from rcmservo.config.atomic_files import read_limited, write_atomically
from rcmservo.config.class_registry import KIND_KEY
from rcmservo.config.former_names import find_present_name, replace_former_names
from rcmservo.config.rig_file import METHOD_PARTS, SIMULATION_SECTIONS
from rcmservo.config.strict_decoding import decode_settings
from rcmservo.config.toml_json_parsing import Table, is_table
from rcmservo.constraints import Checked, Limit, not_empty
from rcmservo.errors import UnusableFile, require, shorten_to_line
from rcmservo.safety.thresholds import Thresholds
from rcmservo.study.execution.package_version import identify_package
from rcmservo.study.plan.cell import Cell
from rcmservo.study.plan.plan import StudyPlan

MANIFEST_NAME, FORMAT = "study.json", "rcmservo study 1"
MAX_MANIFEST_BYTES = 100_000_000
"""Largest size of study.json, bytes."""
COMMON_SETTING_NAMES = {"package": "rcmservo", "count": "count", "first_seed": "seed"}
"""Names, for the user, of the settings that all cells share."""
METHOD_SETTING_NAME = "method"
"""Name, for the user, of the setting that lists the methods."""
NOISE_KEY, DELAY_KEY = "camera.point_noise", "camera.delay"
"""Numbers of a distribution that options of `rcmservo study` set."""

NOT_NEGATIVE_INTEGER = Limit(lambda number: number >= 0, "a whole number from 0 on")
POSITIVE_INTEGER = Limit(lambda number: number >= 1, "a whole number from 1 on")


@dataclass(frozen=True)
class StudyManifest(Checked):
    """Content of study.json.

    Parameters
    ----------
    package : str
        Version and hash of the rcmservo that made the study.
    count : int
        Number of scenes of each cell.
    first_seed : int
        Seed of the first scene.
    cells : tuple[Cell, ...]
        Cells in the order of their rows, `count` rows each.
    """

    package: str
    count: Annotated[int, POSITIVE_INTEGER]
    first_seed: Annotated[int, NOT_NEGATIVE_INTEGER]
    cells: Annotated[tuple[Cell, ...], not_empty("a list with at least one cell")]

    def find_run(self, row: int) -> tuple[Cell, int]:
        """Return the cell and the seed of the row with this index."""
        return self.cells[row // self.count], self.first_seed + row % self.count

    @property
    def runs(self) -> int:
        """Number of rows."""
        return len(self.cells) * self.count


def make_manifest(plan: StudyPlan) -> StudyManifest:
    """Return the manifest of a plan."""
    return StudyManifest(identify_package(), plan.count, plan.first_seed, plan.cells)


def write_manifest(folder: Path, manifest: StudyManifest) -> None:
    """Write study.json."""
    text = json.dumps({"format": FORMAT, **asdict(manifest)}, indent=1) + "\n"
    write_atomically(folder / MANIFEST_NAME, text)


def read_manifest(folder: Path) -> StudyManifest | None:
    """Read study.json; return None if the folder holds no study yet.

    Raises
    ------
    UnusableFile
        If study.json is damaged.
    """
    path = folder / MANIFEST_NAME
    if not path.exists():
        return None
    content = read_limited(path, MAX_MANIFEST_BYTES, "the manifest of a study")
    try:
        table = toml_json_parsing.parse_json(content.decode())
        if is_table(table):
            file_format = table.pop("format", None)
            require(file_format == FORMAT, "study.format", file_format, FORMAT)
            if isinstance(table.get("cells"), list):
                table["cells"] = [_with_present_names(cell) for cell in table["cells"]]
        manifest = decode_settings(StudyManifest, table, "study")
        for i, cell in enumerate(manifest.cells):
            _require_tables(cell, f"study.cells[{i}]")
        return manifest
    except (ValueError, RecursionError) as error:
        reason = (
            f"is not a manifest of `rcmservo study` ({shorten_to_line(error)}): name a new folder"
        )
        raise UnusableFile(path, reason) from error


def _require_tables(cell: Cell, field_name: str) -> None:
    """Raise `BadInput` if the servo or the scenes of a cell lack their tables.

    The values in the tables are validated where they are used.
    """
    estimator = cell.servo.get("estimator")
    has_kind = is_table(estimator) and KIND_KEY in estimator
    require(has_kind, f"{field_name}.servo.estimator", estimator, "a table with its kind")
    for name, section in cell.tables.items():
        require(is_table(section), f"{field_name}.tables.{name}", section, "a table")


def _with_present_names(cell: object) -> object:
    """Return a cell of an earlier version with the present names of its settings and sections."""
    if not is_table(cell):
        return cell
    renamed = replace_former_names(cell, _list_field_names(Cell))
    if is_table(sections := renamed.get("tables")):
        sections = renamed["tables"] = replace_former_names(sections, SIMULATION_SECTIONS)
        if is_table(thresholds := sections.get("thresholds")):
            sections["thresholds"] = replace_former_names(thresholds, _list_field_names(Thresholds))
    if is_table(ranges := renamed.get("vary")):
        renamed["vary"] = {_with_present_section(key): ends for key, ends in ranges.items()}
    return renamed


def _with_present_section(key: str) -> str:
    """Return a key section.key with the present name of its section."""
    section, dot, name = key.partition(".")
    return f"{find_present_name(section, SIMULATION_SECTIONS) or section}{dot}{name}"


def _list_field_names(kind: type[Any]) -> list[str]:
    return [f.name for f in fields(kind)]


def list_changed_settings(earlier: StudyManifest, present: StudyManifest) -> list[str]:
    """Return the names of the settings that differ between two studies.

    Settings of a method or of scenes are compared only if both studies have them.
    """
    changed_names = [
        user_name
        for field_name, user_name in COMMON_SETTING_NAMES.items()
        if getattr(earlier, field_name) != getattr(present, field_name)
    ]
    old, new = _collect_settings(earlier), _collect_settings(present)
    changed_names += [key[0] for key in new if key in old and old[key] != new[key]]
    return list(dict.fromkeys(changed_names))


def _collect_settings(manifest: StudyManifest) -> dict[tuple[str, str], set[str]]:
    """Return the values of every setting of the cells, by name and scenes."""
    settings: dict[tuple[str, str], set[str]] = {}
    for cell in manifest.cells:
        for name, scenes, value in _list_settings(cell):
            settings.setdefault((name, scenes), set()).add(json.dumps(value, sort_keys=True))
    return settings


def _list_settings(cell: Cell) -> Iterator[tuple[str, str, object]]:
    """Yield the name of every setting, the scenes that it depends on (or ""), and its value."""
    numbers = {**_flatten_tables(cell), **cell.vary}
    other_numbers = {k: value for k, value in numbers.items() if k not in (NOISE_KEY, DELAY_KEY)}
    yield METHOD_SETTING_NAME, "", cell.method
    yield f"settings of {cell.method}", "", [cell.servo.get(part) for part in METHOD_PARTS]
    yield f"code of {cell.method}", "", cell.source
    yield "scenes", "", cell.scenes
    yield "scenes", cell.scenes, other_numbers
    yield "noise", cell.scenes, numbers.get(NOISE_KEY)
    yield "latency", cell.scenes, numbers.get(DELAY_KEY)
    yield "disturb", "", cell.disturb
    yield "repetitions", "", cell.repetition
    yield f"engine of {cell.method}", "", cell.engine
    yield "duration", "", cell.duration
    yield "teaching frames", "", cell.teaching_frames


def _flatten_tables(cell: Cell) -> Table:
    """Return the settings of a cell's scenes by section.key."""
    sections = cell.tables.items()
    return {f"{name}.{key}": value for name, table in sections for key, value in table.items()}
