"""Results of tasks on disk: one folder per task, with the results as JSON.

A single number that is NaN means a failed measurement and is refused. Arrays may have gaps, which
are null in JSON and NaN in memory.
"""

import hashlib
import json
import math
import re
import shutil
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

import rcmservo
from rcmservo.config.atomic_files import write_atomically
from rcmservo.config.toml_json_parsing import is_table
from rcmservo.errors import UnusableFile
from rcmservo.paper.plan import NotMeasured, Task, TaskResult
from rcmservo.study.execution.package_version import identify_package

RESULT_FILE = "result.json"
PART_SUFFIX = ".part"
MODE_FILE = "paper.json"
IMPORT_LINE = re.compile(r"^from rcmservo\.(paper[\w.]*) import ([\w, ]*)", re.MULTILINE)
"""Import of a module of `rcmservo.paper`, or of names from it."""
SHARED_FOLDERS = ("recording", "figures")
"""Folders on which results of the paper depend, although `identify_package` leaves them out."""


def prepare(out: Path, quick: bool) -> None:
    """Create the folder, or check that it belongs to an earlier run of the same kind.

    Raises
    ------
    UnusableFile
        If the folder belongs to another kind of run, is not empty, or cannot be used.
    """
    mode = "quick" if quick else "whole"
    try:
        out.mkdir(parents=True, exist_ok=True)
        if (out / MODE_FILE).exists():
            earlier = json.loads((out / MODE_FILE).read_text())["mode"]
            if earlier != mode:
                problem = f"holds a {earlier} run and this is a {mode} one: name another folder"
                raise UnusableFile(out, problem)
        elif any(out.iterdir()):
            problem = "is not empty and holds no earlier run of the paper: name a new folder"
            raise UnusableFile(out, problem)
        else:
            write_atomically(out / MODE_FILE, json.dumps({"mode": mode}) + "\n")
    except OSError as error:
        raise UnusableFile(out, f"cannot be used: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise UnusableFile(out / MODE_FILE, "is damaged: name a new folder") from error


class Assignment(NamedTuple):
    """A task with the folder of its result.

    Parameters
    ----------
    task : Task
        Task.
    folder : Path
        Folder of the result.
    fingerprint : str
        Hash of everything that the result depends on, by the function `fingerprint`.
    """

    task: Task
    folder: Path
    fingerprint: str

    @property
    def is_finished(self) -> bool:
        """True if the folder holds the result of this task with the same fingerprint."""
        try:
            stored = json.loads((self.folder / RESULT_FILE).read_text())["fingerprint"]
            return stored == self.fingerprint
        except (OSError, ValueError, KeyError, TypeError):
            return False

    def perform(self) -> None:
        """Run the task, and move its results into the folder when they are complete."""
        part = self._clear()
        part.mkdir(parents=True)
        result = self.task.work(part) if self.task.in_folder else self.task.work()
        stored = {"fingerprint": self.fingerprint, "values": to_json(result, self.task.name)}
        text = json.dumps(stored, allow_nan=False)
        (part / RESULT_FILE).write_text(text)
        part.rename(self.folder)

    def copy_from(self, other: "Assignment") -> None:
        """Copy the result of another task with the same work, and complete it before it counts."""
        part = self._clear()
        shutil.copytree(other.folder, part)
        part.rename(self.folder)

    def _clear(self) -> Path:
        """Remove earlier results, and return the folder for results that are not complete."""
        part = self.folder.with_name(self.folder.name + PART_SUFFIX)
        for earlier in (part, self.folder):
            shutil.rmtree(earlier, ignore_errors=True)
        return part

    @property
    def result(self) -> TaskResult:
        """Result of the finished task."""
        return from_json(json.loads((self.folder / RESULT_FILE).read_text())["values"])


def fingerprint(task: Task) -> str:
    """Return a hash of everything that a result depends on: arguments, package and source files."""
    work, root = task.work, Path(rcmservo.__file__).parent
    digest = hashlib.sha256(repr((work.func.__qualname__, sorted(work.keywords.items()))).encode())
    digest.update(identify_package().encode())
    shared = [path for folder in SHARED_FOLDERS for path in (root / folder).rglob("*.py")]
    module = root / (work.func.__module__.partition(".")[2].replace(".", "/") + ".py")
    for path in sorted([*shared, *imported_paper_files(root, module)]):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def imported_paper_files(root: Path, module: Path) -> set[Path]:
    """Return a module's file and those of `rcmservo.paper` that it imports, also indirectly."""
    files: set[Path] = set()
    unread = {module}
    while unread:
        path = unread.pop()
        if path.exists():
            files.add(path)
            for module_name, names in IMPORT_LINE.findall(path.read_text()):
                parent = root / module_name.replace(".", "/")
                modules = {parent / f"{name.strip()}.py" for name in names.split(",")}
                unread |= {parent.with_suffix(".py"), *modules} - files
    return files


def to_json(value: Any, path: str = "result") -> Any:
    """Convert a result to JSON types; raise `NotMeasured` for a number that is not finite.

    `path` names the value in the message of the error.
    """
    if is_table(value):
        return {name: to_json(item, f"{path}.{name}") for name, item in value.items()}
    if isinstance(value, np.ndarray):
        return _replace_gaps(cast(Any, value).tolist())
    if isinstance(value, list | tuple):
        return [to_json(item, f"{path}[{i}]") for i, item in enumerate(cast(list[Any], value))]
    number = cast(Any, value).item() if isinstance(value, np.generic) else value
    if isinstance(number, float) and not math.isfinite(number):
        raise NotMeasured(path, number)
    return number


def _replace_gaps(values: Any) -> Any:
    """Return nested lists of numbers with null in place of numbers that are not finite."""
    if isinstance(values, list):
        return [_replace_gaps(item) for item in cast(list[Any], values)]
    return None if isinstance(values, float) and not math.isfinite(values) else values


def from_json(value: Any) -> Any:
    """Convert a result back from JSON types; a list of numbers becomes an array."""
    if is_table(value):
        return {name: from_json(item) for name, item in value.items()}
    if not isinstance(value, list):
        return value
    items = cast(list[Any], value)
    if any(isinstance(item, str | dict) for item in items):
        return [from_json(item) for item in items]
    return np.array(items, dtype=float)
