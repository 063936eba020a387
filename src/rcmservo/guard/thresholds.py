"""From where on something is a fault, a stall or a blocked way: every number that decides it."""

import math
from dataclasses import dataclass

from rcmservo.errors import require, require_radians


@dataclass(frozen=True)
class Thresholds:
    """From where on something is a fault."""

    stale_slow: float = 1.5
    """Age of the newest frame since it arrived, in frame periods, from which on the tool goes
    slowly."""
    stale_hold: float = 3.0
    """The same for standing still."""
    first_period: float = 0.1
    """Time between frames that is expected while only one has been seen, s."""
    latency: float = 0.1
    """Longest time from a frame's exposure to the command made of it, s; up to it latency is
    compensated."""

    silence: float = 0.05
    """Longest time for which the arm may not answer, s."""
    following: tuple[float, float, float] = (0.008, 0.008, 0.6)
    """How far each joint may stand from where its commands should have brought it (rad, rad,
    mm)."""
    drive_lag: float = 0.0
    """Time constant with which the joints are taken to follow their commanded rates, s; 0: as the
    first motion measures it."""
    forget: float = 1.0
    """Time over which the following error forgets, s: a slow drift is no fault of the drive, unless
    nothing is commanded."""
    come_to_rest: float = 0.5
    """Time without a command after which the joints have come to rest, s. From then on none may
    move by more than ``following``, however slowly."""
    slack: float = 0.005
    """Share of a joint's range by which it may stand beyond its limit."""

    overrun: float = 0.05
    """Longest time by which one tick may come late, s."""
    late_share: float = 0.5
    """Share of its period by which a tick may come late and still count as in time."""
    late_ticks: int = 3
    """Late ticks in a row that are an overrun."""

    innovation: float = 6.0
    """How many standard deviations a marker may be from where the camera should see it,"""
    model_error: float = 1.0
    """beside so many px that a projection does not fit,"""
    mistimed: float = 0.25
    """and this share of its motion in the picture since the frame before."""

    left_over: float = 2.5
    """How much the fit of what the camera should see may leave over, px rms: what leaves more is no
    projection."""
    nearest_camera: float = 30.0
    """How near to the tool any camera is at most, mm: by the fit, a marker that stands still in the
    picture is far behind the other."""

    drift: float = 6.0
    """How many standard deviations the mean of what the fit leaves over may be from none,"""
    drift_px: float = 1.25
    """and how many px,"""
    drift_frames: int = 20
    """over so many frames, before the picture counts as drifting."""
    stuck: float = 1.0
    """Way of the tool, mm, after which a picture that is the same to the last bit counts as
    frozen,"""
    stuck_px: float = 2.0
    """and px that a marker goes at most which stands still while the tool explores and the other
    goes five times as far."""
    elsewhere: float = 2.0
    """How far from where the target was shown, by the joints, the tool may be where the picture
    shows it there, mm, beside what noise explains; inf: as far as it likes."""
    elsewhere_time: float = 0.2
    """for so long, s. The same where it has been there and leaves again."""

    without_marker: float = 1.5
    """Deviation of the pose, mm, up to which one lost marker only slows the tool, as the other and
    the joints tell where it is; 0: never."""

    jump: float = 3.0
    """How far a marker may move in the picture of a tool at rest while nothing foretells it, px,
    beside ``innovation`` standard deviations."""
    nearest: float = 20.0
    """How far 1 mm of motion may move a marker in the picture, px, where no estimate tells it
    better."""
    comparable: float = 10.0
    """Motion from one frame to the next up to which the markers of a tool that has not explored yet
    are compared, mm. By hand a tool moves further."""
    agreement: float = 2.0
    """How far apart markers may be that jumped to the same new place, in ``jump``."""
    rejected: int = 3
    """Frames in a row that were not believed from which on the tool stops."""
    rejected_for_good: int = 30
    """Frames in a row after which what seemed mistaken must be the view itself."""

    telling: float = 0.2
    """Scaled feature change, as predicted, from which on a motion tells whether the estimate is
    right."""
    wrong: float = 0.75
    """Share of the predicted change by which the measured one may differ, beside ``telling``."""
    disagreements: int = 5
    """Judgements in a row against the estimate that spoil it."""
    closed: float = 0.02
    """Share of the error that the damped law works off below which the way is closed: singular."""
    nearly_closed: float = 0.2
    """The same for going slowly."""
    small_error: float = 0.2
    """A scaled error √(2V) up to which this is not judged: noise has any direction."""
    least_room: float = 0.2
    """Share of the exploration's full volume that the joint limits must leave."""
    largest: float = 30.0
    """Largest entry of the scaled Ĵ, 1/mm: 30 is 300 px a mm, more than any camera sees."""

    hold_time: float = 1.0
    """Time of standing still after which only a person resumes, s."""
    good_to_recover: int = 5
    """New good frames that end a HOLD."""
    good_to_servo: int = 6
    """New good frames in ACQUIRE, with the estimate at hand, before SERVO."""

    limit_horizon: float = 0.1
    """A joint blocks the way if it would pass its limit within this time, s,"""
    limit_share: float = 0.3
    """and if without it less than this share of the speed is left."""

    stall_error: float = 0.5
    """A scaled error √(2V) above this that does not fall has stalled."""
    stall_fall: float = 0.2
    """It falls if it gets smaller by this"""
    stall_share: float = 0.02
    """or by this share of itself"""
    stall_time: float = 6.0
    """within this time, s,"""
    stall_gains: float = 3.0
    """and within this number of the law's time constants 1/k."""

    def __post_init__(self) -> None:
        self._require(self.stale_slow >= 1.0, "stale_slow", "at least 1 frame period")
        above = self.stale_slow <= self.stale_hold < math.inf
        self._require(above, "stale_hold", "a number of frame periods not below stale_slow")
        for name in ("latency", "silence", "overrun", "first_period", "come_to_rest"):
            good = 0.0 < getattr(self, name) <= 1.0
            self._require(good, name, "a time above 0 and at most 1 s")
        self._require(0.0 <= self.drive_lag <= 1.0, "drive_lag", "a time of 0 to 1 s")
        good = len(self.following) == 3 and all(0.0 < value < math.inf for value in self.following)
        self._require(good, "following", "three positive numbers (rad, rad, mm)")
        require_radians("thresholds.following", self.following, self.following[:2], math.pi)
        self._require(0.0 < self.jump < math.inf, "jump", "a positive number of px")
        self._require(self.elsewhere > 0.0, "elsewhere", "a positive number of mm, or inf")
        self._require(
            0.0 <= self.without_marker < math.inf, "without_marker", "a number of mm, 0 or more"
        )
        for name in POSITIVE:
            self._require(0.0 < getattr(self, name) < math.inf, name, "a positive number")
        for name in SHARES:
            self._require(0.0 < getattr(self, name) <= 1.0, name, "a share above 0 and at most 1")
        for name in COUNTS:
            good = 1 <= getattr(self, name) <= 1000
            self._require(good, name, "a whole number from 1 to 1000")

    def _require(self, good: bool, name: str, right: str) -> None:
        require(good, f"thresholds.{name}", getattr(self, name), right)


POSITIVE = (
    "forget",
    "left_over",
    "nearest_camera",
    "innovation",
    "drift",
    "drift_px",
    "stuck",
    "stuck_px",
    "elsewhere_time",
    "model_error",
    "mistimed",
    "nearest",
    "comparable",
    "agreement",
    "telling",
    "largest",
    "hold_time",
    "limit_horizon",
    "small_error",
    "stall_error",
    "stall_fall",
    "stall_time",
    "stall_gains",
)
SHARES = (
    "slack",
    "late_share",
    "wrong",
    "closed",
    "nearly_closed",
    "least_room",
    "limit_share",
    "stall_share",
)
COUNTS = (
    "late_ticks",
    "rejected",
    "rejected_for_good",
    "disagreements",
    "good_to_recover",
    "good_to_servo",
    "drift_frames",
)
