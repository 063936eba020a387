"""What a folder holds: study.json, from which any run of the study can be made again, and which
tells what has changed when the study is another one."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rcmservo.config import texts
from rcmservo.config.files import read_small, write_whole
from rcmservo.errors import RcmServoError, UnusableFile
from rcmservo.study.plan.cell import Cell, cell_from
from rcmservo.study.plan.plan import StudyPlan
from rcmservo.study.work.package import package

NAME, FORMAT = "study.json", "rcmservo study 1"
LARGEST = 100_000_000
"""Bytes."""


@dataclass(frozen=True)
class StudyNote:
    """A study as its folder tells it."""

    package: str
    """Of the rcmservo that made it."""
    count: int
    """Scenes of each cell."""
    first_seed: int
    """Of the first of them."""
    cells: tuple[Mapping[str, Any], ...]
    """In the order of their rows, `count` each."""

    def run_of(self, case: int) -> tuple[Cell, int]:
        """The cell and the seed of a row."""
        cell = cell_from(json.dumps(self.cells[case // self.count]))
        return cell, self.first_seed + case % self.count

    @property
    def runs(self) -> int:
        """How many rows there are."""
        return len(self.cells) * self.count


def note_of(plan: StudyPlan) -> StudyNote:
    """What is noted of a plan."""
    cells = tuple(asdict(cell) for cell in plan.cells)
    return StudyNote(package(), plan.count, plan.first_seed, cells)


def write(folder: Path, note: StudyNote) -> None:
    """Note what the folder holds."""
    text = json.dumps({"format": FORMAT, **asdict(note)}, indent=1) + "\n"
    write_whole(folder / NAME, text)


def read(folder: Path) -> StudyNote | None:
    """What a folder holds; None where it holds no study yet."""
    path = folder / NAME
    if not path.exists():
        return None
    try:
        table = texts.from_json(read_small(path, LARGEST, "a study's note").decode())
        assert table["format"] == FORMAT
        cells = tuple(table["cells"])
        return StudyNote(table["package"], table["count"], table["first_seed"], cells)
    except RcmServoError:
        raise
    except (ValueError, RecursionError, TypeError, KeyError, AttributeError, AssertionError) as e:
        raise UnusableFile(path, "is not what `rcmservo study` wrote: name a new folder") from e


def changed(before: StudyNote, now: StudyNote) -> list[str]:
    """What of a study is not as it was, in the words of its settings."""
    names = [
        name
        for name in ("package", "count", "first_seed")
        if getattr(before, name) != getattr(now, name)
    ]
    keys = dict.fromkeys(key for cell in now.cells for key in cell)
    return names + [key for key in keys if _all(before, key) != _all(now, key)]


def _all(note: StudyNote, key: str) -> set[str]:
    return {json.dumps(cell.get(key), sort_keys=True) for cell in note.cells}
