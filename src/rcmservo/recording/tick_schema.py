"""Schema of a tick: name, parts with units, and source of each of its values.

The messages on disk, the exported tables and the comparison of two runs derive from these tables.
"""

from collections.abc import Callable
from operator import attrgetter as at
from typing import Any, NamedTuple

import numpy as np

from rcmservo.estimation.projection_rule import ProjectionMemory
from rcmservo.interfaces import Floats
from rcmservo.loop.tick import Tick

JOINTS = ("1 [rad]", "2 [rad]", "3 [mm]")
RATES = ("1 [rad/s]", "2 [rad/s]", "3 [mm/s]")
POSITION = ("x [mm]", "y [mm]", "z [mm]")
VELOCITY = ("x [mm/s]", "y [mm/s]", "z [mm/s]")
FEATURES = ("s [rad]", "r [px]", "d [px]")
IMAGE_POINT = ("u [px]", "v [px]")
MARKER_SIZES = ("m1 [px]", "m2 [px]")
MARKER_QUALITIES = ("m1 [1]", "m2 [1]")
MARKERS = ("m1_u [px]", "m1_v [px]", "m2_u [px]", "m2_v [px]")
JACOBIAN = tuple(
    f"{y}_{x} [{unit}/mm]" for y, unit in (("s", "rad"), ("r", "px"), ("d", "px")) for x in "xyz"
)
PARAMETERS = tuple(f"{i} [free scale]" for i in range(1, 10))
TIME, COUNT, FLAG = ("[ns]",), ("[1]",), ("[0 or 1]",)


class Column(NamedTuple):
    """One entry of a tick.

    Parameters
    ----------
    name : str
        Name in messages, tables and comparisons.
    parts : tuple[str, ...]
        Name and unit of each number.
    value_of : Callable[[Tick], Any]
        Function that returns the value of a tick.
    """

    name: str
    parts: tuple[str, ...]
    value_of: Callable[[Tick], Any]


def _a_hat(tick: Tick) -> Floats:
    memory = tick.state.estimation.memory
    return memory.a_hat if isinstance(memory, ProjectionMemory) else np.full(9, np.nan)


def _model(tick: Tick) -> Floats:
    """Return π (34) of both markers from o_c; NaN if the estimator has no projection model."""
    state, servo = tick.state, tick.servo
    model = servo.guarded_estimator.predict(state.estimation.memory, servo.tool, state.p1)
    return np.full(4, np.nan) if model is None else model


INTEGER_COLUMNS = (
    Column("now", TIME, at("observation.now")),
    Column("q_time", TIME, at("observation.q_time")),
    Column("frame", COUNT, at("observation.frame")),
    Column("exposure", TIME, at("observation.exposure")),
    Column("arrival", TIME, at("observation.arrival")),
    Column("accepted_frame", COUNT, at("state.accepted_frame")),
    Column("since", TIME, at("state.mode.since")),
    Column("accepted_frames", COUNT, at("state.mode.accepted_frames")),
    Column("command_number", COUNT, at("state.command.number")),
    Column("command_time", TIME, at("state.command.time")),
    Column("command_deadline", TIME, at("state.command.deadline")),
    Column("latency", TIME, at("state.monitor.latency")),
)
"""Integers of a tick."""

REAL_COLUMNS = (
    Column("rcm_condition", COUNT, at("state.estimation.estimate.rcm_condition")),
    Column("condition", COUNT, at("state.condition")),
    Column("period", TIME, at("state.monitor.frame_period")),
    Column("q", JOINTS, at("observation.q")),
    Column("q_exposure", JOINTS, at("observation.q_exposure")),
    Column("points", MARKERS, at("observation.points")),
    Column("applied_at_observation", RATES, at("observation.applied")),
    Column("o_c", IMAGE_POINT, at("state.o_c")),
    Column("p1", POSITION, at("state.p1")),
    Column("y", FEATURES, at("state.y")),
    Column("delta", FEATURES, at("state.delta")),
    Column("predicted_delta", FEATURES, at("state.estimation.estimate.predicted_delta")),
    Column("J_hat", JACOBIAN, at("state.J_hat")),
    Column("a_hat", PARAMETERS, _a_hat),
    Column("model", MARKERS, _model),
    Column("v", VELOCITY, at("state.v")),
    Column("command", RATES, at("state.command.rates")),
    Column("applied", RATES, at("applied")),
    Column("sizes", MARKER_SIZES, at("observation.sizes")),
    Column("jog", RATES, at("jog")),
    Column("quality", MARKER_QUALITIES, at("observation.quality")),
)
"""Real numbers of a tick.

`applied_at_observation` are the joint rates that the observation reports; `applied` are the rates
that the arm executed of the command; `jog` are the rates that the operator requested.
"""

LATER = ("sizes",), ("jog",), ("quality",)
"""Real numbers that later versions added, one group per version. They are NaN in older records."""

FLAG_COLUMNS = (
    Column("enabled", FLAG, at("observation.enabled")),
    Column("recorded", FLAG, at("observation.recorded")),
    Column("command_enabled", FLAG, at("state.command.enabled")),
    Column("explored", FLAG, at("state.explored")),
)
"""Booleans of a tick."""

NAME_COLUMNS = (
    Column("phase", ("",), at("state.mode.phase.name")),
    Column("cause", ("",), at("state.mode.cause.name")),
    Column("action", ("",), at("state.mode.action.name")),
    Column("request", ("",), at("request.name")),
    Column("dropped", ("",), at("observation.drop_reason.name")),
)
"""Enum members of a tick, by name."""

FORMER_NAMES = {
    "accepted_frame": "believed",  # codespell:ignore believed
    "accepted_frames": "good",
    "applied_at_observation": "applied_before",
    "predicted_delta": "ahead",
    "action": "asks",
}
"""Names of columns in older records, by their present names."""

TRUTH_COLUMNS = {"p1": POSITION, "p2": POSITION, "jacobian_error": COUNT}
"""Values that only a simulation knows at a tick."""
