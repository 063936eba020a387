"""The rows of unnoticed.py: what goes wrong while frames stay plausible, and when it begins.

It begins at a moment by chance, mostly on the way, sometimes after settling, and where the row says
so sometimes while exploring. It lasts to the end, or leaves the camera where it is then.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

import rcmservo as rs
from rcmservo.sim import Disturbance, Drive

FIRST = 10.0
"""s of the first run where there are two."""

MOVED = 10.5
"""s after the begin of the first run at which the camera is moved, before the second."""

SHOWN = 5.0
"""s for which a target is shown."""

EXPLORING, ON_THE_WAY, AFTER = (0.3, 1.8), (2.2, 5.0), (8.0, 12.0)
"""s after the begin of a run between which it explores, is on its way, has settled."""

RUN, SHOWING, TWO_RUNS = "in the run", "while showing", "between two runs"
"""When something goes wrong."""

Chance = np.random.Generator
Drawn = Callable[[Chance], float]


@dataclass(frozen=True)
class Trouble:
    """Something that goes wrong, in as many ways as chance draws; ``causes`` are right beside those
    of its disturbances. ``when`` is one of the three above.
    """

    says: str
    draw: Callable[[Chance], list[Disturbance]]
    when: str = RUN
    causes: frozenset[rs.Cause] = frozenset()
    drive: Drive = field(default_factory=Drive)


def sign(random: Chance) -> float:
    """1 or -1."""
    return float(random.choice([-1.0, 1.0]))


def either(random: Chance) -> float:
    """Marker 1 or 2."""
    return float(random.integers(1, 3))


def evenly(low: float, high: float) -> Drawn:
    """Draws a number between these."""
    return lambda random: random.uniform(low, high)


def either_way(value: float) -> Drawn:
    """Draws a number or its opposite."""
    return lambda random: sign(random) * value


def later(random: Chance) -> float:
    """Something begins on the way, or, in one run of four, after settling, s."""
    span = ON_THE_WAY if random.uniform() < 0.75 else AFTER
    return random.uniform(*span)


def at_any_time(random: Chance) -> float:
    """The same, but in one run of six it begins while exploring."""
    return random.uniform(*EXPLORING) if random.uniform() < 1.0 / 6.0 else later(random)


def acting(
    kind: str,
    at: float | Drawn = later,
    lasts: float | None = None,
    **parameters: float | str | Drawn,
) -> Callable[[Chance], list[Disturbance]]:
    """Draws one disturbance of a kind: its begin and its parameters are numbers or draws."""

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


LAGS = frozenset({rs.Cause.NOT_FOLLOWING})

ROWS: dict[str, Trouble] = {
    "none": Trouble("nothing goes wrong", lambda random: []),
    "freeze": Trouble(
        "the picture is frozen, its frames' numbers and times are not; also while exploring",
        acting("freeze", at_any_time),
    ),
    "freeze_marker": Trouble(
        "one marker stays where it is seen; also while exploring",
        acting("freeze", at_any_time, marker=either),
    ),
    "freeze_after": Trouble(
        "either of both after settling",
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
    "pan_slow": Trouble("it turns at 5 px/s for 9 s", acting("camera_pan", lasts=9.0, px=45.0)),
    "dolly": Trouble(
        "it moves by 8 mm along its line of sight, at 2 mm/s",
        acting("camera_dolly", lasts=4.0, mm=either_way(8.0)),
    ),
    "rolling": Trouble(
        "it rolls at 1 deg/s for 8 s", acting("camera_roll", lasts=8.0, deg=either_way(8.0))
    ),
    "zoom": Trouble("its focal length grows by 2 %", acting("camera_zoom", share=0.02)),
    "zoom_taught": Trouble(
        "it has since the target was shown", acting("camera_zoom", 0.0, share=0.02)
    ),
    "between_15": Trouble(
        "the camera is bumped by 15 px between two runs, and the tool moved by hand",
        acting("camera_pan", MOVED, px=15.0),
        TWO_RUNS,
    ),
    "between_60": Trouble("the same by 60 px", acting("camera_pan", MOVED, px=60.0), TWO_RUNS),
    "taught": Trouble(
        "every second frame shows a wrong marker, 6-150 px off, while the target is shown",
        acting("decoy", 0.0, SHOWN, marker=either, px=evenly(6.0, 150.0), every=2),
        SHOWING,
    ),
    "clocks": Trouble(
        "the camera's clock is 30 ms ahead of the computer's or behind it",
        acting("camera_clock", s=either_way(0.03), of="exposures"),
    ),
    "clock_step": Trouble(
        "the same, and arrivals bear its time too", acting("camera_clock", s=either_way(0.03))
    ),
    "lag": Trouble("the drives lag by 60 ms", lambda random: [], RUN, LAGS, Drive(lag=0.06)),
    "latency": Trouble("frames come 0.25 s later than before", acting("latency", s=0.25)),
    "creep": Trouble(
        "a joint creeps at 0.3-5 deg/s or mm/s",
        acting(
            "creep",
            axis=lambda random: random.integers(1, 4),
            speed=lambda random: sign(random) * random.uniform(0.3, 5.0),
        ),
    ),
    "arm_clock": Trouble("the arm's clock jumps back by 1 s", acting("arm_clock", s=-1.0)),
}
