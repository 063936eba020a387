"""Closed loops of a study in the full simulator: MuJoCo's arm and the code of the live loop.

This engine also runs what `rcmservo.study.compiled_engine` does not support: any
estimator, disturbances and rendered frames. Timing and noise are the same in both.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass, field

import numpy as np

from rcmservo.errors import require
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.plant import Plant
from rcmservo.loop.servo_loop import servo_ticks
from rcmservo.loop.teach import TeachingFailed, teach
from rcmservo.loop.tick import Tick
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import PHASES, Phase, Request
from rcmservo.sim import Disturbance, Rig
from rcmservo.sim.scene import Scene
from rcmservo.study.run_outcome import StudyRun
from rcmservo.study.trial import FIRST_TICK_NS, StudyEngine
from rcmservo.tracking import ColourMarkers, MarkerAppearance, PointMarkers

EXCLUDED_DISTURBANCES = "kill", "disk_full"
"""Disturbances of the process or of its recorder, to which no servo can respond."""


class SimulationLoop:
    """Closed loop of a simulated laboratory, ready for its first tick.

    Iterating over `ticks` moves the arm; the caller may stop at any tick.

    Parameters
    ----------
    engine : SimulationEngine
        Servo and simulated laboratory.
    seed : int
        Seed of the scene and the noise.
    repetition : int
        Number of the repetition from 0; each has other noise.

    Raises
    ------
    TeachingFailed
        If the target cannot be taught from rendered frames.
    """

    def __init__(self, engine: "SimulationEngine", seed: int, repetition: int) -> None:
        self._engine, self.trial = engine, engine.draw_trial(seed, repetition)
        scene = self.trial.scene
        self.rig = Rig(seed, engine.settings, engine.pictures, engine.disturbances, scene)
        tracker = ColourMarkers(engine.appearance) if engine.pictures else PointMarkers()
        self.plant = Plant(self.rig.arm, self.rig.camera, tracker, self.rig.clock)
        self.target = self._make_target()
        self._errors: list[float] = []
        self._phases: list[int] = []
        self._causes: list[int] = []

    def _make_target(self) -> Target:
        """Teach the target from rendered frames, or take the markers of the trial."""
        rig, goal = self.rig, self.trial.goal
        if self._engine.pictures:
            rig.move_to_target()
            target = teach(self.plant, self._engine.teaching_frames)
            rig.go_home()
            return target
        rig.clock.wait_until(FIRST_TICK_NS)
        rig.set_point_noise(np.concatenate([self.trial.noise, self._make_trailing_noise()]))
        return Target(goal.points, goal.q, rig.clock.now())

    def _make_trailing_noise(self) -> Floats:
        """Return zeros for the frames after the last tick, until the arm rests; none is used."""
        servo, gate = self._engine.servo, self._engine.servo.gate
        period_s = 1.0 / servo.rate
        slowdown = max(period_s / gate.max_period, 1.0)
        braking_s = slowdown * np.max(np.divide(gate.speed, gate.slew)) + 3.0 * period_s
        return np.zeros((int(braking_s * self._engine.settings.timing.frame_rate) + 2, 2, 2))

    def ticks(self) -> Generator[Tick]:
        """Yield every tick after its command was sent; pauses and faults do not end the loop."""
        servo, duration = self._engine.servo, self._engine.duration

        def request_nothing(_: Tick) -> Request:
            return Request.NONE

        self.rig.begin()
        for tick in servo_ticks(self.plant, servo, self.target, duration, operator=request_nothing):
            self.record_tick(tick.state.phase, tick.state.cause)
            yield tick

    def record_tick(self, phase: Phase, cause: Cause) -> None:
        """Record the true error, phase and cause of a tick, also of a law without a servo."""
        p2: Floats = self.rig.truth.markers(self.rig.clock.now())[1]
        self._errors.append(float(np.linalg.norm(p2 - self.trial.goal.p2)))
        self._phases.append(PHASES.index(phase))
        self._causes.append(cause.code)

    @property
    def outcome(self) -> StudyRun:
        """Outcome of the ticks up to now."""
        rate, scene, seed = self._engine.servo.rate, self.trial.scene, self.rig.seed
        phases, causes = np.array(self._phases, np.int8), np.array(self._causes, np.int8)
        errors, bound_mm = np.array(self._errors), self._engine.compute_bound(scene)
        return StudyRun(seed, rate, errors, phases, causes, bound_mm, scene)


@dataclass(frozen=True)
class SimulationEngine(StudyEngine):
    """Simulated closed loops of a servo in the full simulator.

    Parameters
    ----------
    servo : Servo
        The servo.
    settings : RigSettings
        The simulated laboratory.
    duration : float
        Length of each closed loop, s.
    teaching_frames : int
        Number of frames whose mean is the target.
    disturbances : Sequence[Disturbance]
        Disturbances of every run.
    pictures : bool
        Render frames and track the markers, instead of a camera that measures points.
    appearance : MarkerAppearance
        Appearance of the markers for the tracker of rendered frames.
    """

    disturbances: Sequence[Disturbance] = ()
    pictures: bool = False
    appearance: MarkerAppearance = field(default_factory=MarkerAppearance)

    def __post_init__(self) -> None:
        super().__post_init__()
        for disturbance in self.disturbances:
            expected = f"none of {', '.join(EXCLUDED_DISTURBANCES)}: no servo can respond to these"
            is_allowed = disturbance.kind not in EXCLUDED_DISTURBANCES
            require(is_allowed, "disturbance", disturbance.kind, expected)

    def run(self, seed: int, repetition: int = 0) -> StudyRun:
        """Run one closed loop in the scene of `Rig(seed)`; the arm rests if teaching fails."""
        try:
            loop = SimulationLoop(self, seed, repetition)
        except TeachingFailed:
            return self._make_idle_run(seed, repetition)
        for _ in loop.ticks():
            pass
        return loop.outcome

    def _make_idle_run(self, seed: int, repetition: int) -> StudyRun:
        """Return the outcome of a run in which the arm never leaves the start."""
        scene, goal, _ = self.draw_trial(seed, repetition)
        deviation: Floats = scene.body.points(scene.start)[1] - goal.p2
        ticks = round(self.duration * self.servo.rate)
        errors = np.full(ticks, float(np.linalg.norm(deviation)))
        phases = np.full(ticks, PHASES.index(Phase.IDLE), np.int8)
        causes = np.full(ticks, Cause.NONE.code, np.int8)
        bound_mm = self.compute_bound(scene)
        return StudyRun(seed, self.servo.rate, errors, phases, causes, bound_mm, scene)

    def compute_bound(self, scene: Scene) -> float:
        """Return the Cramér-Rao bound of the pose error for all frames of a loop, rms in mm.

        It is NaN for rendered frames, because the noise of their tracker is unknown.
        """
        return np.nan if self.pictures else super().compute_bound(scene)
