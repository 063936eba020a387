"""Rows of unnoticed.py: disturbances with plausible frames, and the times at which they start.

A disturbance starts at a random time, usually during the motion, sometimes after settling, and in
some rows sometimes during the exploration. It lasts to the end, or changes the camera permanently.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from changed_frames import (
    MakeChange,
    change_fraction,
    freeze_with_noise,
    misplace_marker,
    release_joint,
    repeat_every,
    stand_still,
    swap_markers,
)

import rcmservo as rs
from rcmservo.interfaces import Floats
from rcmservo.sim import Disturbance, Drive
from rcmservo.sim.disturbances import expected_causes

FIRST = 10.0
"""Duration (s) of the first of two runs."""

MOVED = 10.5
"""Time (s) after the start of the first run at which the camera moves, before the second."""

SHOWN = 5.0
"""Time (s) for which a target is taught."""

EXPLORING, ON_THE_WAY, AFTER = (0.1, 0.6), (0.65, 1.9), (8.0, 12.0)
"""Intervals (s) after the start of a run: exploration, motion to the target, settled."""

RUN, SHOWING, TWO_RUNS = "in the run", "while teaching", "between two runs"
"""Stages in which a disturbance occurs."""

Chance = np.random.Generator
Drawn = Callable[[Chance], float]


def sign(random: Chance) -> float:
    """Return 1 or -1 at random."""
    return float(random.choice([-1.0, 1.0]))


def either(random: Chance) -> float:
    """Return marker 1 or 2 at random."""
    return float(random.integers(1, 3))


def evenly(low: float, high: float) -> Drawn:
    """Return a function that draws a number between two limits."""
    return lambda random: random.uniform(low, high)


def either_way(value: float) -> Drawn:
    """Return a function that draws a number or its negative."""
    return lambda random: sign(random) * value


def later(random: Chance) -> float:
    """Return a start (s) during the motion or, in one run of four, after settling."""
    span = ON_THE_WAY if random.uniform() < 0.75 else AFTER
    return random.uniform(*span)


def at_any_time(random: Chance) -> float:
    """Return a start like `later`, but in one run of six during the exploration."""
    return random.uniform(*EXPLORING) if random.uniform() < 1.0 / 6.0 else later(random)


@dataclass(frozen=True)
class Trouble:
    """A random disturbance; ``causes`` are expected in addition to those of its kind.

    ``when`` is one of `RUN`, `SHOWING` and `TWO_RUNS`. ``change`` replaces the taught pixels (2, 2)
    by those that the image of the run would have shown. ``frames`` changes the frames from a time
    on that ``at`` draws, in s after the start of the run, or of teaching.
    """

    says: str
    draw: Callable[[Chance], list[Disturbance]]
    when: str = RUN
    causes: frozenset[rs.Cause] = frozenset()
    drive: Drive = field(default_factory=Drive)
    change: Callable[[Chance, Floats], Floats] | None = None
    frames: MakeChange | None = None
    at: Drawn = later


def acting(
    kind: str,
    at: float | Drawn = later,
    lasts: float | None = None,
    **parameters: float | str | Drawn,
) -> Callable[[Chance], list[Disturbance]]:
    """Return a function that draws one disturbance of a kind.

    Its start and its parameters are numbers or functions that draw them.
    """

    def drawn(value: float | Drawn, random: Chance) -> float:
        return round(float(value(random) if callable(value) else value), 3)

    def draw(random: Chance) -> list[Disturbance]:
        began = drawn(at, random)
        values = {
            key: value if isinstance(value, str) else drawn(value, random)
            for key, value in parameters.items()
        }
        return [Disturbance(kind, began, lasts, values)]

    return draw


def turn_image(u: bool, v: bool) -> Callable[[Chance, Floats], Floats]:
    """Return a function that mirrors pixels left to right if `u`, and top to bottom if `v`."""
    size, turned = np.array([639.0, 479.0]), np.array([u, v])
    return lambda random, points: np.where(turned, size - points, points)


def displace_marker(px: float) -> Callable[[Chance, Floats], Floats]:
    """Return a function that displaces one marker by `px` in a random direction."""

    def change(random: Chance, points: Floats) -> Floats:
        angle, changed = random.uniform(0.0, 2.0 * np.pi), points.copy()
        changed[random.integers(2)] += px * np.array([np.cos(angle), np.sin(angle)])
        return changed

    return change


def wrong_target(says: str, change: Callable[[Chance, Floats], Floats]) -> Trouble:
    """Return a trouble whose target the camera would show at other pixels than it was taught."""
    causes = frozenset({rs.Cause.IMPLAUSIBLE, rs.Cause.ELSEWHERE})
    return Trouble(says, lambda random: [], causes=causes, change=change)


def changed_frames(
    says: str,
    frames: MakeChange,
    at: Drawn = later,
    causes: tuple[rs.Cause, ...] = (),
    when: str = RUN,
) -> Trouble:
    """Return a trouble that changes frames."""
    return Trouble(says, lambda random: [], when, causes=frozenset(causes), frames=frames, at=at)


def from_start(random: Chance) -> float:
    """Return the start of the run."""
    return 0.0


LAGS = frozenset({rs.Cause.NOT_FOLLOWING})

ROWS: dict[str, Trouble] = {
    "none": Trouble("no disturbance", lambda random: []),
    "freeze": Trouble(
        "the image freezes, but not the numbers and times of frames; also while exploring",
        acting("freeze", at_any_time),
    ),
    "freeze_marker": Trouble(
        "one marker freezes in the image; also while exploring",
        acting("freeze", at_any_time, marker=either),
    ),
    "freeze_after": Trouble(
        "one of these two after settling",
        acting("freeze", evenly(*AFTER), marker=lambda random: random.integers(0, 3)),
    ),
    "slide": Trouble(
        "a decoy slides away from a marker at 2-10 px/s; also while exploring",
        acting("decoy", at_any_time, marker=either, px=0.0, speed=evenly(2.0, 10.0)),
    ),
    "pan": Trouble(
        "the camera turns at 10 px/s for 4.5 s; also while exploring",
        acting("camera_pan", at_any_time, 4.5, px=45.0),
    ),
    "pan_slow": Trouble(
        "the camera turns at 5 px/s for 9 s", acting("camera_pan", lasts=9.0, px=45.0)
    ),
    "pan_1": Trouble(
        "the camera turns at 1 px/s for 15 s", acting("camera_pan", lasts=15.0, px=15.0)
    ),
    "pan_3": Trouble(
        "the camera turns at 3 px/s for 12 s", acting("camera_pan", lasts=12.0, px=36.0)
    ),
    "bump": Trouble(
        "the camera turns by 8 px at once, on the way",
        acting("camera_pan", evenly(*ON_THE_WAY), px=8.0),
    ),
    "bump_after": Trouble("the same after settling", acting("camera_pan", evenly(*AFTER), px=8.0)),
    "dolly": Trouble(
        "the camera moves by 8 mm along its optical axis, at 2 mm/s",
        acting("camera_dolly", lasts=4.0, mm=either_way(8.0)),
    ),
    "rolling": Trouble(
        "the camera rolls at 1 deg/s for 8 s",
        acting("camera_roll", lasts=8.0, deg=either_way(8.0)),
    ),
    "zoom": Trouble("the focal length grows by 2 %", acting("camera_zoom", share=0.02)),
    "zoom_taught": Trouble(
        "the focal length is 2 % longer than while teaching", acting("camera_zoom", 0.0, share=0.02)
    ),
    "zoom_out": Trouble(
        "the focal length is 3 % shorter than while teaching",
        acting("camera_zoom", 0.0, share=-0.03),
    ),
    "mirrored": wrong_target(
        "the image is mirrored left to right since teaching", turn_image(True, False)
    ),
    "flipped": wrong_target(
        "the image is mirrored top to bottom since teaching", turn_image(False, True)
    ),
    "upside_down": wrong_target("the image is upside down since teaching", turn_image(True, True)),
    "marker_25": wrong_target(
        "a marker was 25 px wrong throughout teaching", displace_marker(25.0)
    ),
    "marker_8": wrong_target("a marker was 8 px wrong throughout teaching", displace_marker(8.0)),
    "between_15": Trouble(
        "the camera turns by 15 px between two runs, and the tool is moved by hand",
        acting("camera_pan", MOVED, px=15.0),
        TWO_RUNS,
    ),
    "between_60": Trouble(
        "as between_15, but by 60 px", acting("camera_pan", MOVED, px=60.0), TWO_RUNS
    ),
    "taught": Trouble(
        "a marker is displaced by 6-150 px in every second frame, while teaching",
        acting("decoy", 0.0, SHOWN, marker=either, px=evenly(6.0, 150.0), every=2),
        SHOWING,
    ),
    "clocks": Trouble(
        "the clock of the camera is 30 ms ahead of the computer's or behind it",
        acting("camera_clock", s=either_way(0.03), of="exposures"),
    ),
    "clock_step": Trouble(
        "as clocks, but with arrivals by the same clock", acting("camera_clock", s=either_way(0.03))
    ),
    "lag": Trouble("the drives lag by 60 ms", lambda random: [], RUN, LAGS, Drive(lag=0.06)),
    "blocked": Trouble(
        "an axis is blocked, on the way",
        acting("gain", evenly(*ON_THE_WAY), axis=lambda random: random.integers(1, 4), factor=0.0),
    ),
    "gain_80": Trouble(
        "an axis follows by 80 % instead of 100 %, from a time on the way",
        acting("gain", evenly(*ON_THE_WAY), axis=lambda random: random.integers(1, 4), factor=0.8),
    ),
    "latency": Trouble("frames arrive 0.25 s later than before", acting("latency", s=0.25)),
    "creep": Trouble(
        "a joint creeps at 0.3-5 deg/s or mm/s",
        acting(
            "creep",
            axis=lambda random: random.integers(1, 4),
            speed=lambda random: sign(random) * random.uniform(0.3, 5.0),
        ),
    ),
    "frozen_noise": changed_frames(
        "the image freezes, with 0.1 px of fresh noise; also while exploring",
        freeze_with_noise(0.1),
        at_any_time,
        tuple(expected_causes("freeze")),
    ),
    "slide_3": Trouble(
        "a decoy slides away from a marker at 3 px/s",
        acting("decoy", marker=either, px=0.0, speed=3.0),
    ),
    "dolly_in": Trouble(
        "the camera moves by -8 mm along its optical axis, at -3 mm/s",
        acting("camera_dolly", lasts=8.0 / 3.0, mm=-8.0),
    ),
    "swapped_10": changed_frames(
        "the markers are swapped in a tenth of the frames, from the start",
        change_fraction(0.1, swap_markers),
        from_start,
        (rs.Cause.SWAPPED,),
    ),
    "released": changed_frames(
        "a joint no longer moves the tool",
        release_joint(),
        causes=(rs.Cause.SURPRISED, rs.Cause.DRIFTS, rs.Cause.IMPLAUSIBLE, rs.Cause.ELSEWHERE),
    ),
    "wrong_5": changed_frames(
        "a marker is 30-100 px wrong in 5 % of the frames, from the start",
        change_fraction(0.05, misplace_marker),
        from_start,
        (rs.Cause.SURPRISED,),
    ),
    "wrong_10": changed_frames(
        "as wrong_5, but in 10 % of the frames",
        change_fraction(0.1, misplace_marker),
        from_start,
        (rs.Cause.SURPRISED,),
    ),
    "taught_4": changed_frames(
        "a marker is 30-100 px wrong in 4 % of the frames while teaching",
        change_fraction(0.04, misplace_marker),
        from_start,
        when=SHOWING,
    ),
    "repeated": changed_frames(
        "every third frame repeats the last under a new number, from the start",
        repeat_every(3),
        from_start,
    ),
    "still": changed_frames(
        "two things that do not move with the tool are detected as markers, from the start",
        stand_still,
        from_start,
        (rs.Cause.STANDS_STILL,),
    ),
    "arm_clock": Trouble("the clock of the arm jumps back by 1 s", acting("arm_clock", s=-1.0)),
}
