"""Closed loops of one servo on the compiled twin, each in a scene drawn from a seed."""

import signal
from collections.abc import Iterable, Iterator
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cached_property
from multiprocessing import Pool
from typing import Annotated

import numpy as np

from rcmservo.config.registry import ESTIMATORS
from rcmservo.constraints import Checked, positive
from rcmservo.errors import require
from rcmservo.interfaces import Floats
from rcmservo.loop.target_frames import FRAMES, TEACHING_FRAMES
from rcmservo.numerics.structs import changed, copied
from rcmservo.servo.servo import Servo, State
from rcmservo.servo.user_estimator import compiles
from rcmservo.sim import RigSettings
from rcmservo.sim.arm import HARD_STOP_RATIO
from rcmservo.sim.scene import Scene
from rcmservo.study.cramer_rao import bound
from rcmservo.study.inertia import inertia_of
from rcmservo.study.kernel_engine import Course, Goal, Start, closed_loop
from rcmservo.study.plant_kernel import QUEUE, STEP, Drives, Pace, Twin
from rcmservo.study.run_outcome import StudyRun
from rcmservo.study.trial import frames_of, trial

BEGIN = 1_000_000_000
"""ns on the twin's clock at the first tick."""


@dataclass(frozen=True)
class Study(Checked):
    """A servo, and what its scenes are drawn from. The servo's step is the live one.

    Parameters
    ----------
    servo : Servo
        The servo; its estimator must be one whose step is compiled.
    settings : RigSettings
        The laboratory, with the camera that tells points.
    duration : float
        Length of each closed loop, s.
    shown : int
        Frames that the target is the mean of.
    """

    servo: Servo
    settings: RigSettings = field(default_factory=RigSettings)
    duration: Annotated[float, positive("time in s")] = 15.0
    shown: Annotated[int, FRAMES] = TEACHING_FRAMES

    def __post_init__(self) -> None:
        super().__post_init__()
        kinds = " or ".join(k.__name__ for k in ESTIMATORS.values() if compiles(k))
        name = type(self.servo.estimator).__name__
        good = self.servo.kernel is not None
        require(good, "servo.estimator", name, f"{kinds}, whose steps are compiled")
        for box in ("mechanism", "tool"):
            known, there = getattr(self.servo, box), getattr(self.settings, box)
            require(known == there, f"servo.{box}", known, f"that of the laboratory, {there}")
        slow = self.settings.drive.delay * self.servo.rate < QUEUE
        require(slow, "drive.delay", self.settings.drive.delay, f"below {QUEUE} ticks")

    def run(self, seed: int, repetition: int = 0) -> StudyRun:
        """One closed loop, in the scene that `Rig(seed)` has, each repetition with noise of its
        own.
        """
        given = trial(seed, repetition, self.settings, self.duration, self.shown)
        return self.of(seed, *given)

    def of(self, seed: int, scene: Scene, shown: Goal, noise: Floats) -> StudyRun:
        """One closed loop in a scene, to what was shown, with the noise (frames, 2, 2) px."""
        good = noise.shape[0] >= self._frames and noise.shape[1:] == (2, 2)
        require(good, "noise", noise.shape, f"of shape (2, 2) for at least {self._frames} frames")
        ticks = round(self.duration * self.servo.rate)
        trace = Course(np.empty(ticks), np.empty(ticks, np.int8), np.empty(ticks, np.int8))
        closed_loop(self._start, self._twin(scene).rows, shown, noise, trace)
        least = bound(scene, self.settings.point_noise, self._frames, self.shown).rms
        return StudyRun(seed, self.servo.rate, trace.error, trace.phase, trace.cause, least, scene)

    def runs(self, seeds: Iterable[int]) -> Iterator[StudyRun]:
        """A closed loop of every seed, in their order, on all cores."""
        self.run(0)  # compiled once, not by every process at a time
        with Pool(initializer=_handle_signals) as pool:
            yield from pool.imap(self.run, seeds, chunksize=8)

    @property
    def _frames(self) -> int:
        return frames_of(self.settings, self.duration)

    @property
    def _start(self) -> Start:
        """The servo at the start, in memory of its own."""
        servo, state = self.servo, self._ignorant
        stored, memory = copied(state.stored).rows, deepcopy(state.memory)
        return Start(stored, memory, servo.parameters, servo.kernel, BEGIN)

    @cached_property
    def _ignorant(self) -> State:
        return self.servo.init()

    def _twin(self, scene: Scene) -> Twin:
        """The laboratory before a scene's start."""
        timing = self.settings.timing
        late = round((0.5 * timing.exposure + timing.delay) * 1e9)
        pace = Pace.of(period=1e9 / timing.frame_rate, late=late)
        drives, lens = changed(self._drives, q=scene.start), scene.optics.lens
        return Twin.of(drives=drives, lens=lens, pace=pace)

    @cached_property
    def _drives(self) -> Drives:
        """The arm, wherever it stands."""
        drive, limits = self.settings.drive, self.settings.mechanism.limits
        lower, upper = limits.arrays
        made = 1.0 + np.array(drive.rate_error)
        middle, half = (upper + lower) / 2.0, (upper - lower) / 2.0
        return Drives.of(
            delay=round(drive.delay * 1e9),
            follow=1.0 - np.exp(-STEP * 1e-9 / drive.lag),
            deadband=made * drive.deadband,
            encoder=np.maximum(drive.encoder, 1e-12),
            offset=drive.encoder_offset,
            made=made,
            lower=middle - HARD_STOP_RATIO * half,
            upper=middle + HARD_STOP_RATIO * half,
            inertia=inertia_of(self.settings.mechanism).rows,
        )


def _handle_signals() -> None:
    """Leave Ctrl-C to the parent of this worker process, and end at SIGTERM: a handler of the
    parent's, which a fork copies, could ignore it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
