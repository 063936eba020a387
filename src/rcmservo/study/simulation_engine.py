"""Closed loops of a study in the full simulator: MuJoCo's arm and the code of the live loop.

This engine also runs what the compiled plant of `batch` cannot: any estimator, disturbances and
rendered frames. Timing and noise are the same in both.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from rcmservo.constraints import Checked, positive
from rcmservo.errors import require
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import run
from rcmservo.loop.target_frames import FRAME_COUNT, TEACHING_FRAMES
from rcmservo.loop.teach import TeachingFailed, teach
from rcmservo.loop.tick import Tick
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import PHASES, Phase, Request
from rcmservo.servo.servo import Servo
from rcmservo.sim import Disturbance, Rig, RigSettings
from rcmservo.sim.scene import Scene
from rcmservo.study.batch import FIRST_TICK_NS
from rcmservo.study.cramer_rao import bound
from rcmservo.study.run_outcome import StudyRun
from rcmservo.study.trial import StudyTrial, count_frames, draw_trial
from rcmservo.tracking import ColourMarkers, MarkerAppearance, PointMarkers

EXCLUDED_DISTURBANCES = "kill", "disk_full"
"""Disturbances of the process or of its recorder, to which no servo can respond."""


def request_nothing(tick: Tick) -> Request:
    """Request nothing, as an operator who does not intervene."""
    return Request.NONE


class SimulationLoop:
    """Closed loop of a simulated laboratory, ready for its first tick.

    Iterating over `ticks` moves the arm; the caller may stop at any tick.

    Parameters
    ----------
    laboratory : SimulationEngine
        Servo and simulated laboratory.
    seed : int
        Seed of the scene and the noise.
    repetition : int
        Number of the repetition from 0; each has other noise.

    Raises
    ------
    NotShown
        If the target cannot be taught from rendered frames.
    """

    def __init__(self, laboratory: "SimulationEngine", seed: int, repetition: int) -> None:
        engine = self._engine = laboratory
        self.trial = draw_trial(
            seed, repetition, engine.settings, engine.duration, engine.teaching_frames
        )
        scene = self.trial.scene
        self.rig = Rig(seed, engine.settings, engine.pictures, engine.disturbances, scene)
        tracker = ColourMarkers(engine.appearance) if engine.pictures else PointMarkers()
        self.plant = Plant(self.rig.arm, self.rig.camera, tracker, self.rig.clock)
        self.p_d, self.target = self.trial.goal.p2, self._make_target(self.trial)
        self._errors: list[float] = []
        self._phases: list[int] = []
        self._causes: list[int] = []

    def _make_target(self, given: StudyTrial) -> Target:
        """Teach the target from rendered frames, or take the markers of the trial."""
        rig = self.rig
        if self._engine.pictures:
            rig.move_to_target()
            target = teach(self.plant, self._engine.teaching_frames)
            rig.move_to_start()
            return target
        rig.clock.wait_until(FIRST_TICK_NS)
        rig.set_point_noise(np.concatenate([given.noise, self._make_trailing_noise()]))
        return Target(given.goal.points, given.goal.q, rig.clock.now())

    def _make_trailing_noise(self) -> Floats:
        """Return zeros for the frames after the last tick, until the arm rests; none is used."""
        servo, rate = self._engine.servo, self._engine.settings.timing.frame_rate
        period = 1.0 / servo.rate
        slowdown = max(period / servo.gate.max_period, 1.0)
        braking = slowdown * np.max(np.divide(servo.gate.speed, servo.gate.slew)) + 3.0 * period
        return np.zeros((int(braking * rate) + 2, 2, 2))

    def ticks(self) -> Generator[Tick]:
        """Yield every tick after its command was sent; pauses and faults do not end the loop."""
        servo, duration = self._engine.servo, self._engine.duration
        self.rig.begin()
        for tick in run(self.plant, servo, self.target, duration, operator=request_nothing):
            self.record_tick(tick.state.phase, tick.state.cause)
            yield tick

    def record_tick(self, phase: Phase, cause: Cause) -> None:
        """Record the true error, phase and cause of a tick, also of a law outside the servo."""
        p2 = self.rig.truth.markers(self.rig.clock.now())[1]
        deviation: Floats = p2 - self.p_d
        self._errors.append(float(np.linalg.norm(deviation)))
        self._phases.append(PHASES.index(phase))
        self._causes.append(cause.code)

    @property
    def outcome(self) -> StudyRun:
        """Outcome of the ticks up to now."""
        engine, scene = self._engine, self.trial.scene
        phases, causes = np.array(self._phases, np.int8), np.array(self._causes, np.int8)
        least, errors = engine.bound(scene), np.array(self._errors)
        return StudyRun(self.rig.seed, engine.servo.rate, errors, phases, causes, least, scene)


@dataclass(frozen=True)
class SimulationEngine(Checked):
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

    servo: Servo
    settings: RigSettings = field(default_factory=RigSettings)
    duration: Annotated[float, positive("time in s")] = 15.0
    teaching_frames: Annotated[int, FRAME_COUNT] = TEACHING_FRAMES
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
        given = draw_trial(seed, repetition, self.settings, self.duration, self.teaching_frames)
        scene, rate = given.scene, self.servo.rate
        deviation: Floats = scene.body.points(scene.start)[1] - given.goal.p2
        error = float(np.linalg.norm(deviation))
        n = round(self.duration * rate)
        phases = np.full(n, PHASES.index(Phase.IDLE), np.int8)
        causes = np.full(n, Cause.NONE.code, np.int8)
        return StudyRun(seed, rate, np.full(n, error), phases, causes, self.bound(scene), scene)

    def bound(self, scene: Scene) -> float:
        """Return the Cramér-Rao bound of the error, mm; NaN for rendered frames.

        The noise of a tracker in rendered frames is unknown.
        """
        if self.pictures:
            return float("nan")
        frames = count_frames(self.settings, self.duration)
        return bound(scene, self.settings.point_noise, frames, self.teaching_frames).rms
