"""From where on something is a fault, a stall or a blocked way: every number that decides it."""

import math
from dataclasses import dataclass
from typing import Annotated

from rcmservo.constraints import (
    FRACTION,
    Checked,
    Limit,
    Triple,
    above,
    angles,
    at_least,
    between,
    not_negative,
    positive,
    three_positive,
)

SHORT = above(0.0, 1.0, "a time", "s")
TIME = positive("time in s")
LENGTH = positive("length in mm")
PIXELS = positive("number of px")
NUMBER = positive()
OR_INFINITE = Limit(lambda mm: mm > 0.0, "a positive number of mm, or inf")
COUNT = between(1, 1000, "a whole number")


@dataclass(frozen=True)
class Thresholds(Checked, section="thresholds"):
    """From where on something is a fault.

    Parameters
    ----------
    stale_slow : float
        Age of the newest frame since it arrived, in frame periods, from which on the tool goes
        slowly.
    stale_hold : float
        The same for standing still.
    first_period : float
        Time between frames that is expected while only one has been seen, s.
    latency : float
        Longest time from a frame's exposure to the command made of it, s; up to it latency is
        compensated.
    silence : float
        Longest time for which the arm may not answer, s.
    following : Triple
        How far each joint may stand from where its commands should have brought it (rad, rad, mm).
    drive_lag : float
        Time constant with which the joints are taken to follow their commanded rates, s; 0: as the
        first motion measures it.
    forget : float
        Time over which the following error forgets, s: a slow drift is no fault of the drive,
        unless nothing is commanded.
    come_to_rest : float
        Time without a command after which the joints have come to rest, s. From then on none may
        move by more than ``following``, however slowly.
    slack : float
        Share of a joint's range by which it may stand beyond its limit.
    overrun : float
        Longest time by which one tick may come late, s.
    late_share : float
        Share of its period by which a tick may come late and still count as in time.
    late_ticks : int
        Late ticks in a row that are an overrun.
    innovation : float
        How many standard deviations a marker may be from where the camera should see it,
    model_error : float
        beside so many px that a projection does not fit,
    mistimed : float
        and this share of its motion in the picture since the frame before.
    left_over : float
        How much the fit of what the camera should see may leave over, px rms: what leaves more is
        no projection.
    nearest_camera : float
        How near to the tool any camera is at most, mm: by the fit, a marker that stands still in
        the picture is far behind the other.
    drift : float
        How many standard deviations the mean of what the fit leaves over may be from none,
    drift_px : float
        and how many px,
    drift_frames : int
        over so many frames, before the picture counts as drifting.
    stuck : float
        Way of the tool, mm, after which a picture that is the same to the last bit counts as
        frozen,
    stuck_px : float
        and px that a marker goes at most which stands still while the tool explores and the other
        goes five times as far.
    elsewhere : float
        How far from where the target was shown, by the joints, the tool may be where the picture
        shows it there, mm, beside what noise explains; inf: as far as it likes.
    elsewhere_time : float
        for so long, s. The same where it has been there and leaves again.
    without_marker : float
        Deviation of the pose, mm, up to which one lost marker only slows the tool, as the other and
        the joints tell where it is; 0: never.
    jump : float
        How far a marker may move in the picture of a tool at rest while nothing foretells it, px,
        beside ``innovation`` standard deviations.
    nearest : float
        How far 1 mm of motion may move a marker in the picture, px, where no estimate tells it
        better.
    comparable : float
        Motion from one frame to the next up to which the markers of a tool that has not explored
        yet are compared, mm. By hand a tool moves further.
    agreement : float
        How far apart markers may be that jumped to the same new place, in ``jump``.
    rejected : int
        Frames in a row that were not believed from which on the tool stops.
    rejected_for_good : int
        Frames in a row after which what seemed mistaken must be the view itself.
    telling : float
        Scaled feature change, as predicted, from which on a motion tells whether the estimate is
        right.
    wrong : float
        Share of the predicted change by which the measured one may differ, beside ``telling``.
    disagreements : int
        Judgements in a row against the estimate that spoil it.
    closed : float
        Share of the error that the damped law works off below which the way is closed: singular.
    nearly_closed : float
        The same for going slowly.
    small_error : float
        A scaled error √(2V) up to which this is not judged: noise has any direction.
    least_room : float
        Share of the exploration's full volume that the joint limits must leave.
    largest : float
        Largest entry of the scaled Ĵ, 1/mm: 30 is 300 px a mm, more than any camera sees.
    hold_time : float
        Time of standing still after which only a person resumes, s.
    good_to_recover : int
        New good frames that end a HOLD.
    good_to_servo : int
        New good frames in ACQUIRE, with the estimate at hand, before SERVO.
    limit_horizon : float
        A joint blocks the way if it would pass its limit within this time, s,
    limit_share : float
        and if without it less than this share of the speed is left.
    stall_error : float
        A scaled error √(2V) above this that does not fall has stalled.
    stall_fall : float
        It falls if it gets smaller by this
    stall_share : float
        or by this share of itself
    stall_time : float
        within this time, s,
    stall_gains : float
        and within this number of the law's time constants 1/k.
    """

    name = "thresholds"

    stale_slow: Annotated[float, at_least(1.0, "frame period")] = 1.5
    stale_hold: Annotated[float, positive("number of frame periods")] = 3.0
    first_period: Annotated[float, SHORT] = 0.1
    latency: Annotated[float, SHORT] = 0.1

    silence: Annotated[float, SHORT] = 0.05
    following: Annotated[Triple, three_positive("rad, rad, mm"), angles(math.pi, first=2)] = (
        0.008,
        0.008,
        0.6,
    )
    drive_lag: Annotated[float, between(0.0, 1.0, "a time", "s")] = 0.0
    forget: Annotated[float, TIME] = 1.0
    come_to_rest: Annotated[float, SHORT] = 0.5
    slack: Annotated[float, FRACTION] = 0.005

    overrun: Annotated[float, SHORT] = 0.05
    late_share: Annotated[float, FRACTION] = 0.5
    late_ticks: Annotated[int, COUNT] = 3

    innovation: Annotated[float, NUMBER] = 6.0
    model_error: Annotated[float, PIXELS] = 1.0
    mistimed: Annotated[float, NUMBER] = 0.25

    left_over: Annotated[float, PIXELS] = 2.5
    nearest_camera: Annotated[float, LENGTH] = 30.0

    drift: Annotated[float, NUMBER] = 6.0
    drift_px: Annotated[float, PIXELS] = 1.25
    drift_frames: Annotated[int, COUNT] = 20
    stuck: Annotated[float, LENGTH] = 1.0
    stuck_px: Annotated[float, PIXELS] = 2.0
    elsewhere: Annotated[float, OR_INFINITE] = 2.0
    elsewhere_time: Annotated[float, TIME] = 0.2

    without_marker: Annotated[float, not_negative("number of mm")] = 1.5

    jump: Annotated[float, PIXELS] = 3.0
    nearest: Annotated[float, PIXELS] = 20.0
    comparable: Annotated[float, LENGTH] = 10.0
    agreement: Annotated[float, NUMBER] = 2.0
    rejected: Annotated[int, COUNT] = 3
    rejected_for_good: Annotated[int, COUNT] = 30

    telling: Annotated[float, NUMBER] = 0.2
    wrong: Annotated[float, FRACTION] = 0.75
    disagreements: Annotated[int, COUNT] = 5
    closed: Annotated[float, FRACTION] = 0.02
    nearly_closed: Annotated[float, FRACTION] = 0.2
    small_error: Annotated[float, NUMBER] = 0.2
    least_room: Annotated[float, FRACTION] = 0.2
    largest: Annotated[float, NUMBER] = 30.0

    hold_time: Annotated[float, TIME] = 1.0
    good_to_recover: Annotated[int, COUNT] = 5
    good_to_servo: Annotated[int, COUNT] = 6

    limit_horizon: Annotated[float, TIME] = 0.1
    limit_share: Annotated[float, FRACTION] = 0.3

    stall_error: Annotated[float, NUMBER] = 0.5
    stall_fall: Annotated[float, NUMBER] = 0.2
    stall_share: Annotated[float, FRACTION] = 0.02
    stall_time: Annotated[float, TIME] = 6.0
    stall_gains: Annotated[float, NUMBER] = 3.0

    def __post_init__(self) -> None:
        super().__post_init__()
        right = "a number of frame periods not below stale_slow"
        self.require(self.stale_hold >= self.stale_slow, "stale_hold", right)
