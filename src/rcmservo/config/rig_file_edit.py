"""Edit the section [markers] of a rig file and leave all other lines unchanged."""

import re
from pathlib import Path

from rcmservo.config import toml_json_parsing
from rcmservo.config.atomic_files import read_limited, write_atomically
from rcmservo.config.rig_file import MAX_RIG_FILE_BYTES, load_rig_file
from rcmservo.errors import UnusableFile

MARKERS_HEADING = re.compile(r"\s*\[\s*markers\s*\]")
ANY_HEADING = re.compile(r"\s*\[")
KEY_VALUE_LINE = re.compile(r"""(\s*)(\w+)(\s*=\s*)("[^"]*"|'[^']*'|[^\s#]+)(.*)""", re.DOTALL)

MarkerValues = dict[str, str | float]
"""New values of [markers] by key."""


def find_marker_keys(path: Path) -> set[str]:
    """Return the keys in the section [markers] of a rig file."""
    load_rig_file(path)
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
    load_rig_file(path)
    before = _read_tables(path)
    text = _replace_markers(read_limited(path, MAX_RIG_FILE_BYTES, "a rig file").decode(), values)
    expected = {**before, "markers": {**before.get("markers", {}), **values}}
    try:
        is_correct = toml_json_parsing.parse_toml(text.encode()) == expected
    except ValueError:
        is_correct = False
    if not is_correct:
        lines = ", ".join(f"{key} = {_format_toml_value(value)}" for key, value in values.items())
        why = "has its markers in a syntax that must be edited by hand"
        raise UnusableFile(path, f"{why}: write {lines} into its section [markers]")
    write_atomically(path.resolve(), text)


def _read_tables(path: Path) -> toml_json_parsing.Table:
    return toml_json_parsing.parse_toml(read_limited(path, MAX_RIG_FILE_BYTES, "a rig file"))


def _replace_markers(text: str, values: MarkerValues) -> str:
    """Return the text with new values in its section [markers], which is appended if missing."""
    end = "\r\n" if "\r\n" in text else "\n"
    lines = text.splitlines(keepends=True)
    heads = [i for i, line in enumerate(lines) if MARKERS_HEADING.match(line)]
    if not heads:
        gap = "" if not text else end if text.endswith("\n") else 2 * end
        return text + gap + f"[markers]{end}" + "".join(_format_lines(values, end))
    first = heads[0] + 1
    last = next((i for i in range(first, len(lines)) if ANY_HEADING.match(lines[i])), len(lines))
    remaining = dict(values)
    for i in range(first, last):
        found = KEY_VALUE_LINE.match(lines[i])
        if found and found[2] in remaining:
            lines[i] = (
                found[1]
                + found[2]
                + found[3]
                + _format_toml_value(remaining.pop(found[2]))
                + found[5]
            )
    while last > first and not lines[last - 1].split("#")[0].strip():
        last -= 1  # blank lines and comments belong to the next section
    if remaining and not lines[last - 1].endswith("\n"):
        lines[last - 1] += end
    return "".join([*lines[:last], *_format_lines(remaining, end), *lines[last:]])


def _format_lines(values: MarkerValues, end: str) -> list[str]:
    return [f"{key} = {_format_toml_value(value)}{end}" for key, value in values.items()]


def _format_toml_value(value: str | float) -> str:
    return f'"{value}"' if isinstance(value, str) else f"{value!r}"
