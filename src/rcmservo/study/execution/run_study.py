"""Execution of a study: run the missing chunks, store their rows, gather all rows."""

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

from rcmservo.servo.user_estimator import name_of_class
from rcmservo.study.execution import manifest
from rcmservo.study.execution.chunk import ChunkOrder, one_run
from rcmservo.study.execution.package_version import package
from rcmservo.study.execution.store import ChunkStore, compute_chunk_key
from rcmservo.study.execution.workers import Crew
from rcmservo.study.plan.method import Own
from rcmservo.study.plan.plan import Chunk, StudyPlan

Progress = Callable[[int], None]
"""Callback that gets the number of runs that have just finished."""


class Work:
    """Study in progress: its plan, its folder, and the chunks that are missing.

    The folder is created with the first rows.

    Parameters
    ----------
    plan : StudyPlan
        Methods, scenes and conditions.
    folder : Path
        Folder of the results.

    Raises
    ------
    UnusableFile
        If the folder holds something else, or cannot be written to.
    """

    changed: list[str]
    """Settings that differ from those of the previous study in the folder."""

    def __init__(self, plan: StudyPlan, folder: Path) -> None:
        self.plan, self.store, self._has_manifest = plan, ChunkStore(folder), False
        self.chunks = {compute_chunk_key(chunk): chunk for chunk in plan.chunks()}
        self.left = {k: chunk for k, chunk in self.chunks.items() if not self.store.has(k)}
        self._before, self._now = manifest.read(folder), manifest.note_of(plan)
        self.changed = [] if self._before is None else manifest.changed(self._before, self._now)

    @property
    def runs_left(self) -> int:
        """Number of missing runs."""
        return sum(len(chunk.seeds) for chunk in self.left.values())

    def compile(self) -> None:
        """Make the first missing run of every cell.

        That compiles all functions once here instead of once in every worker, and raises the error
        of a cell that cannot run before any worker starts.
        """
        first = {chunk.cell.text: chunk for chunk in reversed(self.left.values())}
        for chunk in first.values():
            one_run(chunk.cell, chunk.cell.rebuilt(self.own), chunk.seeds.start)

    def go(self, crew: Crew, progress: Progress) -> None:
        """Run all missing chunks on the workers and store their rows."""
        archives = {method.name: method.parcel for method in self.plan.methods}
        requests = (
            (
                key,
                ChunkOrder(chunk.cell.text, *_ends(chunk), package(), archives[chunk.cell.method]),
            )
            for key, chunk in self.left.items()
        )
        for key, rows in crew.done(requests):
            self._write_manifest()
            self.store.keep(key, rows)
            progress(len(rows))

    def gather(self) -> Any:
        """Write all rows into one file and return them as a table."""
        self._write_manifest()
        return self.store.gather(self.chunks)

    def _write_manifest(self) -> None:
        """Write the manifest once; remove gathered rows of a different study before."""
        if not self._has_manifest:
            self.store.make()
            if self._before != self._now:
                self.store.forget()
            manifest.write(self.store.folder, self._now)
            self._has_manifest = True

    @cached_property
    def own(self) -> Own:
        """User-defined estimators of the plan, by module:class."""
        kinds = [type(m.estimator) for m in self.plan.methods if m.parcel.name]
        return {name_of_class(kind): kind for kind in kinds}


def _ends(chunk: Chunk) -> tuple[int, int]:
    return chunk.seeds.start, chunk.seeds.stop
