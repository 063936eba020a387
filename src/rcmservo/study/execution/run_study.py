"""A study, done: what is not there yet is ordered, what comes is kept, and all is gathered."""

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

from rcmservo.servo.user_estimator import name_of_class
from rcmservo.study.execution import manifest
from rcmservo.study.execution.chunk import ChunkOrder, one_run
from rcmservo.study.execution.package_version import package
from rcmservo.study.execution.store import Store, key_of
from rcmservo.study.execution.workers import Crew
from rcmservo.study.plan.method import Own
from rcmservo.study.plan.plan import Chunk, StudyPlan

Progress = Callable[[int], None]
"""Is told how many runs more are done."""


class Work:
    """A plan and its folder: what is done, and what is left. The folder is made when there is
    something to keep.
    """

    changed: list[str]
    """Settings that are not what they were when the folder was used last."""

    def __init__(self, plan: StudyPlan, folder: Path) -> None:
        self.plan, self.store, self._noted = plan, Store(folder), False
        self.chunks = {key_of(chunk): chunk for chunk in plan.chunks()}
        self.left = {k: chunk for k, chunk in self.chunks.items() if not self.store.has(k)}
        self._before, self._note = manifest.read(folder), manifest.note_of(plan)
        self.changed = [] if self._before is None else manifest.changed(self._before, self._note)

    @property
    def runs_left(self) -> int:
        """How many are not done."""
        return sum(len(chunk.seeds) for chunk in self.left.values())

    def compile(self) -> None:
        """Make the first run that is left of every cell, so that all that it needs is compiled
        once, and not by every worker at a time. What cannot be run is told before any begins.
        """
        first = {chunk.cell.text: chunk for chunk in reversed(self.left.values())}
        for chunk in first.values():
            one_run(chunk.cell, chunk.cell.rebuilt(self.own), chunk.seeds.start)

    def go(self, crew: Crew, progress: Progress) -> None:
        """Have all that is left done."""
        parcels = {method.name: method.parcel for method in self.plan.methods}
        orders = (
            (key, ChunkOrder(chunk.cell.text, *_ends(chunk), package(), parcels[chunk.cell.method]))
            for key, chunk in self.left.items()
        )
        for key, rows in crew.done(orders):
            self._write_note()
            self.store.keep(key, rows)
            progress(len(rows))

    def gather(self) -> Any:
        """All rows, as a table, which is written too."""
        self._write_note()
        return self.store.gather(self.chunks)

    def _write_note(self) -> None:
        """Note what the folder holds, once; rows that were gathered of another study go."""
        if not self._noted:
            self.store.make()
            if self._before != self._note:
                self.store.forget()
            manifest.write(self.store.folder, self._note)
            self._noted = True

    @cached_property
    def own(self) -> Own:
        """The users' own estimators, by module:class."""
        kinds = [type(m.estimator) for m in self.plan.methods if m.parcel.name]
        return {name_of_class(kind): kind for kind in kinds}


def _ends(chunk: Chunk) -> tuple[int, int]:
    return chunk.seeds.start, chunk.seeds.stop
