"""What a tick holds, written once: every number's name, kind, parts with units, and where it is.

The messages on disk, the exported tables and the comparison of two runs follow from these tables.
"""

from collections.abc import Callable
from operator import attrgetter as at
from typing import Any, NamedTuple

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.loop.tick import Tick
from rcmservo.method.estimators.projection import ProjectionMemory

JOINTS = ("1 [rad]", "2 [rad]", "3 [mm]")
RATES = ("1 [rad/s]", "2 [rad/s]", "3 [mm/s]")
PLACE = ("x [mm]", "y [mm]", "z [mm]")
SPEED = ("x [mm/s]", "y [mm/s]", "z [mm/s]")
FEATURES = ("s [rad]", "r [px]", "d [px]")
PIXEL = ("u [px]", "v [px]")
SIZES = ("m1 [px]", "m2 [px]")
QUALITY = ("m1 [1]", "m2 [1]")
MARKERS = ("m1_u [px]", "m1_v [px]", "m2_u [px]", "m2_v [px]")
JACOBIAN = tuple(
    f"{y}_{x} [{unit}/mm]" for y, unit in (("s", "rad"), ("r", "px"), ("d", "px")) for x in "xyz"
)
PARAMETERS = tuple(f"{i} [free scale]" for i in range(1, 10))
TIME, COUNT, TRUE_OR_NOT = ("[ns]",), ("[1]",), ("[0 or 1]",)


class Column(NamedTuple):
    """One entry of a tick."""

    name: str
    """What the messages on disk, tables and comparisons call it."""
    parts: tuple[str, ...]
    """What its numbers are, with their units; as many as it has."""
    of: Callable[[Tick], Any]
    """Where it is."""


def _a_hat(tick: Tick) -> Floats:
    memory = tick.state.learnt.memory
    return memory.a_hat if isinstance(memory, ProjectionMemory) else np.full(9, np.nan)


def _model(tick: Tick) -> Floats:
    """π (34) of both markers from o_c; NaN where the estimator has no such model."""
    state, servo = tick.state, tick.servo
    model = servo.learner.predict(state.learnt.memory, servo.tool, state.p1)
    return np.full(4, np.nan) if model is None else model


INTEGERS = (
    Column("now", TIME, at("seen.now")),
    Column("q_time", TIME, at("seen.q_time")),
    Column("frame", COUNT, at("seen.frame")),
    Column("exposure", TIME, at("seen.exposure")),
    Column("arrival", TIME, at("seen.arrival")),
    Column("believed", COUNT, at("state.believed")),
    Column("since", TIME, at("state.mode.since")),
    Column("good", COUNT, at("state.mode.good")),
    Column("command_number", COUNT, at("state.command.number")),
    Column("command_time", TIME, at("state.command.time")),
    Column("command_deadline", TIME, at("state.command.deadline")),
    Column("latency", TIME, at("state.watch.latency")),
)
"""A tick's whole numbers."""

REALS = (
    Column("rcm_condition", COUNT, at("state.learnt.estimate.rcm_condition")),
    Column("condition", COUNT, at("state.condition")),
    Column("period", TIME, at("state.watch.period")),
    Column("q", JOINTS, at("seen.q")),
    Column("q_exposure", JOINTS, at("seen.q_exposure")),
    Column("points", MARKERS, at("seen.points")),
    Column("applied_before", RATES, at("seen.applied")),
    Column("o_c", PIXEL, at("state.o_c")),
    Column("p1", PLACE, at("state.p1")),
    Column("y", FEATURES, at("state.y")),
    Column("delta", FEATURES, at("state.delta")),
    Column("ahead", FEATURES, at("state.learnt.estimate.ahead")),
    Column("J_hat", JACOBIAN, at("state.J_hat")),
    Column("a_hat", PARAMETERS, _a_hat),
    Column("model", MARKERS, _model),
    Column("v", SPEED, at("state.v")),
    Column("command", RATES, at("state.command.rates")),
    Column("applied", RATES, at("applied")),
    Column("sizes", SIZES, at("seen.sizes")),
    Column("jog", RATES, at("jog")),
    Column("quality", QUALITY, at("seen.quality")),
)
"""A tick's other numbers. `applied_before` are the rates that the observation tells, `applied`
those that the arm took of the command, `jog` those that a person asked for who moves the joints."""

LATER = ("sizes",), ("jog",), ("quality",)
"""Those of them that came with one version after the other: NaN where a record without them is
read."""

FLAGS = (
    Column("enabled", TRUE_OR_NOT, at("seen.enabled")),
    Column("recorded", TRUE_OR_NOT, at("seen.recorded")),
    Column("command_enabled", TRUE_OR_NOT, at("state.command.enabled")),
    Column("explored", TRUE_OR_NOT, at("state.explored")),
)
"""What is true or not at a tick."""

WORDS = (
    Column("phase", ("",), at("state.mode.phase.name")),
    Column("cause", ("",), at("state.mode.cause.name")),
    Column("asks", ("",), at("state.mode.asks.name")),
    Column("request", ("",), at("request.name")),
    Column("dropped", ("",), at("seen.dropped.name")),
)
"""A tick's names."""

TRUTH = {"p1": PLACE, "p2": PLACE, "jacobian_error": COUNT}
"""What a simulation knows at a tick."""
