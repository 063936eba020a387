"""A simulated laboratory whose rig file is wrong, and a person beside it who sees what is true.

benchmarks/rig_check.py checks many; tests ask a part.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from rcmservo.bringup.axis_wiring import Robot, Wiring
from rcmservo.bringup.check import CheckReport, check
from rcmservo.bringup.motion import Mover
from rcmservo.errors import Stopped
from rcmservo.geometry.kinematics import Kinematics, PitchYawRcm, SphericalRcm
from rcmservo.geometry.tool import RigidTool
from rcmservo.interfaces import Command, Floats, Frame, Measured
from rcmservo.loop.run_result import CameraAccount
from rcmservo.safety.gate import Gate
from rcmservo.safety.thresholds import Thresholds
from rcmservo.sim import Rig, RigSettings
from rcmservo.tracking import PointMarkers

COUNTS = 50000.0, 50000.0, 500.0
"""True ones, of a rad, rad and mm."""
AXES = "ABC"
"""The letters of the true joints' motors."""


@dataclass(frozen=True)
class Mistake:
    """What is wrong, in the rig file or before the camera."""

    where: str = ""
    """The setting that is to be named; empty where nothing is wrong."""
    factors: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Of the counts."""
    axes: str = AXES
    """The letters in the file."""
    mirrored: bool = False
    """Whether the picture is mirrored."""
    zero: float = 0.0
    """mm by which the file's insertion zero is too large."""
    spacing: float = 1.0
    """Factor of the markers' distance in the file."""
    counts: tuple[float, float, float] = COUNTS
    """True ones."""
    also: str = ""
    """Another setting that is to be named."""

    def named(self, report: CheckReport) -> bool:
        """Whether a check that came to its end names this, and nothing else."""
        wrong = {self.where, self.also} - {""}
        return report.done and {one.where for one in report.findings} == wrong


class MiswiredArm:
    """A simulated arm on encoders and motors that a rig file describes."""

    def __init__(self, rig: Rig, mistake: Mistake) -> None:
        self.rig, self.why_off = rig, ""
        self.true = np.array(mistake.counts)
        self.counts = self.true * mistake.factors
        self.axes = [AXES.index(letter) for letter in mistake.axes]
        self.mark = rig.truth.arm.q_true.copy()
        self.start = self._second()
        self.farthest, self.past, self.known = 0.0, [], True
        self.commands: list[Command] = []
        self.enabled = 0
        self.closed = False

    @property
    def q_true(self) -> Floats:
        return self.rig.truth.arm.q_true

    def _second(self) -> Floats:
        return self.rig.body.points(self.q_true)[1]

    def homed(self) -> bool:
        return self.known

    def define(self, q: Floats) -> None:
        self.mark, self.known = q, True

    def close(self) -> None:
        self.closed = True

    def enable(self) -> None:
        self.enabled += 1
        self.rig.arm.enable()

    def measure(self) -> Measured:
        told = self.rig.arm.measure()
        moved = np.round((self.q_true - self.mark) * self.true)
        return Measured(told.time, self.mark + moved[self.axes] / self.counts, told.enabled)

    def apply(self, command: Command) -> Floats:
        self.commands.append(command)
        self.past.append(self.q_true.copy())
        self.farthest = max(self.farthest, float(np.linalg.norm(self._second() - self.start)))
        rates = np.zeros(3)
        rates[self.axes] = command.rates * self.counts / self.true[self.axes]
        taken = self.rig.arm.apply(replace(command, rates=rates))
        return taken[self.axes] * self.true[self.axes] / self.counts


class LabEye:
    """A simulated camera as a laboratory has it."""

    def __init__(self, rig: Rig, mirrored: bool, change: Callable[[Frame], Frame | None]) -> None:
        self.rig, self.mirrored, self.change = rig, mirrored, change
        self._seen: Frame | None = None
        self._given: Frame | None = None

    def latest(self) -> Frame | None:
        frame = self.rig.camera.latest()
        if frame is not self._seen and frame is not None:
            self._seen = frame
            if self.mirrored:
                assert frame.points is not None
                frame = replace(frame, points=frame.points * [-1.0, 1.0] + [639.0, 0.0])
            self._given = self.change(frame) or self._given
        return self._given

    def counts(self) -> CameraAccount:
        return CameraAccount()

    def close(self) -> None:
        pass


