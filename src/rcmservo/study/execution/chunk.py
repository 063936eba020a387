"""A chunk of a study, done: what a worker is sent, and the rows that it sends back."""

from dataclasses import astuple
from functools import lru_cache
from typing import Any, NamedTuple

from rcmservo.errors import RcmServoError
from rcmservo.servo.servo import Servo
from rcmservo.sim.scene import NoScene
from rcmservo.study.execution.package_version import package
from rcmservo.study.plan.cell import Cell, cell_from
from rcmservo.study.plan.user_module_archive import Parcel, classes
from rcmservo.study.row import StudyRow, row_of


class OtherPackage(RcmServoError):
    """A worker with another rcmservo than the one that asks."""


class ChunkOrder(NamedTuple):
    """What a worker is to do: plain texts, whatever has been imported there.

    Parameters
    ----------
    cell : str
        The cell, as text.
    begin : int
        The first seed.
    end : int
        The last seed, and one more.
    package : str
        What the package must be known by.
    parcel : Parcel
        The user's own module that is needed.
    """

    cell: str
    begin: int
    end: int
    package: str
    parcel: Parcel


Numbers = tuple[Any, ...]
"""A row's values in the order of its columns: quicker to send than rows."""


def done(order: ChunkOrder) -> list[Numbers]:
    """The rows of a chunk."""
    if order.package != package():
        raise OtherPackage(
            f"a worker has another rcmservo ({package()}) than this machine ({order.package}): "
            "install the same version there"
        )
    cell, servo = _prepared(order.cell, order.parcel)
    return [astuple(one_run(cell, servo, seed)) for seed in range(order.begin, order.end)]


@lru_cache(maxsize=16)
def _prepared(text: str, parcel: Parcel) -> tuple[Cell, Servo]:
    cell = cell_from(text)
    return cell, cell.rebuilt(classes(parcel))


def one_run(cell: Cell, servo: Servo, seed: int) -> StudyRow:
    """The run of one seed."""
    engine = cell.engine_for(seed, servo)
    try:
        run = engine.run(seed, cell.repetition)
    except NoScene as error:
        raise NoScene(f"scenes {cell.scenes}, seed {seed}: {error}") from error
    return row_of(cell, engine.settings, run)
