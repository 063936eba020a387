"""Execution of a study: run the missing chunks, store their rows, gather all rows."""

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

from rcmservo.servo.user_estimator import format_class_name
from rcmservo.study.execution import manifest
from rcmservo.study.execution.chunk import ChunkRequest, run_seed
from rcmservo.study.execution.package_version import identify_package
from rcmservo.study.execution.store import ChunkStore, compute_chunk_key
from rcmservo.study.execution.workers import WorkerPool
from rcmservo.study.plan.method import UserEstimators
from rcmservo.study.plan.plan import Chunk, StudyPlan

Progress = Callable[[int], None]
"""Callback that gets the number of runs that have just finished."""


class StudyExecution:
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

    changed_settings: list[str]
    """Settings that differ from those of the previous study in the folder."""

    def __init__(self, plan: StudyPlan, folder: Path) -> None:
        self.plan, self.store, self._has_manifest = plan, ChunkStore(folder), False
        self.chunks = {compute_chunk_key(chunk): chunk for chunk in plan.chunks()}
        self.missing = {k: chunk for k, chunk in self.chunks.items() if not self.store.has(k)}
        stored, present = manifest.read_manifest(folder), manifest.make_manifest(plan)
        self._stored_manifest, self._manifest = stored, present
        self.changed_settings = manifest.list_changed_settings(stored, present) if stored else []

    @property
    def missing_runs(self) -> int:
        """Number of missing runs."""
        return sum(len(chunk.seeds) for chunk in self.missing.values())

    def compile(self) -> None:
        """Make the first missing run of every cell.

        This compiles all functions once in this process instead of once in every worker. The error
        of a cell that cannot run is raised before any worker starts.
        """
        first_chunks = {chunk.cell.text: chunk for chunk in reversed(self.missing.values())}
        for chunk in first_chunks.values():
            run_seed(chunk.cell, chunk.cell.rebuild_servo(self.user_estimators), chunk.seeds.start)

    def run(self, pool: WorkerPool, progress: Progress) -> None:
        """Run all missing chunks on the workers and store their rows."""
        archives = {method.name: method.archive for method in self.plan.methods}

        def make_request(chunk: Chunk) -> ChunkRequest:
            archive = archives[chunk.cell.method]
            return ChunkRequest(chunk.cell.text, chunk.seeds, identify_package(), archive)

        requests = ((key, make_request(chunk)) for key, chunk in self.missing.items())
        for key, rows in pool.run(requests):
            self._write_manifest()
            self.store.store(key, rows)
            progress(len(rows))

    def gather(self) -> Any:
        """Write all rows into one file and return them as a table."""
        self._write_manifest()
        return self.store.gather(self.chunks)

    def _write_manifest(self) -> None:
        """Write the manifest once, after the removal of the gathered rows of a different study."""
        if not self._has_manifest:
            self.store.create()
            if self._stored_manifest != self._manifest:
                self.store.remove_derived_files()
            manifest.write_manifest(self.store.folder, self._manifest)
            self._has_manifest = True

    @cached_property
    def user_estimators(self) -> UserEstimators:
        """User-defined estimators of the plan, by module:class."""
        kinds = [type(m.estimator) for m in self.plan.methods if m.archive.name]
        return {format_class_name(kind): kind for kind in kinds}
