"""Simulated laboratory with one error in its rig file, and an operator who observes the motion.

benchmarks/rig_check.py checks all of `MISTAKES`, tests/bringup some of them.
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
from rcmservo.interfaces import ArmMeasurement, Command, Floats, Frame
from rcmservo.loop.run_result import CameraStatistics
from rcmservo.safety.gate import Gate
from rcmservo.safety.thresholds import Thresholds
from rcmservo.sim import Rig, RigSettings
from rcmservo.tracking import PointMarkers

COUNTS = 50000.0, 50000.0, 500.0
"""True encoder counts per rad, rad and mm."""
AXES = "ABC"
"""Letters of the axes that drive joints 1 to 3."""
MAX_TRAVEL_MM = 2.0
"""Largest travel of marker 2 in a check."""


@dataclass(frozen=True)
class Mistake:
    """An error of the rig file or the camera, or none.

    Parameters
    ----------
    where : str
        Setting that the check must find; empty if nothing is wrong.
    factors : tuple[float, float, float]
        Factors on the counts in the file.
    axes : str
        Letters of the axes in the file.
    mirrored : bool
        True if the image is mirrored.
    zero : float
        Error (mm) of the zero of the insertion in the file, positive if too large.
    spacing : float
        Factor on the distance between the markers in the file.
    counts : tuple[float, float, float]
        True counts per rad, rad and mm.
    also : str
        Second setting that the check must find; empty if there is none.
    """

    where: str = ""
    factors: tuple[float, float, float] = (1.0, 1.0, 1.0)
    axes: str = AXES
    mirrored: bool = False
    zero: float = 0.0
    spacing: float = 1.0
    counts: tuple[float, float, float] = COUNTS
    also: str = ""

    def is_found(self, report: CheckReport) -> bool:
        """Return whether a complete check found exactly this mistake."""
        expected = {self.where, self.also} - {""}
        return report.done and {one.where for one in report.findings} == expected


class MiswiredArm:
    """Simulated arm behind encoders and motors that a rig file describes, perhaps wrongly."""

    def __init__(self, rig: Rig, mistake: Mistake) -> None:
        self.rig, self.off_reason = rig, ""
        self.true = np.array(mistake.counts)
        self.counts = self.true * mistake.factors
        self.axes = [AXES.index(letter) for letter in mistake.axes]
        self.mark = rig.truth.arm.q_motor.copy()
        self.start = self._second()
        self.max_travel, self.history, self.known = 0.0, [], True
        self.commands: list[Command] = []
        self.enabled = 0
        self.closed = False

    @property
    def q_true(self) -> Floats:
        return self.rig.truth.arm.q_true

    def _second(self) -> Floats:
        return self.rig.body.points(self.q_true)[1]

    def is_homed(self) -> bool:
        return self.known

    def set_position(self, q: Floats) -> None:
        self.mark, self.known = q, True

    def close(self) -> None:
        self.closed = True

    def enable(self) -> None:
        self.enabled += 1
        self.rig.arm.enable()

    def measure(self) -> ArmMeasurement:
        now = self.rig.arm.measure()
        moved = np.round((self.rig.truth.arm.q_motor - self.mark) * self.true)
        return ArmMeasurement(now.time, self.mark + moved[self.axes] / self.counts, now.enabled)

    def apply(self, command: Command) -> Floats:
        self.commands.append(command)
        self.history.append(self.q_true.copy())
        self.max_travel = max(self.max_travel, float(np.linalg.norm(self._second() - self.start)))
        rates = np.zeros(3)
        rates[self.axes] = command.rates * self.counts / self.true[self.axes]
        taken = self.rig.arm.apply(replace(command, rates=rates))
        return taken[self.axes] * self.true[self.axes] / self.counts


class SimulatedLabCamera:
    """Simulated camera with the interface of a laboratory's camera, mirrored on request."""

    def __init__(self, rig: Rig, mirrored: bool, change: Callable[[Frame], Frame | None]) -> None:
        self.rig, self.mirrored, self.change = rig, mirrored, change
        self._newest: Frame | None = None
        self._delivered: Frame | None = None

    def latest(self) -> Frame | None:
        frame = self.rig.camera.latest()
        if frame is not self._newest and frame is not None:
            self._newest = frame
            if self.mirrored:
                assert frame.points is not None
                frame = replace(frame, points=frame.points * [-1.0, 1.0] + [639.0, 0.0])
            self._delivered = self.change(frame) or self._delivered
        return self._delivered

    def counts(self) -> CameraStatistics:
        return CameraStatistics()

    def close(self) -> None:
        pass


