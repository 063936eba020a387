"""Closed loop of one method in one scene.

The scene, the target and the noise of each frame depend on the seed only, not on the method.
"""

from dataclasses import dataclass, replace

import numpy as np

from rcmservo.control.exploration import Exploration
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.estimation.base import Estimator
from rcmservo.paper.lab.calibration import Calibration, Quality, make_calibration
from rcmservo.paper.lab.closed_loop import make_servo
from rcmservo.paper.lab.evaluation import STRIDE_TICKS
from rcmservo.paper.lab.paper_settings import FAST_CONTROLLER, FAST_ESTIMATOR, TEACHING_FRAMES
from rcmservo.paper.lab.pose_controller import PoseController
from rcmservo.paper.statistics import median
from rcmservo.recording.final_pose import FINAL_WINDOW_S
from rcmservo.safety.state_machine import Phase
from rcmservo.servo.servo import Servo
from rcmservo.sim import RigSettings
from rcmservo.sim.rig import sample_scene_of_seed
from rcmservo.study.compiled_engine import CompiledEngine
from rcmservo.study.plan.conditions import COMPILED, MUJOCO
from rcmservo.study.run_outcome import StudyRun
from rcmservo.study.simulation_engine import SimulationEngine, SimulationLoop

STOPPED_PHASES = Phase.PAUSED, Phase.FAULT
"""Phases that only an operator can end."""
AT_REST_S = 0.5
"""Time (s) after which the tool is at rest in one of these phases."""


@dataclass(frozen=True)
class Attempt:
    """Run of a method in one scene.

    Parameters
    ----------
    seed : int
        Seed of the scene and of the noise.
    settings : RigSettings
        Settings of the simulated laboratory.
    duration : float
        Time (s) after the exploration.
    """

    seed: int
    settings: RigSettings
    duration: float

    def calibration(self, quality: Quality) -> Calibration:
        """Return the calibration for a method; the directions of its errors depend on the seed."""
        scene, _ = sample_scene_of_seed(self.seed, self.settings)
        return make_calibration(quality, scene.optics, np.random.default_rng([self.seed, 1]))

    def servo(
        self,
        estimator: Estimator,
        exploration: Exploration,
        controller: SaturatedController = FAST_CONTROLLER,
    ) -> Servo:
        """Return a servo, by default with the common controller."""
        return make_servo(self.settings, estimator, exploration, controller)

    def run(self, servo: Servo) -> StudyRun:
        """Explore, then servo for the duration.

        A servo with a compiled step runs on the compiled simulation, others on MuJoCo's arm.
        """
        return self.run_compiled(servo) if servo.kernel is not None else self.run_live(servo)

    def run_compiled(self, servo: Servo) -> StudyRun:
        """Run on the compiled simulation."""
        max_duration = servo.exploration.max_time + self.duration
        run = CompiledEngine(servo, self.settings, max_duration, TEACHING_FRAMES).run(self.seed)
        return replace(self._cut(run), engine=COMPILED)

    def run_live(self, servo: Servo) -> StudyRun:
        """Run with MuJoCo's arm and the code of live runs."""
        loop = self._simulate(servo, servo.exploration.max_time + self.duration)
        end, moving, jacobian_errors = np.inf, 0.0, list[float]()
        for k, tick in enumerate(loop.ticks()):
            time, phase = tick.time / 1e9, tick.state.phase
            moving = moving if phase in STOPPED_PHASES else time
            if phase is Phase.SERVO:
                end = min(end, time + self.duration)
                if k % STRIDE_TICKS == 0:
                    jacobian_errors.append(loop.rig.truth.jacobian_error_at_tick(tick))
            if time >= min(end, moving + AT_REST_S + FINAL_WINDOW_S):
                break
        jacobian_error = median(jacobian_errors)
        return replace(self._cut(loop.outcome), engine=MUJOCO, jacobian_error=jacobian_error)

    def run_by_poses(self, calibration: Calibration) -> StudyRun:
        """Run pose-based control, which does not explore."""
        servo = self.servo(FAST_ESTIMATOR, Exploration())
        loop = self._simulate(servo, self.duration)
        controller = PoseController(calibration, servo, loop.target, FAST_CONTROLLER.gain)
        controller.control(loop, self.duration)
        return replace(loop.outcome, engine=MUJOCO)

    def _simulate(self, servo: Servo, duration: float) -> SimulationLoop:
        engine = SimulationEngine(servo, self.settings, duration, TEACHING_FRAMES)
        return SimulationLoop(engine, self.seed, 0)

    def _cut(self, run: StudyRun) -> StudyRun:
        """Return the run up to the duration after its exploration; all of it without a servo."""
        return run.until(run.explored + self.duration)
