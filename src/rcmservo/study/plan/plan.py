"""A study: methods x scenes x noise x latency x disturbances x repetitions, as cells, and the seeds
that each is tried on.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple

from rcmservo.config.servo_json import describe
from rcmservo.errors import BadInput, require
from rcmservo.sim import Disturbance
from rcmservo.study.plan.cell import Cell, engine_of
from rcmservo.study.plan.conditions import COMPILED, MOST, MUJOCO, PICTURES, StudyConditions
from rcmservo.study.plan.distribution import Distribution
from rcmservo.study.plan.method import StudyMethod, tried

SIZES = {COMPILED: 100, MUJOCO: 4, PICTURES: 1}
"""Seeds of a chunk: a fraction of a second of work, so that little is lost with a worker."""


class Chunk(NamedTuple):
    """Runs that are made, kept and lost together.

    Parameters
    ----------
    cell : Cell
        What they are runs of.
    seeds : range
        Of their scenes.
    """

    cell: Cell
    seeds: range


@dataclass(frozen=True, kw_only=True)
class StudyPlan(StudyConditions):
    """Methods and scenes that a study tries, and the conditions.

    Parameters
    ----------
    methods : tuple[StudyMethod, ...]
        Compared on the same scenes with the same noise; the first is what the others are held
        against.
    scenes : tuple[Distribution, ...]
        What scenes are drawn from.
    """

    methods: tuple[StudyMethod, ...]
    scenes: tuple[Distribution, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        right = "left out with pictures, whose noise is the tracker's"
        require(self.engine != PICTURES or not self.noise, "noise", list(self.noise), right)
        require(bool(self.methods), "method", "none", "at least one")
        require(bool(self.scenes), "scenes", "none", "at least one")
        require(
            bool(self.disturb), "disturb", "[]", "at least one set; [[]] for none that is wrong"
        )
        for what, names in (("method", self.methods), ("scenes", self.scenes)):
            _require_once(what, [one.name for one in names])
        for name in ("noise", "latency"):
            _require_once(name, list(getattr(self, name)))
        _require_once("disturb", list(self.disturb))
        require(self.runs <= MOST, "runs in all", self.runs, f"at most {MOST}")

    @property
    def runs(self) -> int:
        """How many closed loops there are."""
        cells = len(self.methods) * len(self.scenes) * max(len(self.noise), 1)
        cells *= max(len(self.latency), 1) * len(self.disturb) * self.repetitions
        return cells * self.count

    @cached_property
    def cells(self) -> tuple[Cell, ...]:
        """Every cell, the methods of a condition after each other."""
        return tuple(self._cells())

    def _cells(self) -> Iterator[Cell]:
        noises, latencies = self.noise or (None,), self.latency or (None,)
        axes = self.scenes, noises, latencies, self.disturb, range(self.repetitions)
        for scenes, noise, latency, disturb, repetition in product(*axes):
            seen = scenes.seen(noise, self._delay(scenes, latency))
            asked = (
                scenes.name,
                f"{noise:.12g} px" if noise is not None else "",
                f"{1e3 * latency:.12g} ms" if latency is not None else "",
                *disturb,
            )
            for method in self.methods:
                condition = ", ".join(filter(None, asked))
                yield self._cell(method, condition, seen, disturb, repetition)

    def chunks(self) -> Iterator[Chunk]:
        """All runs, a few at a time, in the order of their rows."""
        end = self.first_seed + self.count
        for cell in self.cells:
            size = SIZES[cell.engine]
            first = self.first_seed - self.first_seed % size  # other studies share such chunks
            for begin in range(first, end, size):
                yield Chunk(cell, range(max(begin, self.first_seed), min(begin + size, end)))

    def _delay(self, scenes: Distribution, latency: float | None) -> float | None:
        """The camera's delay after the exposure that makes this latency."""
        if latency is None:
            return None
        half = 0.5 * scenes.fixed[1].timing.exposure
        require(latency >= half, "latency", latency, f"at least half of the exposure, {half:g} s")
        return latency - half

    def _cell(
        self,
        method: StudyMethod,
        condition: str,
        scenes: Distribution,
        disturb: tuple[str, ...],
        repetition: int,
    ) -> Cell:
        servo = tried(method, scenes.fixed[0])
        told = tuple(str(Disturbance.read(one)) for one in disturb)
        cell = Cell(
            method=method.name,
            servo=describe(servo),
            source=method.parcel.digest,
            condition=condition,
            scenes=scenes.name,
            tables=scenes.tables,
            vary=scenes.vary,
            disturb=told,
            repetition=repetition,
            engine=engine_of(servo, told, self.engine),
            duration=self.duration,
            shown=self.shown,
        )
        cell.engine_for(self.first_seed, servo)
        return cell


def _require_once(what: str, names: list[object]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise BadInput(what, name, "given once")
