"""Plan of a study: methods x scenes x noise x latency x disturbances x repetitions, as cells.

Every cell runs on the same seeds.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple

from rcmservo.config.servo_json import describe_servo
from rcmservo.errors import BadInput, require
from rcmservo.sim import Disturbance
from rcmservo.study.plan.cell import Cell, choose_engine
from rcmservo.study.plan.conditions import COMPILED, MAX_RUNS, MUJOCO, PICTURES, StudyConditions
from rcmservo.study.plan.distribution import Distribution
from rcmservo.study.plan.method import StudyMethod, make_servo

CHUNK_SIZES = {COMPILED: 100, MUJOCO: 4, PICTURES: 1}
"""Seeds of a chunk by engine: below a second of work, so that a lost worker loses little."""


class Chunk(NamedTuple):
    """Runs that one worker makes and that are stored together.

    Parameters
    ----------
    cell : Cell
        Cell of the runs.
    seeds : range
        Seeds of the scenes.
    """

    cell: Cell
    seeds: range


@dataclass(frozen=True, kw_only=True)
class StudyPlan(StudyConditions):
    """Methods, distributions of scenes and conditions of a study.

    Parameters
    ----------
    methods : tuple[StudyMethod, ...]
        Methods, compared on the same scenes with the same noise; the first is the baseline.
    scenes : tuple[Distribution, ...]
        Distributions that scenes are drawn from.
    """

    methods: tuple[StudyMethod, ...]
    scenes: tuple[Distribution, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        expected = "left out with pictures, where the noise is that of the tracker"
        require(self.engine != PICTURES or not self.noise, "noise", list(self.noise), expected)
        require(bool(self.methods), "method", "none", "at least one")
        require(bool(self.scenes), "scenes", "none", "at least one")
        expected = "at least one set; [[]] for none, without disturbances"
        require(bool(self.disturb), "disturb", "[]", expected)
        for key, entries in (("method", self.methods), ("scenes", self.scenes)):
            _require_unique(key, [entry.name for entry in entries])
        for name in ("noise", "latency"):
            _require_unique(name, list(getattr(self, name)))
        _require_unique("disturb", list(self.disturb))
        require(self.runs <= MAX_RUNS, "runs in all", self.runs, f"at most {MAX_RUNS}")

    @property
    def runs(self) -> int:
        """Number of closed loops."""
        cells = len(self.methods) * len(self.scenes) * max(len(self.noise), 1)
        cells *= max(len(self.latency), 1) * len(self.disturb) * self.repetitions
        return cells * self.count

    @cached_property
    def cells(self) -> tuple[Cell, ...]:
        """All cells; the methods of a condition are consecutive."""
        return tuple(self._cells())

    def _cells(self) -> Iterator[Cell]:
        noises, latencies = self.noise or (None,), self.latency or (None,)
        axes = self.scenes, noises, latencies, self.disturb, range(self.repetitions)
        for scenes, noise, latency, disturb, repetition in product(*axes):
            distribution = scenes.with_camera(noise, self._delay(scenes, latency))
            label = (
                scenes.name,
                f"{noise:.12g} px" if noise is not None else "",
                f"{1e3 * latency:.12g} ms" if latency is not None else "",
                *disturb,
            )
            for method in self.methods:
                condition = ", ".join(filter(None, label))
                yield self._cell(method, condition, distribution, disturb, repetition)

    def chunks(self) -> Iterator[Chunk]:
        """Yield all runs in chunks, in the order of their rows."""
        end = self.first_seed + self.count
        for cell in self.cells:
            size = CHUNK_SIZES[cell.engine]
            # Chunks begin at multiples of their size, so that several studies share them.
            first = self.first_seed - self.first_seed % size
            for begin in range(first, end, size):
                yield Chunk(cell, range(max(begin, self.first_seed), min(begin + size, end)))

    def _delay(self, scenes: Distribution, latency: float | None) -> float | None:
        """Return the camera's delay after the exposure (s) that gives a latency (s)."""
        if latency is None:
            return None
        half = 0.5 * scenes.nominal[1].timing.exposure
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
        servo = make_servo(method, scenes.nominal[0])
        disturbances = tuple(str(Disturbance.read(text)) for text in disturb)
        cell = Cell(
            method=method.name,
            servo=describe_servo(servo),
            source=method.archive.digest,
            condition=condition,
            scenes=scenes.name,
            tables=scenes.tables,
            vary=scenes.vary,
            disturb=disturbances,
            repetition=repetition,
            engine=choose_engine(servo, disturbances, self.engine),
            duration=self.duration,
            teaching_frames=self.teaching_frames,
        )
        cell.make_engine(self.first_seed, servo)
        return cell


def _require_unique(key: str, entries: list[object]) -> None:
    for entry in entries:
        if entries.count(entry) > 1:
            raise BadInput(key, entry, "given once")
