"""The section [markers] of a rig file, written anew between lines that stay as they are."""

import re
from pathlib import Path

from rcmservo.config import texts
from rcmservo.config.atomic_files import read_small, write_whole
from rcmservo.config.rig_file import MAX_SIZE, load_lab
from rcmservo.errors import UnusableFile

HEAD = re.compile(r"\s*\[\s*markers\s*\]")
ANY_HEAD = re.compile(r"\s*\[")
LINE = re.compile(r"""(\s*)(\w+)(\s*=\s*)("[^"]*"|'[^']*'|[^\s#]+)(.*)""", re.DOTALL)

Values = dict[str, str | float]
"""What [markers] is to hold, by key."""


def told_in(path: Path) -> set[str]:
    """The keys that the section [markers] of a rig file has."""
    load_lab(path)
    return set(_tables(path).get("markers", {}))


def write_markers(path: Path, values: Values) -> None:
    """Write these into the section [markers] of a rig file, and touch nothing else of it."""
    load_lab(path)
    before = _tables(path)
    text = _changed(read_small(path, MAX_SIZE, "a rig file").decode(), values)
    wanted = {**before, "markers": {**before.get("markers", {}), **values}}
    try:
        good = texts.toml(text.encode()) == wanted
    except ValueError:
        good = False
    if not good:
        lines = ", ".join(f"{key} = {_toml(value)}" for key, value in values.items())
        why = "has its markers written in a way that only a person can change: "
        raise UnusableFile(path, f"{why}write {lines} into its section [markers]")
    write_whole(path.resolve(), text)


def _tables(path: Path) -> texts.Table:
    return texts.toml(read_small(path, MAX_SIZE, "a rig file"))


def _changed(text: str, values: Values) -> str:
    """The text with these values in its section [markers], which is made at the end if it is not
    there.
    """
    end = "\r\n" if "\r\n" in text else "\n"
    lines = text.splitlines(keepends=True)
    heads = [i for i, line in enumerate(lines) if HEAD.match(line)]
    if not heads:
        gap = "" if not text else end if text.endswith("\n") else 2 * end
        return text + gap + f"[markers]{end}" + "".join(_lines(values, end))
    first = heads[0] + 1
    last = next((i for i in range(first, len(lines)) if ANY_HEAD.match(lines[i])), len(lines))
    left = dict(values)
    for i in range(first, last):
        found = LINE.match(lines[i])
        if found and found[2] in left:
            lines[i] = found[1] + found[2] + found[3] + _toml(left.pop(found[2])) + found[5]
    while last > first and not lines[last - 1].split("#")[0].strip():
        last -= 1  # blank lines and comments belong to what follows
    if left and not lines[last - 1].endswith("\n"):
        lines[last - 1] += end
    return "".join([*lines[:last], *_lines(left, end), *lines[last:]])


def _lines(values: Values, end: str) -> list[str]:
    return [f"{key} = {_toml(value)}{end}" for key, value in values.items()]


def _toml(value: str | float) -> str:
    return f'"{value}"' if isinstance(value, str) else f"{value!r}"
