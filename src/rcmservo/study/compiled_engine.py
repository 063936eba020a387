"""Engine of a study: closed loops of one servo on the compiled plant.

The compiled plant is the simulated arm and camera as compiled functions, so that 10,000 loops take
about a minute.
"""

from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rcmservo.config.class_registry import ESTIMATORS
from rcmservo.errors import require
from rcmservo.interfaces import Floats
from rcmservo.numerics.structs import copy_row, replace_fields
from rcmservo.servo.servo import State
from rcmservo.servo.state import StoredState
from rcmservo.servo.user_estimator import is_compiled
from rcmservo.sim.arm import HARD_STOP_RATIO
from rcmservo.sim.scene import Scene
from rcmservo.study.inertia import compute_inertia
from rcmservo.study.kernel_engine import InitialConditions, LoopTrace, StudyGoal, run_closed_loop
from rcmservo.study.plant_kernel import (
    ARM_STEP_NS,
    QUEUE_LENGTH,
    DrivesStruct,
    FrameTimingStruct,
    PlantStruct,
)
from rcmservo.study.run_outcome import StudyRun
from rcmservo.study.trial import FIRST_TICK_NS, StudyEngine


@dataclass(frozen=True)
class CompiledEngine(StudyEngine):
    """Simulated closed loops of a servo, with its live step on a compiled plant.

    The scene, the target and the noise of every run follow from its seed, so that two servos with
    the same settings meet the same conditions.

    Parameters
    ----------
    servo : Servo
        The servo; its estimator must have a compiled step, as `DltEstimator` and
        `ProjectionEstimator` have, and its mechanism and tool must be those of the laboratory.
    settings : RigSettings
        The simulated laboratory, with a camera that measures points; ``rs.sim.RigSettings()`` by
        default.
    duration : float
        Length of each closed loop, s, positive.
    teaching_frames : int
        Number of frames whose mean is the target, at least 1.

    Raises
    ------
    BadInput
        If a parameter is outside its range, the estimator has no compiled step, mechanism or tool
        differ from those of the laboratory, or the delay of the drives is 128 ticks or more.

    Notes
    -----
    The compiled plant is that of `rcmservo.sim`: a run agrees with the simulated laboratory to a
    few 1e-6 mm. Disturbances, rendered frames and estimators in Python are not available.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        compiled_kinds = " or ".join(k.__name__ for k in ESTIMATORS.values() if is_compiled(k))
        kind, is_supported = type(self.servo.estimator).__name__, self.servo.kernel is not None
        expected = f"{compiled_kinds}, whose steps are compiled"
        require(is_supported, "servo.estimator", kind, expected)
        for part in ("mechanism", "tool"):
            known, simulated = getattr(self.servo, part), getattr(self.settings, part)
            expected = f"equal to that of the laboratory, {simulated}"
            require(known == simulated, f"servo.{part}", known, expected)
        delay_s = self.settings.drive.delay
        expected = f"shorter than {QUEUE_LENGTH} ticks"
        require(delay_s * self.servo.rate < QUEUE_LENGTH, "drive.delay", delay_s, expected)
        stamp_error, timing = self.settings.imperfections.stamp_error, self.settings.timing
        latency_s = 0.5 * timing.exposure + timing.delay
        expected = f"at most the latency of the camera, {latency_s:g} s"
        require(stamp_error <= latency_s, "imperfections.stamp_error", stamp_error, expected)

    def run(self, seed: int, repetition: int = 0) -> StudyRun:
        """Run one closed loop in the scene of `Rig(seed)`.

        Parameters
        ----------
        seed : int
            Seed of the scene and the noise, not negative.
        repetition : int
            Each repetition has other noise in the same scene.

        Returns
        -------
        StudyRun
            Error, phase and cause at every tick.
        """
        return self.of(seed, *self.draw_trial(seed, repetition))

    def of(self, seed: int, scene: Scene, goal: StudyGoal, noise: Floats) -> StudyRun:
        """Run one closed loop in a given scene.

        Parameters
        ----------
        seed : int
            Number that the run is labelled with.
        scene : Scene
            Camera, tool, start and target.
        goal : StudyGoal
            Target as it was taught.
        noise : Floats
            Noise (frames, 2, 2) px of every frame from the first tick on.

        Returns
        -------
        StudyRun
            Error, phase and cause at every tick.

        Raises
        ------
        BadInput
            If the noise has another shape or too few frames.
        """
        is_enough = noise.shape[0] >= self.frame_count and noise.shape[1:] == (2, 2)
        expected = f"of shape (2, 2) for at least {self.frame_count} frames"
        require(is_enough, "noise", noise.shape, expected)
        ticks, rate = round(self.duration * self.servo.rate), self.servo.rate
        trace = LoopTrace(np.empty(ticks), np.empty(ticks, np.int8), np.empty(ticks, np.int8))
        plant, start = self._make_plant(seed, scene), self._initial_conditions
        run_closed_loop(start, plant.rows, goal, noise, trace)
        bound_mm, decision = self.compute_bound(scene), StoredState(start.stored).decision
        run = StudyRun(seed, rate, trace.error, trace.phase, trace.cause, bound_mm, scene)
        return replace(run, pose_bound=float(decision.pose_bound))

    @property
    def _initial_conditions(self) -> InitialConditions:
        """The servo before the first tick, in memory that the loop may overwrite."""
        servo, state = self.servo, self._initial_state
        stored, memory = copy_row(state.stored).rows, deepcopy(state.memory)
        return InitialConditions(stored, memory, servo.parameters, servo.kernel, FIRST_TICK_NS)

    @cached_property
    def _initial_state(self) -> State:
        return self.servo.init()

    def _make_plant(self, seed: int, scene: Scene) -> PlantStruct:
        """Return the compiled plant of a seed at the start of a scene."""
        timing = self.settings.timing
        latency_ns = round((0.5 * timing.exposure + timing.delay) * 1e9)
        frame_timing = FrameTimingStruct.of(period=1e9 / timing.frame_rate, latency=latency_ns)
        errors = self.settings.imperfections.draw(seed)
        drives = replace_fields(
            self._drives,
            q=scene.start,
            tool_q=scene.start + errors.start_in_gap * errors.half_gap,
            rate_scale=self._drives.rate_scale * errors.rate_ratios,
            deadband=self._drives.deadband * errors.rate_ratios,
            stiction=self._drives.stiction * errors.rate_ratios,
        )
        return PlantStruct.of(
            drives=drives,
            camera=scene.optics.lens,
            frame_timing=frame_timing,
            imperfections=errors,
        )

    @cached_property
    def _drives(self) -> DrivesStruct:
        """The drives of the laboratory, with all joints at zero."""
        drive, (lower, upper) = self.settings.drive, self.settings.mechanism.limits.arrays
        rate_scale = 1.0 + np.array(drive.rate_error)
        middle, half_range = (upper + lower) / 2.0, (upper - lower) / 2.0
        return DrivesStruct.of(
            delay=round(drive.delay * 1e9),
            lag_gain=1.0 - np.exp(-ARM_STEP_NS * 1e-9 / drive.lag),
            deadband=rate_scale * drive.deadband,
            stiction=rate_scale * drive.stiction,
            encoder=np.maximum(drive.encoder, 1e-12),
            encoder_offset=drive.encoder_offset,
            rate_scale=rate_scale,
            lower=middle - HARD_STOP_RATIO * half_range,
            upper=middle + HARD_STOP_RATIO * half_range,
            inertia=compute_inertia(self.settings.mechanism).rows,
        )