@dataclass
class SimulatedOperator:
    """Operator who agrees to each motion and reports the true motion of the tool.

    Parameters
    ----------
    arm : MiswiredArm
        Arm that the operator watches.
    spacing : float
        Distance (mm) between the markers, by the ruler.
    instead : Callable[[str], str | None]
        Function that returns a different answer to a question, or None for the true one.
    questions : list[str]
        All questions.
    notices : list[str]
        All messages.
    """

    arm: MiswiredArm
    spacing: float
    override: Callable[[str], str | None] = lambda question: None
    questions: list[str] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)

    def notify(self, message: str) -> None:
        self.messages.append(message)
        if message.startswith("Watch"):
            self.arm.history.clear()

    def ask(self, question: str) -> str:
        self.questions.append(question)
        other = self.override(question)
        if other is not None:
            if other == "stop":
                raise Stopped("ended by the operator")
            return other
        answers = {
            "in which direction": self._direction,
            "how many mm": lambda: f"{self._travel():.1f}",
            "how far apart": lambda: f"{self.spacing:.1f}",
            "how far is the middle": lambda: f"{self._depth():.0f}",
            "May the drive": lambda: "enable",
            "Move joint": lambda: "yes",
        }
        return next(answer for words, answer in answers.items() if words in question)()

    def _robot(self) -> Robot:
        settings = self.arm.rig.settings
        return Robot(settings.mechanism, settings.tool, Wiring(COUNTS))

    def _depth(self) -> float:
        """Return the distance (mm) from the RCM to marker 1."""
        return float(np.linalg.norm(self._robot().compute_first_marker(self.arm.q_true)))

    def _travel(self) -> float:
        """Return the travel (mm) of marker 2, by a ruler with half millimetres."""
        second = np.array([self.arm.rig.body.points(q)[1] for q in self.arm.history])
        return round(2.0 * np.linalg.norm(second - second[0], axis=1).max()) / 2.0

    def _direction(self) -> str:
        """Return the word for the direction in which the tool moved."""
        robot = self._robot()
        mechanism = robot.mechanism
        moved = np.array(self.arm.history) - self.arm.history[0]
        mm = moved / robot.compute_joint_per_mm(self.arm.history[0])
        row, joint = np.unravel_index(np.argmax(np.abs(mm)), mm.shape)
        spherical = mechanism.name == "spherical"
        up = ("away", "clockwise", "in") if spherical else ("right", "down", "in")
        down = ("towards", "anticlockwise", "out") if spherical else ("left", "up", "out")
        return (up if mm[row, joint] > 0.0 else down)[joint]


class FaultyLab:
    """Simulated laboratory with a mistake: arm, camera, operator and `rig check`."""

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
        self.operator = SimulatedOperator(self.arm, 30.0)
        self.gate = Gate()
        camera = SimulatedLabCamera(self.rig, mistake.mirrored, change)
        clock, tracker = self.rig.clock, PointMarkers()
        gate, trouble = self.gate, lambda: camera.counts().trouble
        self.mover = Mover(self.arm, camera, tracker, clock, self.robot, gate, 0.05, trouble)
        self.latency: float | None = 0.022
        self.thresholds = Thresholds()

    def check(self) -> CheckReport:
        return check(self.mover, self.operator, self.robot, self.thresholds, self.latency)


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
