"""What a folder holds: study.json, from which any run of the study can be made again, and which
tells what has changed when the study is another one.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

from rcmservo.config import texts
from rcmservo.config.atomic_files import read_small, write_whole
from rcmservo.config.registry import KIND
from rcmservo.config.rig_file import METHOD_PARTS
from rcmservo.config.strict_decoding import decode
from rcmservo.config.texts import Table, is_table
from rcmservo.constraints import Checked, Limit, not_empty
from rcmservo.errors import UnusableFile, one_line, require
from rcmservo.study.execution.package_version import package
from rcmservo.study.plan.cell import Cell
from rcmservo.study.plan.plan import StudyPlan

NAME, FORMAT = "study.json", "rcmservo study 1"
LARGEST = 100_000_000
"""Bytes."""
WORDS = {"package": "rcmservo", "count": "count", "first_seed": "seed"}
"""What users call what is the same for all cells."""
METHOD = "method"
"""What users call the names of the methods."""
NOISE, DELAY = "camera.point_noise", "camera.delay"
"""Numbers of a distribution that have options of their own."""

FROM_0 = Limit(lambda number: number >= 0, "a whole number from 0 on")
FROM_1 = Limit(lambda number: number >= 1, "a whole number from 1 on")


@dataclass(frozen=True)
class StudyNote(Checked):
    """A study as its folder tells it.

    Parameters
    ----------
    package : str
        Of the rcmservo that made it.
    count : int
        Scenes of each cell.
    first_seed : int
        Of the first of them.
    cells : tuple[Cell, ...]
        In the order of their rows, `count` each.
    """

    package: str
    count: Annotated[int, FROM_1]
    first_seed: Annotated[int, FROM_0]
    cells: Annotated[tuple[Cell, ...], not_empty("one at least")]

    def run_of(self, case: int) -> tuple[Cell, int]:
        """The cell and the seed of a row."""
        return self.cells[case // self.count], self.first_seed + case % self.count

    @property
    def runs(self) -> int:
        """How many rows there are."""
        return len(self.cells) * self.count


def _require_usable(cell: Cell, where: str) -> None:
    """Refuse a cell whose servo and scenes do not look like some; what is in them is refused where
    it is used.
    """
    estimator = cell.servo.get("estimator")
    good = is_table(estimator) and KIND in estimator
    require(good, f"{where}.servo.estimator", estimator, "a table with its kind")
    for name, section in cell.tables.items():
        require(is_table(section), f"{where}.tables.{name}", section, "a table")


def note_of(plan: StudyPlan) -> StudyNote:
    """What is noted of a plan."""
    return StudyNote(package(), plan.count, plan.first_seed, plan.cells)


def write(folder: Path, note: StudyNote) -> None:
    """Note what the folder holds."""
    text = json.dumps({"format": FORMAT, **asdict(note)}, indent=1) + "\n"
    write_whole(folder / NAME, text)


def read(folder: Path) -> StudyNote | None:
    """What a folder holds; None where it holds no study yet."""
    path = folder / NAME
    if not path.exists():
        return None
    data = read_small(path, LARGEST, "a study's note")
    try:
        table = texts.from_json(data.decode())
        if is_table(table):
            form = table.pop("format", None)
            require(form == FORMAT, "study.format", form, FORMAT)
        note = decode(StudyNote, table, "study")
        for i, cell in enumerate(note.cells):
            _require_usable(cell, f"study.cells[{i}]")
        return note
    except (ValueError, RecursionError) as error:
        why = f"is not what `rcmservo study` wrote ({one_line(error)}): name a new folder"
        raise UnusableFile(path, why) from error


def changed(before: StudyNote, now: StudyNote) -> list[str]:
    """What of a study is not as it was, in the words of its settings. What is of a method, or of
    scenes, is told where both studies have these.
    """
    names = [word for name, word in WORDS.items() if getattr(before, name) != getattr(now, name)]
    old, new = _facts(before), _facts(now)
    other = [word for word, of in new if (word, of) in old and old[word, of] != new[word, of]]
    return list(dict.fromkeys(names + other))


def _facts(note: StudyNote) -> dict[tuple[str, str], set[str]]:
    """All that the cells are of, by its word and the scenes that it is of."""
    facts: dict[tuple[str, str], set[str]] = {}
    for cell in note.cells:
        for word, of, value in _facts_of(cell):
            facts.setdefault((word, of), set()).add(json.dumps(value, sort_keys=True))
    return facts


def _facts_of(cell: Cell) -> Iterator[tuple[str, str, object]]:
    drawn = {**_numbers(cell), **cell.vary}
    rest = {name: value for name, value in drawn.items() if name not in (NOISE, DELAY)}
    yield METHOD, "", cell.method
    yield f"settings of {cell.method}", "", [cell.servo.get(part) for part in METHOD_PARTS]
    yield f"code of {cell.method}", "", cell.source
    yield "scenes", "", cell.scenes
    yield "scenes", cell.scenes, rest
    yield "noise", cell.scenes, drawn.get(NOISE)
    yield "latency", cell.scenes, drawn.get(DELAY)
    yield "disturb", "", cell.disturb
    yield "repetitions", "", cell.repetition
    yield f"engine of {cell.method}", "", cell.engine
    yield "duration", "", cell.duration
    yield "shown", "", cell.shown


def _numbers(cell: Cell) -> Table:
    """The settings of a cell's scenes by section.key."""
    sections = cell.tables.items()
    return {f"{name}.{key}": value for name, table in sections for key, value in table.items()}
