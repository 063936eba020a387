"""Plan of a study: methods x scenes x noise x latency x disturbances x repetitions.

Each combination of these is a cell. All cells run on the same seeds.
"""

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

from rcmservo.config.servo_json import describe_servo
from rcmservo.errors import require
from rcmservo.sim import Disturbance
from rcmservo.study.plan.cell import Cell, choose_engine
from rcmservo.study.plan.conditions import COMPILED, MAX_RUNS, MUJOCO, PICTURES, StudyConditions
from rcmservo.study.plan.distribution import Distribution
from rcmservo.study.plan.method import StudyMethod, make_servo

CHUNK_SIZES = {COMPILED: 100, MUJOCO: 4, PICTURES: 1}
"""Number of seeds of a chunk by engine: less than a second of work, so that a lost worker loses
little."""


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
        entries_of: dict[str, list[Any]] = {
            "method": [method.name for method in self.methods],
            "scenes": [scenes.name for scenes in self.scenes],
            **{name: list(getattr(self, name)) for name in ("noise", "latency", "disturb")},
        }
        for setting, entries in entries_of.items():
            for entry in entries:
                require(entries.count(entry) == 1, setting, entry, "given once")
        require(self.runs <= MAX_RUNS, "runs in all", self.runs, f"at most {MAX_RUNS}")

    @property
    def runs(self) -> int:
        """Number of closed loops."""
        return math.prod(map(len, self._condition_axes)) * len(self.methods) * self.count

    @property
    def _condition_axes(self) -> tuple[Collection[Any], ...]:
        """Values of every condition; None for the noise or the latency of the scenes."""
        noises, latencies = self.noise or (None,), self.latency or (None,)
        return self.scenes, noises, latencies, self.disturb, range(self.repetitions)

    @cached_property
    def cells(self) -> tuple[Cell, ...]:
        """All cells; the methods of a condition are consecutive."""
        return tuple(self._make_cells())

    @cached_property
    def _engine(self) -> str:
        """Engine of all cells: methods compared with each other run on the same one."""
        lab = self.scenes[0].nominal[0]
        servos = (make_servo(method, lab) for method in self.methods)
        return choose_engine(servos, any(self.disturb), self.engine)

    def _make_cells(self) -> Iterator[Cell]:
        for scenes, noise, latency, disturb, repetition in product(*self._condition_axes):
            delay = self._find_camera_delay(scenes, latency)
            distribution = scenes.with_camera(noise, delay).with_arm(self.arm)
            noise_label = f"{noise:.12g} px" if noise is not None else ""
            latency_label = f"{1e3 * latency:.12g} ms" if latency is not None else ""
            arm_label = f"{self.arm} arm" if self.arm != "ideal" else ""
            labels = scenes.name, noise_label, latency_label, arm_label, *disturb
            condition = ", ".join(filter(None, labels))
            for method in self.methods:
                yield self._make_cell(method, condition, distribution, disturb, repetition)

    def chunks(self) -> Iterator[Chunk]:
        """Yield all runs in chunks, in the order of their rows."""
        end = self.first_seed + self.count
        for cell in self.cells:
            size = CHUNK_SIZES[cell.engine]
            # chunks begin at multiples of their size, so that studies of other seeds share them
            first_begin = self.first_seed - self.first_seed % size
            for begin in range(first_begin, end, size):
                yield Chunk(cell, range(max(begin, self.first_seed), min(begin + size, end)))

    def _find_camera_delay(self, scenes: Distribution, latency: float | None) -> float | None:
        """Return the camera's delay after the exposure (s) that gives a latency (s)."""
        if latency is None:
            return None
        half_s = 0.5 * scenes.nominal[1].timing.exposure
        expected = f"at least half of the exposure, {half_s:g} s"
        require(latency >= half_s, "latency", latency, expected)
        return latency - half_s

    def _make_cell(
        self,
        method: StudyMethod,
        condition: str,
        scenes: Distribution,
        disturb: tuple[str, ...],
        repetition: int,
    ) -> Cell:
        """Return a cell; raise `BadInput` if its engine does not support its runs."""
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
            engine=self._engine,
            duration=self.duration,
            teaching_frames=self.teaching_frames,
        )
        cell.make_engine(self.first_seed, servo)
        return cell