@dataclass
class Onlooker:
    """A person who says yes, and tells what the tool did truly."""

    arm: MiswiredArm
    """Which the person watches."""
    spacing: float
    """mm between the markers, by the ruler."""
    instead: Callable[[str], str | None] = lambda question: None
    """What is answered to a question otherwise, if anything."""
    asked: list[str] = field(default_factory=list)
    """All questions."""
    told: list[str] = field(default_factory=list)
    """All that was said."""

    def tell(self, words: str) -> None:
        self.told.append(words)
        if words.startswith("Watch"):
            self.arm.past.clear()

    def ask(self, question: str) -> str:
        self.asked.append(question)
        other = self.instead(question)
        if other is not None:
            if other == "stop":
                raise Stopped("ended by the person")
            return other
        looks = {
            "which way": self._seen,
            "how many mm": lambda: f"{self._went():.1f}",
            "how far apart": lambda: f"{self.spacing:.1f}",
            "how far is the middle": lambda: f"{self._deep():.0f}",
            "May the drive": lambda: "enable",
            "Move joint": lambda: "yes",
        }
        return next(look for words, look in looks.items() if words in question)()

    def _robot(self) -> Robot:
        settings = self.arm.rig.settings
        return Robot(settings.mechanism, settings.tool, Wiring(COUNTS))

    def _deep(self) -> float:
        """Mm from the RCM to marker 1."""
        return float(np.linalg.norm(self._robot().first_marker(self.arm.q_true)))

    def _went(self) -> float:
        """Mm that marker 2 went away from where it was, by a ruler of half millimetres."""
        second = np.array([self.arm.rig.body.points(q)[1] for q in self.arm.past])
        return round(2.0 * np.linalg.norm(second - second[0], axis=1).max()) / 2.0

    def _seen(self) -> str:
        """What the tool did when it went away from where it was."""
        robot = self._robot()
        mechanism = robot.mechanism
        moved = np.array(self.arm.past) - self.arm.past[0]
        mm = moved / robot.joint_per_mm(self.arm.past[0])
        row, joint = np.unravel_index(np.argmax(np.abs(mm)), mm.shape)
        spherical = mechanism.name == "spherical"
        up = ("away", "clockwise", "in") if spherical else ("right", "down", "in")
        down = ("towards", "anticlockwise", "out") if spherical else ("left", "up", "out")
        return (up if mm[row, joint] > 0.0 else down)[joint]


class WrongLab:
    """All of it."""

    def __init__(
        self,
        mistake: Mistake,
        seed: int = 0,
        mechanism: Kinematics | None = None,
        settings: RigSettings | None = None,
        change: Callable[[Frame], Frame | None] = lambda frame: frame,
        signs_only: bool = False,
    ) -> None:
        mechanism = mechanism or (SphericalRcm() if seed % 2 == 0 else PitchYawRcm())
        self.rig = Rig(seed, settings or RigSettings(mechanism=mechanism), pictures=False)
        file = replace(mechanism, insertion_zero=mechanism.insertion_zero + mistake.zero)
        self.arm = MiswiredArm(self.rig, mistake)
        wiring = Wiring(tuple(self.arm.counts.tolist()), axes=mistake.axes)
        if signs_only:
            wiring = Wiring(mistake.factors, "signs")
        self.robot = Robot(file, RigidTool(spacing=30.0 * mistake.spacing), wiring)
        self.person = Onlooker(self.arm, 30.0)
        self.gate = Gate()
        eye = LabEye(self.rig, mistake.mirrored, change)
        clock, tracker = self.rig.clock, PointMarkers()
        gate, told = self.gate, lambda: eye.counts().trouble
        self.mover = Mover(self.arm, eye, tracker, clock, self.robot, gate, 0.05, told)
        self.latency: float | None = 0.022
        self.thresholds = Thresholds()

    def check(self) -> CheckReport:
        return check(self.mover, self.person, self.robot, self.thresholds, self.latency)


MISTAKES = {
    "nothing": Mistake(),
    "joint 1 reversed": Mistake("arm.counts[0]", factors=(-1.0, 1.0, 1.0)),
    "joint 2 reversed": Mistake("arm.counts[1]", factors=(1.0, -1.0, 1.0)),
    "joint 3 reversed": Mistake("arm.counts[2]", factors=(1.0, 1.0, -1.0)),
    "both angles reversed": Mistake(
        "arm.counts[0]", factors=(-1.0, -1.0, 1.0), also="arm.counts[1]"
    ),
    "axes 1 and 2 swapped": Mistake("arm.axes", axes="BAC"),
    "axes 1 and 2 swapped, one counts down": Mistake(
        "arm.axes", axes="BAC", counts=(50000.0, -50000.0, 500.0)
    ),
    "axes 2 and 3 swapped": Mistake("arm.axes", axes="ACB"),
    "counts of 1 doubled": Mistake("arm.counts[0]", factors=(2.0, 1.0, 1.0)),
    "counts of 2 in inches": Mistake("arm.counts[1]", factors=(1.0, 25.4, 1.0)),
    "counts of 3 in inches": Mistake("arm.counts[2]", factors=(1.0, 1.0, 25.4)),
    "counts of 1 in degrees": Mistake("arm.counts[0]", factors=(180.0 / np.pi, 1.0, 1.0)),
    "counts of 3 in metres": Mistake("arm.counts[2]", factors=(1.0, 1.0, 1000.0)),
    "counts of 3 halved": Mistake("arm.counts[2]", factors=(1.0, 1.0, 0.5)),
    "picture mirrored": Mistake("camera", mirrored=True),
    "insertion zero": Mistake("mechanism.insertion_zero", zero=20.0),
    "spacing": Mistake("tool.spacing", spacing=1.25),
}
