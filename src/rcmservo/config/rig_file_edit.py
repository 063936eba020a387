"""Writing of the section [markers] of a rig file; all other lines stay unchanged."""

import re
from pathlib import Path

from rcmservo.config.atomic_files import write_atomically
from rcmservo.config.rig_file import load_rig_file, read_rig_file
from rcmservo.config.toml_json_parsing import Table, parse_toml
from rcmservo.errors import UnusableFile

MARKERS_HEADING = re.compile(r"\s*\[\s*markers\s*\]")
ANY_HEADING = re.compile(r"\s*\[")
KEY_VALUE_LINE = re.compile(
    r"""(?P<key_and_equals>\s*(?P<key>\w+)\s*=\s*)("[^"]*"|'[^']*'|[^\s#]+)(?P<rest>.*)""",
    re.DOTALL,
)

MarkerValues = dict[str, str | float]
"""New values of [markers] by key."""


def find_marker_keys(path: Path) -> set[str]:
    """Return the keys in the section [markers] of a rig file."""
    return set(_read_tables(path).get("markers", {}))


def write_markers(path: Path, values: MarkerValues) -> None:
    """Write values into the section [markers] of a rig file and leave everything else unchanged.

    Raises
    ------
    BadInput
        If the file has invalid values.
    UnusableFile
        If the file cannot be written, or its markers have a syntax that this module cannot edit.
    """
    tables = _read_tables(path)
    text = _replace_markers(read_rig_file(path).decode(), values)
    expected = {**tables, "markers": {**tables.get("markers", {}), **values}}
    try:
        is_correct = parse_toml(text.encode()) == expected
    except ValueError:
        is_correct = False
    if not is_correct:
        lines = ", ".join(f"{key} = {_format_toml_value(value)}" for key, value in values.items())
        reason = "has its markers in a syntax that must be edited by hand"
        raise UnusableFile(path, f"{reason}: write {lines} into its section [markers]")
    write_atomically(path.resolve(), text)


def _read_tables(path: Path) -> Table:
    """Return the tables of a rig file after a check of all its values."""
    load_rig_file(path)
    return parse_toml(read_rig_file(path))


def _replace_markers(text: str, values: MarkerValues) -> str:
    """Return the text with new values in its section [markers], which is appended if missing."""
    line_end = "\r\n" if "\r\n" in text else "\n"
    lines = text.splitlines(keepends=True)
    headings = [i for i, line in enumerate(lines) if MARKERS_HEADING.match(line)]
    if not headings:
        gap = "" if not text else line_end if text.endswith("\n") else 2 * line_end
        return text + gap + f"[markers]{line_end}" + "".join(_format_lines(values, line_end))
    start = headings[0] + 1
    end = next((i for i in range(start, len(lines)) if ANY_HEADING.match(lines[i])), len(lines))
    new_values = dict(values)
    for i in range(start, end):
        line = KEY_VALUE_LINE.match(lines[i])
        if line and line["key"] in new_values:
            value = _format_toml_value(new_values.pop(line["key"]))
            lines[i] = line["key_and_equals"] + value + line["rest"]
    while end > start and not lines[end - 1].split("#")[0].strip():
        end -= 1  # blank lines and comments belong to the next section
    if new_values and not lines[end - 1].endswith("\n"):
        lines[end - 1] += line_end
    return "".join([*lines[:end], *_format_lines(new_values, line_end), *lines[end:]])


def _format_lines(values: MarkerValues, line_end: str) -> list[str]:
    return [f"{key} = {_format_toml_value(value)}{line_end}" for key, value in values.items()]


def _format_toml_value(value: str | float) -> str:
    return f'"{value}"' if isinstance(value, str) else f"{value!r}"
