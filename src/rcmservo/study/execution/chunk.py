"""Execution of one chunk of a study: the request that a worker gets, and the rows it returns."""

from dataclasses import astuple
from functools import lru_cache
from typing import Any, NamedTuple

from rcmservo.errors import RcmServoError
from rcmservo.servo.servo import Servo
from rcmservo.sim.scene import NoScene
from rcmservo.study.execution.package_version import package
from rcmservo.study.plan.cell import Cell, parse_cell
from rcmservo.study.plan.user_module_archive import ModuleArchive, load_classes
from rcmservo.study.row import StudyRow, make_row


class PackageMismatch(RcmServoError):
    """Worker with another version of rcmservo than this machine."""


class ChunkOrder(NamedTuple):
    """Request for the runs of a chunk, as plain text that needs no imports to be decoded.

    Parameters
    ----------
    cell : str
        Cell, as `Cell.text`.
    begin : int
        First seed.
    end : int
        Seed after the last one.
    package : str
        Version and hash of rcmservo that the worker must have.
    parcel : ModuleArchive
        Module of the user-defined estimator; empty for a built-in one.
    """

    cell: str
    begin: int
    end: int
    package: str
    parcel: ModuleArchive


RowValues = tuple[Any, ...]
"""Values of a row in the order of its columns: they are faster to send than a `StudyRow`."""


def done(order: ChunkOrder) -> list[RowValues]:
    """Run a chunk and return its rows.

    Raises
    ------
    PackageMismatch
        If this worker has another version of rcmservo than requested.
    """
    if order.package != package():
        raise PackageMismatch(
            f"a worker has another rcmservo ({package()}) than this machine ({order.package}): "
            "install the same version there"
        )
    cell, servo = _prepare(order.cell, order.parcel)
    return [astuple(one_run(cell, servo, seed)) for seed in range(order.begin, order.end)]


@lru_cache(maxsize=16)
def _prepare(text: str, archive: ModuleArchive) -> tuple[Cell, Servo]:
    cell = parse_cell(text)
    return cell, cell.rebuilt(load_classes(archive))


def one_run(cell: Cell, servo: Servo, seed: int) -> StudyRow:
    """Run one seed of a cell and return its row."""
    engine = cell.engine_for(seed, servo)
    try:
        run = engine.run(seed, cell.repetition)
    except NoScene as error:
        raise NoScene(f"scenes {cell.scenes}, seed {seed}: {error}") from error
    return make_row(cell, engine.settings, run)
