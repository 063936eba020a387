"""Many closed loops of one servo, each in a scene drawn from a seed: what a study is made of."""

import signal
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from multiprocessing import Pool
from typing import cast

import numpy as np
from numpy.typing import NDArray

from rcmservo.errors import require
from rcmservo.guard.causes import CAUSES, Cause
from rcmservo.guard.states import PHASES, Phase
from rcmservo.interfaces import Floats
from rcmservo.servo.compiled_ones import COMPILED, AnyRule
from rcmservo.servo.servo import Servo
from rcmservo.sim import RigSettings
from rcmservo.sim.arm import HARD_STOP
from rcmservo.sim.rig import drawn
from rcmservo.sim.scene import Scene
from rcmservo.study.closed_loop import Course, Goal, Start, closed_loop
from rcmservo.study.cramer_rao import bound
from rcmservo.study.inertia import inertia_of
from rcmservo.study.twin import PAST, QUEUE, STEP, Drives, Pace, Twin

BEGIN = 1_000_000_000
"""ns on the twin's clock at the first tick."""


@dataclass(frozen=True, eq=False)
class StudyRun:
    """How one closed loop went: numbers of every tick."""

    seed: int
    """That its scene and noise were drawn from."""
    rate: float
    """Ticks per s."""
    error: Floats
    """(n,) mm from marker 2 to where it was shown, by the truth."""
    phases: NDArray[np.int8]
    """(n,) places in Phase."""
    causes: NDArray[np.int8]
    """(n,) places in Cause."""
    bound: float
    """mm, rms: the Cramér-Rao bound of the error, at the laboratory's noise, of a target that was
    shown so, with all frames of the closed loop."""

    def first_within(self, mm: float) -> float:
        """s until the error was first at most so large; inf if it never was."""
        there = np.flatnonzero(self.error <= mm)
        return float(there[0] / self.rate) if len(there) else np.inf

    @cached_property
    def stops(self) -> list[tuple[float, Cause]]:
        """s and cause of every stop: HOLD, PAUSED or FAULT after what was none of them."""
        stopping = [PHASES.index(phase) for phase in (Phase.HOLD, Phase.PAUSED, Phase.FAULT)]
        stands = np.isin(self.phases, stopping).astype(np.int8)
        begun = np.flatnonzero(np.diff(stands, prepend=0) > 0)
        return [(float(k / self.rate), CAUSES[self.causes[k]]) for k in begun]


@dataclass(frozen=True)
class Study:
    """A servo, and what its scenes are drawn from. The servo's step is the live one."""

    servo: Servo
    """The servo; its estimator must be one whose step is compiled."""
    settings: RigSettings = field(default_factory=RigSettings)
    """The laboratory, with the camera that tells points."""
    duration: float = 15.0
    """Length of each closed loop, s."""
    shown: int = 30
    """Frames that the target is the mean of."""

    def __post_init__(self) -> None:
        kinds = " or ".join(kind.__name__ for kind in COMPILED)
        name = type(self.servo.estimator).__name__
        good = self.servo.rule is not None
        require(good, "servo.estimator", name, f"{kinds}, whose steps are compiled")
        require(0.0 < self.duration < np.inf, "duration", self.duration, "a positive time in s")
        require(self.shown >= 1, "shown", self.shown, "at least 1 frame")
        for box in ("mechanism", "tool"):
            known, there = getattr(self.servo, box), getattr(self.settings, box)
            require(known == there, f"servo.{box}", known, f"that of the laboratory, {there}")
        slow = self.settings.drive.delay * self.servo.rate < QUEUE
        require(slow, "drive.delay", self.settings.drive.delay, f"below {QUEUE} ticks")

    def run(self, seed: int) -> StudyRun:
        """One closed loop, in the scene that `Rig(seed)` has."""
        scene, random = drawn(seed, self.settings)
        markers = scene.body.points(scene.target)[:2]
        blur = random.standard_normal((2, 2)) / np.sqrt(self.shown)
        points = scene.optics.project(markers) + self.settings.point_noise * blur
        noise = self.settings.point_noise * random.standard_normal((self._frames, 2, 2))
        told = self.settings.drive.told(scene.target)
        return self.of(seed, scene, Goal(points, told, markers[1]), noise)

    def of(self, seed: int, scene: Scene, shown: Goal, noise: Floats) -> StudyRun:
        """One closed loop in a scene, to what was shown, with the noise (frames, 2, 2) px."""
        good = noise.shape[0] >= self._frames and noise.shape[1:] == (2, 2)
        require(good, "noise", noise.shape, f"of shape (2, 2) for at least {self._frames} frames")
        ticks = round(self.duration * self.servo.rate)
        trace = Course(np.empty(ticks), np.empty(ticks, np.int8), np.empty(ticks, np.int8))
        closed_loop(self._start, self._twin(scene), shown, noise, trace)
        least = bound(scene, self.settings.point_noise, self._frames, self.shown).rms
        return StudyRun(seed, self.servo.rate, trace.error, trace.phase, trace.cause, least)

    def runs(self, seeds: Iterable[int]) -> Iterator[StudyRun]:
        """A closed loop of every seed, in their order, on all cores."""
        self.run(0)  # compiled once, not by every process at a time
        with Pool(initializer=signal.signal, initargs=(signal.SIGINT, signal.SIG_IGN)) as pool:
            yield from pool.imap(self.run, seeds, chunksize=8)

    @property
    def _frames(self) -> int:
        return int(self.duration * self.settings.timing.frame_rate) + 2

    @property
    def _start(self) -> Start:
        """The servo at the start, in memory of its own."""
        servo, state = self.servo, self.servo.init()
        return Start(state.kept.rows, state.beside, servo.fixed, cast(AnyRule, servo.rule), BEGIN)

    def _twin(self, scene: Scene) -> Twin:
        """The laboratory before a scene's start."""
        timing = self.settings.timing
        late = round((0.5 * timing.exposure + timing.delay) * 1e9)
        pace = Pace.of(period=1e9 / timing.frame_rate, late=late)
        rings = np.zeros((QUEUE, 3)), np.zeros(QUEUE, np.int64), np.zeros((PAST, 3))
        drives = self._drives(scene.start).rows
        frame = np.full(3, np.nan), np.full((2, 2), np.nan)
        return Twin(drives, *rings, np.zeros((PAST, 3)), scene.optics.lens, pace.rows, *frame)

    def _drives(self, q: Floats) -> Drives:
        drive, limits = self.settings.drive, self.settings.mechanism.limits
        lower, upper = limits.arrays
        made = 1.0 + np.array(drive.rate_error)
        middle, half = (upper + lower) / 2.0, (upper - lower) / 2.0
        return Drives.of(
            q=q,
            delay=round(drive.delay * 1e9),
            follow=1.0 - np.exp(-STEP * 1e-9 / drive.lag),
            deadband=made * drive.deadband,
            encoder=np.maximum(drive.encoder, 1e-12),
            offset=drive.encoder_offset,
            made=made,
            lower=middle - HARD_STOP * half,
            upper=middle + HARD_STOP * half,
            inertia=inertia_of(self.settings.mechanism).rows,
        )
