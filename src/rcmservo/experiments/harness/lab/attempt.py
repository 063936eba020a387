"""One method in one scene: a closed loop of a study, with the scene, the target as it was shown and
the noise of every frame that the seed has for all methods."""

from dataclasses import dataclass, field

import numpy as np

from rcmservo.experiments.harness.lab.closed_loop import FAST_FIT, FAST_LAW, SHOWN, servo_for
from rcmservo.experiments.harness.lab.others.calibration import (
    Calibration,
    Miscalibration,
    Quality,
    handed_over,
)
from rcmservo.experiments.harness.lab.others.laws import PoseLaw, drive
from rcmservo.experiments.harness.lab.witness import EVERY
from rcmservo.experiments.harness.statistics import median
from rcmservo.guard.states import Phase
from rcmservo.loop.tick import Tick
from rcmservo.method.controller import SaturatedController
from rcmservo.method.estimators.base import Estimator
from rcmservo.method.exploration import Exploration
from rcmservo.servo.servo import Servo
from rcmservo.sim import RigSettings, SceneSettings
from rcmservo.sim.rig import drawn
from rcmservo.sim.truth import Truth
from rcmservo.study.batch import Study
from rcmservo.study.course import LAST, StudyRun
from rcmservo.study.laboratory import Laboratory, LaboratoryLoop
from rcmservo.study.plan.cell import COMPILED, MUJOCO

FOR_GOOD = Phase.PAUSED, Phase.FAULT
"""Phases that only a person leads out of."""

AT_REST = 0.5
"""s within which the tool stands still once it is in one of these."""


@dataclass(frozen=True)
class Conditions:
    """What is the same for every method."""

    noise: float = 0.3
    """px, of every marker coordinate."""
    duration: float = 8.0
    """s after the exploration."""
    controller: SaturatedController = FAST_LAW
    """Of every servo but our default's; laws that are not a servo's take its gain k and its
    greatest speed."""
    miscalibration: Miscalibration = field(default_factory=Miscalibration)
    """How wrong a wrong calibration is."""
    roll: float = float(np.radians(90.0))
    """rad by which the camera was rolled after it had been calibrated."""

    def laboratory(self, scene: SceneSettings) -> RigSettings:
        """The one that such scenes are drawn in."""
        return RigSettings(point_noise=self.noise, scene=scene)


@dataclass(frozen=True, eq=False)
class Fared:
    """How a method fared in a scene."""

    run: StudyRun
    """By the truth."""
    engine: str
    """What made it."""
    jacobian: float = np.nan
    """Median scaled error of Ĵ while the tool was servoed; NaN where no Ĵ was looked at: that of
    the compiled twin stays inside."""


@dataclass(frozen=True)
class Attempt:
    """A method's chance in one scene."""

    seed: int
    """All that is drawn comes from it."""
    settings: RigSettings
    """The laboratory."""
    conditions: Conditions
    """The same for every method."""

    def calibration(self, quality: Quality) -> Calibration:
        """What a person hands over; wrong in directions drawn from the seed."""
        scene, _ = drawn(self.seed, self.settings)
        random, given = np.random.default_rng([self.seed, 1]), self.conditions
        return handed_over(quality, scene.optics, given.miscalibration, given.roll, random)

    def servo(
        self,
        estimator: Estimator,
        exploration: Exploration,
        controller: SaturatedController | None = None,
    ) -> Servo:
        """A servo, if not with a controller of its own with that of all methods."""
        law = controller or self.conditions.controller
        return servo_for(self.settings, estimator, exploration, law)

    def servo_by(self, servo: Servo) -> Fared:
        """Explore, then servo for as long as every method has: on the compiled twin where the
        servo's step is compiled, else before MuJoCo's arm."""
        return self.compiled(servo) if servo.rule is not None else self.live(servo)

    def compiled(self, servo: Servo) -> Fared:
        """`servo_by` on the compiled twin."""
        run = Study(servo, self.settings, self._longest(servo), SHOWN).run(self.seed)
        return Fared(run.until(self._end(run)), COMPILED)

    def live(self, servo: Servo) -> Fared:
        """`servo_by` before MuJoCo's arm, by the live path."""
        longest = self._longest(servo)
        loop = LaboratoryLoop(Laboratory(servo, self.settings, longest, SHOWN), self.seed, 0)
        end, going, errors = np.inf, 0.0, list[float]()
        for k, tick in enumerate(loop.ticks()):
            time, phase = tick.time / 1e9, tick.state.phase
            going = going if phase in FOR_GOOD else time
            if phase is Phase.SERVO:
                end = min(end, time + self.conditions.duration)
                if k % EVERY == 0:
                    errors.append(_wrong(loop.rig.truth, tick))
            if time >= min(end, going + AT_REST + LAST):
                break
        run = loop.run
        return Fared(run.until(self._end(run)), MUJOCO, median(errors))

    def by_poses(self, calibration: Calibration) -> Fared:
        """Move by pose-based control, which explores nothing."""
        given, robot = self.conditions, self.servo(FAST_FIT, Exploration())
        laboratory = Laboratory(robot, self.settings, given.duration, SHOWN)
        loop = LaboratoryLoop(laboratory, self.seed, 0)
        law = PoseLaw(calibration, robot, loop.target, given.controller.gain)
        drive(loop, robot, law, given.duration)
        return Fared(loop.run, MUJOCO)

    def _longest(self, servo: Servo) -> float:
        """s that a run takes if its exploration takes all the time that it may."""
        return servo.exploration.max_time + self.conditions.duration

    def _end(self, run: StudyRun) -> float:
        """s at which a run's time is over; inf where it never servoed."""
        return run.explored + self.conditions.duration


def _wrong(truth: Truth, tick: Tick) -> float:
    """The scaled error of Ĵ at a tick."""
    state = tick.state
    return truth.jacobian_error(state.J_hat, tick.seen.q_exposure, state.o_c)
