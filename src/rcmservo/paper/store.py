"""Results of tasks on disk: a folder for each task, with its results as JSON.

A single number must be finite: NaN is a measurement that failed. Arrays may have gaps, which are
null in JSON and NaN in memory.
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
from rcmservo.config.atomic_files import write_whole
from rcmservo.config.texts import is_table
from rcmservo.errors import UnusableFile
from rcmservo.paper.plan import Found, NotMeasured, Task
from rcmservo.study.execution.package_version import package

RESULT = "result.json"
PART = ".part"
MODE = "paper.json"
RECORDS = ("record", "figures")
"""Folders that a result may depend on and a row of a study does not."""


def prepare(out: Path, quick: bool) -> None:
    """Make the folder, or check that it is one of an earlier run of the same kind."""
    mode = "quick" if quick else "whole"
    try:
        out.mkdir(parents=True, exist_ok=True)
        if (out / MODE).exists():
            before = json.loads((out / MODE).read_text())["mode"]
            if before != mode:
                raise UnusableFile(
                    out, f"holds a {before} run and this is a {mode} one: name another folder"
                )
        elif any(out.iterdir()):
            raise UnusableFile(
                out, "is not empty and holds no earlier run of the paper: name a new folder"
            )
        else:
            write_whole(out / MODE, json.dumps({"mode": mode}) + "\n")
    except OSError as error:
        raise UnusableFile(out, f"cannot be used: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise UnusableFile(out / MODE, "is damaged: name a new folder") from error


class Assignment(NamedTuple):
    """A task, and the folder of its result.

    Parameters
    ----------
    task : Task
        Work to be done.
    folder : Path
        Folder of the result.
    mark : str
        Fingerprint of all that the result depends on.
    """

    task: Task
    folder: Path
    mark: str

    @property
    def finished(self) -> bool:
        """True if the folder holds the result of this very task."""
        try:
            return json.loads((self.folder / RESULT).read_text())["fingerprint"] == self.mark
        except (OSError, ValueError, KeyError, TypeError):
            return False

    def perform(self) -> None:
        """Run the task into its folder."""
        part = self.folder.with_name(self.folder.name + PART)
        for old in (part, self.folder):
            shutil.rmtree(old, ignore_errors=True)
        part.mkdir(parents=True)
        found = self.task.work(part) if self.task.in_folder else self.task.work()
        values = plain(found, self.task.name)
        text = json.dumps({"fingerprint": self.mark, "values": values}, allow_nan=False)
        (part / RESULT).write_text(text)
        part.rename(self.folder)

    def copy(self, other: "Assignment") -> None:
        """Take the result of another task that does the same work."""
        shutil.rmtree(self.folder, ignore_errors=True)
        shutil.copytree(other.folder, self.folder)

    @property
    def found(self) -> Found:
        """Result of the finished task."""
        return restored(json.loads((self.folder / RESULT).read_text())["values"])


def fingerprint(task: Task) -> str:
    """Return a hash of all that a result depends on: arguments, package, and own files."""
    work, root = task.work, Path(rcmservo.__file__).parent
    text = hashlib.sha256(repr((work.func.__qualname__, sorted(work.keywords.items()))).encode())
    text.update(package().encode())
    records = [path for folder in RECORDS for path in (root / folder).rglob("*.py")]
    module = root / (work.func.__module__.partition(".")[2].replace(".", "/") + ".py")
    for path in sorted([*records, *used(root, module)]):
        text.update(path.read_bytes())
    return text.hexdigest()


def used(root: Path, module: Path) -> set[Path]:
    """Return the files of the paper's package that a module imports, and its own."""
    found: set[Path] = set()
    todo = {module}
    while todo:
        path = todo.pop()
        if path.exists():
            found.add(path)
            names = re.findall(r"^from rcmservo\.(paper[\w.]*) import", path.read_text(), re.M)
            todo |= {root / (name.replace(".", "/") + ".py") for name in names} - found
    return found


def plain(value: Any, where: str = "result") -> Any:
    """Return a value as JSON holds it; `NotMeasured`, naming the item, for a number not finite."""
    if is_table(value):
        return {name: plain(one, f"{where}.{name}") for name, one in value.items()}
    if isinstance(value, np.ndarray):
        return _with_gaps(cast(Any, value).tolist())
    if isinstance(value, list | tuple):
        return [plain(one, f"{where}[{i}]") for i, one in enumerate(cast(list[Any], value))]
    number = cast(Any, value).item() if isinstance(value, np.generic) else value
    if isinstance(number, float) and not math.isfinite(number):
        raise NotMeasured(where, number)
    return number


def _with_gaps(values: Any) -> Any:
    if isinstance(values, list):
        return [_with_gaps(one) for one in cast(list[Any], values)]
    return None if isinstance(values, float) and not math.isfinite(values) else values


def restored(value: Any) -> Any:
    """Return a value from its form in JSON; a list of numbers becomes an array."""
    if is_table(value):
        return {name: restored(one) for name, one in value.items()}
    if not isinstance(value, list):
        return value
    items = cast(list[Any], value)
    if any(isinstance(one, str | dict) for one in items):
        return [restored(one) for one in items]
    return np.array(items, dtype=float)
