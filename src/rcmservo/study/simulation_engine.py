"""Closed loops of the simulated laboratory itself: MuJoCo's arm, and the live path's own code, with
any estimator, with disturbances, with rendered frames. What batch.py does with its compiled twin,
at the same times and with the same noise.
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
from rcmservo.loop.target_frames import FRAMES, TEACHING_FRAMES
from rcmservo.loop.teach import NotShown, teach
from rcmservo.loop.tick import Tick
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import PHASES, Phase, Request
from rcmservo.servo.servo import Servo
from rcmservo.sim import Disturbance, Rig, RigSettings
from rcmservo.sim.scene import Scene
from rcmservo.study.batch import BEGIN
from rcmservo.study.cramer_rao import bound
from rcmservo.study.run_outcome import StudyRun
from rcmservo.study.trial import StudyTrial, frames_of, trial
from rcmservo.tracking import ColourMarkers, MarkerAppearance, PointMarkers

UNFIT = "kill", "disk_full"
"""Disturbances of the process that servoes and of its record, not of the servo."""


def request_nothing(tick: Tick) -> Request:
    """Request nothing, as an operator who stands by."""
    return Request.NONE


class LaboratoryLoop:
    """One closed loop, before its first tick: whoever goes through its `ticks` moves the arm, until
    the end or as far as they like.
    """

    def __init__(self, laboratory: "Laboratory", seed: int, repetition: int) -> None:
        of = self._of = laboratory
        self.given = trial(seed, repetition, of.settings, of.duration, of.shown)
        self.rig = Rig(seed, of.settings, of.pictures, of.disturbances, self.given.scene)
        tracker = ColourMarkers(of.look) if of.pictures else PointMarkers()
        self.plant = Plant(self.rig.arm, self.rig.camera, tracker, self.rig.clock)
        self.p_d, self.target = self.given.goal.p2, self._shown(self.given)
        self._errors: list[float] = []
        self._phases: list[int] = []
        self._causes: list[int] = []

    def _shown(self, given: StudyTrial) -> Target:
        """The target: of rendered frames it must be shown, of points it is known what was seen."""
        rig = self.rig
        if self._of.pictures:
            rig.move_to_target()
            target = teach(self.plant, self._of.shown)
            rig.move_to_start()
            return target
        rig.clock.wait_until(BEGIN)
        rig.set_point_noise(np.concatenate([given.noise, self._quiet_frames()]))
        return Target(given.goal.points, given.goal.q, rig.clock.now())

    def _quiet_frames(self) -> Floats:
        """Return no noise, for the frames in which the arm comes to rest after the last tick: what
        they show is used for nothing.
        """
        servo, rate = self._of.servo, self._of.settings.timing.frame_rate
        period = 1.0 / servo.rate
        slower = max(period / servo.gate.max_period, 1.0)
        longest = slower * np.max(np.divide(servo.gate.speed, servo.gate.slew)) + 3.0 * period
        return np.zeros((int(longest * rate) + 2, 2, 2))

    def ticks(self) -> Generator[Tick]:
        """Yield every tick, after its command was sent. Pauses and faults do not end the loop."""
        of = self._of
        self.rig.begin()
        for tick in run(self.plant, of.servo, self.target, of.duration, operator=request_nothing):
            self.note(tick.state.phase, tick.state.cause)
            yield tick

    def note(self, phase: Phase, cause: Cause) -> None:
        """Take note of a tick whose command was sent: of a law that is no servo's too."""
        p2 = self.rig.truth.markers(self.rig.clock.now())[1]
        away: Floats = p2 - self.p_d
        self._errors.append(float(np.linalg.norm(away)))
        self._phases.append(PHASES.index(phase))
        self._causes.append(cause.place)

    @property
    def run(self) -> StudyRun:
        """How it went up to now."""
        of, given = self._of, self.given
        phases, causes = np.array(self._phases, np.int8), np.array(self._causes, np.int8)
        least, errors = of.bound(given.scene), np.array(self._errors)
        return StudyRun(self.rig.seed, of.servo.rate, errors, phases, causes, least, given.scene)


@dataclass(frozen=True)
class Laboratory(Checked):
    """A servo, and the laboratory that its scenes are drawn in.

    Parameters
    ----------
    servo : Servo
        The servo.
    settings : RigSettings
        The laboratory.
    duration : float
        Length of each closed loop, s.
    shown : int
        Frames that the target is the mean of.
    disturbances : Sequence[Disturbance]
        What goes wrong in every run.
    pictures : bool
        Rendered frames instead of a camera that tells points.
    look : MarkerLook
        What the tracker looks for in them.
    """

    servo: Servo
    settings: RigSettings = field(default_factory=RigSettings)
    duration: Annotated[float, positive("time in s")] = 15.0
    shown: Annotated[int, FRAMES] = TEACHING_FRAMES
    disturbances: Sequence[Disturbance] = ()
    pictures: bool = False
    look: MarkerAppearance = field(default_factory=MarkerAppearance)

    def __post_init__(self) -> None:
        super().__post_init__()
        for one in self.disturbances:
            right = f"none of {', '.join(UNFIT)}, which no servo can answer"
            require(one.kind not in UNFIT, "disturbance", one.kind, right)

    def run(self, seed: int, repetition: int = 0) -> StudyRun:
        """One closed loop, in the scene that `Rig(seed)` has. Where the target cannot be taught,
        the tool stays where it is.
        """
        try:
            loop = LaboratoryLoop(self, seed, repetition)
        except NotShown:
            return self._stood(seed, repetition)
        for _ in loop.ticks():
            pass
        return loop.run

    def _stood(self, seed: int, repetition: int) -> StudyRun:
        """A run that nobody begins."""
        given = trial(seed, repetition, self.settings, self.duration, self.shown)
        scene, rate = given.scene, self.servo.rate
        away: Floats = scene.body.points(scene.start)[1] - given.goal.p2
        far = float(np.linalg.norm(away))
        n = round(self.duration * rate)
        phases = np.full(n, PHASES.index(Phase.IDLE), np.int8)
        causes = np.full(n, Cause.NONE.place, np.int8)
        return StudyRun(seed, rate, np.full(n, far), phases, causes, self.bound(scene), scene)

    def bound(self, scene: Scene) -> float:
        """The Cramér-Rao bound of the error, mm; NaN with rendered frames, whose noise is the
        tracker's and not known.
        """
        if self.pictures:
            return float("nan")
        frames = frames_of(self.settings, self.duration)
        return bound(scene, self.settings.point_noise, frames, self.shown).rms
