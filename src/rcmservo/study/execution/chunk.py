"""Execution of one chunk of a study: the request that a worker gets, and the rows it returns."""

from dataclasses import astuple
from functools import lru_cache
from typing import Any, NamedTuple

from rcmservo.errors import RcmServoError
from rcmservo.servo.servo import Servo
from rcmservo.sim.scene import NoScene
from rcmservo.study.compiled_engine import CompiledEngine
from rcmservo.study.execution.package_version import identify_package
from rcmservo.study.plan.cell import Cell, parse_cell
from rcmservo.study.plan.user_module_archive import ModuleArchive, load_classes
from rcmservo.study.row import RunLabels, StudyRow, make_row
from rcmservo.study.run_outcome import StudyRun
from rcmservo.study.simulation_engine import SimulationEngine


class PackageMismatch(RcmServoError):
    """Worker with another version of rcmservo than this machine."""


class ChunkRequest(NamedTuple):
    """Request for the runs of a chunk, which a worker decodes before it imports the user's code.

    Parameters
    ----------
    cell : str
        Cell, as `Cell.text`.
    seeds : range
        Seeds of the scenes.
    package : str
        Version and hash of rcmservo that the worker must have.
    archive : ModuleArchive
        Module of the user-defined estimator; empty for a built-in one.
    """

    cell: str
    seeds: range
    package: str
    archive: ModuleArchive


RowValues = tuple[Any, ...]
"""Values of a row in the order of its columns: they are faster to send than a `StudyRow`."""


def run_chunk(request: ChunkRequest) -> list[RowValues]:
    """Run a chunk and return its rows.

    Raises
    ------
    PackageMismatch
        If this worker has another version of rcmservo than requested.
    """
    if request.package != identify_package():
        raise PackageMismatch(
            f"a worker has another rcmservo ({identify_package()}) than this machine "
            f"({request.package}): install the same version there"
        )
    cell, servo = _decode_cell(request.cell, request.archive)
    return [astuple(run_seed(cell, servo, seed)) for seed in request.seeds]


@lru_cache(maxsize=16)
def _decode_cell(text: str, archive: ModuleArchive) -> tuple[Cell, Servo]:
    """Return the cell of a request and its servo; the chunks of a cell share both."""
    cell = parse_cell(text)
    return cell, cell.rebuild_servo(load_classes(archive))


def run_seed(cell: Cell, servo: Servo, seed: int) -> StudyRow:
    """Run one seed of a cell and return its row."""
    engine = cell.make_engine(seed, servo)
    return make_row(cell, engine.settings, run_engine(engine, cell, seed))


def run_engine(engine: CompiledEngine | SimulationEngine, labels: RunLabels, seed: int) -> StudyRun:
    """Run one seed on an engine; an error names the labels' scenes and the seed."""
    try:
        return engine.run(seed, labels.repetition)
    except NoScene as error:
        raise NoScene(f"scenes {labels.scenes}, seed {seed}: {error}") from error
