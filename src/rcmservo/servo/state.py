"""What the servo remembers from tick to tick, in three parts: watched, learnt, decided."""

from typing import Any, NamedTuple

import numpy as np

from rcmservo.guard.causes import Cause
from rcmservo.guard.states import Mode, Phase
from rcmservo.guard.watch import Watch
from rcmservo.interfaces import Command, Floats, Target
from rcmservo.method.exploration import Exploring
from rcmservo.method.features import FEATURES
from rcmservo.rows import Row, real, reals, whole


class Estimate(Row):
    """What frames have taught, in numbers; NaN where not known yet."""

    exposure: int = whole("ns", "of the newest frame learnt from, -1 before the first")
    points: Floats = reals((2, 2), "px", "the markers in the newest frame believed")
    p1: Floats = reals(3, "mm", "marker 1 in space at that exposure")
    line_count: int = whole("", "lines of the tool kept for eq. (16)")
    o_c: Floats = reals(2, "px", "the imaged RCM, eq. (16)")
    rcm_condition: float = real("", "condition of eq. (16)")
    J_hat: Floats = reals((FEATURES, 3), "rad/mm, px/mm, px/mm", "Ĵ of eq. (14)")
    condition: float = real("", "condition of the scaled Ĵ")
    y: Floats = reals(FEATURES, "rad, px, px", "the features, eq. (6)")
    delta: Floats = reals(FEATURES, "rad, px, px", "Δy at the exposure")
    ahead: Floats = reals(FEATURES, "rad, px, px", "Δy as predicted for now")


class Course(Row):
    """What the servo wants of the arm, and how it gets on."""

    v: Floats = reals(3, "mm/s", "velocity wanted of marker 1")
    rates: Floats = reals(3, "rad/s, rad/s, mm/s", "the joint rates that make it")
    blocked: int = whole("", "the joint whose limit stands in the way, -1 for none")
    peak: float = real("", "the error √(2V) that has last been fallen short of")
    peak_time: int = whole("ns", "when that was")


class Learnt(NamedTuple):
    """All that is forgotten when the estimate is learnt anew."""

    estimate: Estimate
    """What frames have taught, in numbers."""
    lines: Floats
    """The imaged tool's lines that eq. (16) is made of."""
    memory: Any
    """The estimator's own memory."""
    tour: Exploring | None = None
    """Where an exploration stands."""
    no_room: bool = False
    """Whether the joint limits leave no room to explore."""
    explored: bool = False
    """Whether there is an estimate to servo with."""


def ignorance(lines: Floats, memory: Any) -> Learnt:
    """Nothing learnt yet: Ĵ = 0."""
    unknown = dict.fromkeys(("points", "o_c", "p1", "y", "delta", "ahead"), np.nan)
    estimate = Estimate.of(exposure=-1, rcm_condition=np.inf, condition=np.inf, **unknown)
    return Learnt(estimate, lines, memory)


class State(NamedTuple):
    """All that the servo remembers, and what it decided at the last tick."""

    mode: Mode
    """Its phase, and why."""
    command: Command
    """What the gate passed."""
    watch: Watch
    """What the checks for faults remember."""
    learnt: Learnt
    """What it has learnt of camera and tool."""
    course: Course
    """Where it wants to go."""
    target: Target | None = None
    """Where it servoes to."""
    moved: int = -1
    """When the camera was last noticed to have been moved, ns; -1: never."""

    def but(
        self,
        *,
        mode: Mode | None = None,
        command: Command | None = None,
        watch: Watch | None = None,
        learnt: Learnt | None = None,
        course: Course | None = None,
        moved: int | None = None,
    ) -> "State":
        """The same state with some parts changed."""
        return State(
            mode or self.mode,
            command or self.command,
            watch or self.watch,
            learnt or self.learnt,
            course or self.course,
            self.target,
            self.moved if moved is None else moved,
        )

    @property
    def phase(self) -> Phase:
        """What the servo is doing."""
        return self.mode.phase

    @property
    def cause(self) -> Cause:
        """Why it is not simply on its way."""
        return self.mode.cause

    @property
    def words(self) -> str:
        """Phase, cause and way out in words."""
        return self.mode.words

    @property
    def frame(self) -> int:
        """The newest frame seen, -1 before the first."""
        return self.watch.frame

    @property
    def believed(self) -> int:
        """The newest frame accepted, -1 before the first."""
        return self.watch.believed

    @property
    def explored(self) -> bool:
        """Whether there is an estimate to servo with."""
        return self.learnt.explored

    @property
    def o_c(self) -> Floats:
        """The imaged RCM (2,) px, eq. (16)."""
        return self.learnt.estimate.o_c

    @property
    def J_hat(self) -> Floats:
        """Ĵ (3, 3) of eq. (14), rad/mm, px/mm, px/mm."""
        return self.learnt.estimate.J_hat

    @property
    def condition(self) -> float:
        """Condition of the scaled Ĵ."""
        return self.learnt.estimate.condition

    @property
    def p1(self) -> Floats:
        """Marker 1 (3,) mm at the exposure of the newest frame believed."""
        return self.learnt.estimate.p1

    @property
    def y(self) -> Floats:
        """The features (3,) rad, px, px."""
        return self.learnt.estimate.y

    @property
    def delta(self) -> Floats:
        """Δy (3,) rad, px, px at the exposure."""
        return self.learnt.estimate.delta

    @property
    def v(self) -> Floats:
        """Velocity (3,) mm/s wanted of marker 1."""
        return self.course.v


def restarted(course: Course, now: int | None = None) -> Course:
    """The course with the rule on stalls begun anew, counted from `now` ns."""
    rows: Any = course.rows.copy()
    rows["peak"] = np.inf
    if now is not None:
        rows["peak_time"] = now
    return Course(rows)


def headed(course: Course, v: Floats, rates: Floats) -> Course:
    """The course with another velocity (3,) mm/s of marker 1 and its joint rates (3,)."""
    rows: Any = course.rows.copy()
    rows["v"], rows["rates"] = v, rates
    return Course(rows)


def renewed(estimate: Estimate) -> Estimate:
    """The estimate as it is before the first frame of another run."""
    rows: Any = estimate.rows.copy()
    rows["exposure"] = -1
    return Estimate(rows)
