"""Schema of a recorded tick: name, units and source of each value.

The messages on disk, the exported tables and the comparison of two runs derive from these tables. A
column's name follows the symbols of the paper where it has one, such as `J_hat` and `o_c`.
"""

from collections.abc import Callable
from operator import attrgetter as get
from typing import Any, NamedTuple

import numpy as np

from rcmservo.estimation.projection_rule import ProjectionMemory
from rcmservo.interfaces import Floats
from rcmservo.loop.tick import Tick

# names and units of the numbers of a column
JOINTS = ("1 [rad]", "2 [rad]", "3 [mm]")
RATES = ("1 [rad/s]", "2 [rad/s]", "3 [mm/s]")
POSITION = ("x [mm]", "y [mm]", "z [mm]")
LENGTH = ("[mm]",)
BOUND_PARTS = ("noise [mm]", "arm [mm]", "way [mm]")
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
    """One value of a tick, which consists of one or more numbers, or a name.

    Parameters
    ----------
    name : str
        Name in messages, tables and comparisons.
    parts : tuple[str, ...]
        Name and unit of each number, such as "u [px]".
    value_of : Callable[[Tick], Any]
        Function that returns the value from a tick.
    """

    name: str
    parts: tuple[str, ...]
    value_of: Callable[[Tick], Any]


def _read_projection(tick: Tick) -> Floats:
    """Return the parameters a_hat (9,) of the projection; NaN if the estimator has none."""
    memory = tick.state.estimation.memory
    return memory.a_hat if isinstance(memory, ProjectionMemory) else np.full(9, np.nan)


def _predict_markers(tick: Tick) -> Floats:
    """Return both markers (4,) in px from o_c as the projection π, eq. (34), predicts them at p1.

    They are NaN if the estimator has no projection.
    """
    state, servo = tick.state, tick.servo
    markers = servo.guarded_estimator.predict(state.estimation.memory, servo.tool, state.p1)
    return np.full(4, np.nan) if markers is None else markers


INTEGER_COLUMNS = (
    Column("now", TIME, get("observation.now")),
    Column("q_time", TIME, get("observation.q_time")),
    Column("frame", COUNT, get("observation.frame")),
    Column("exposure", TIME, get("observation.exposure")),
    Column("arrival", TIME, get("observation.arrival")),
    Column("accepted_frame", COUNT, get("state.accepted_frame")),
    Column("since", TIME, get("state.mode.since")),
    Column("accepted_frames", COUNT, get("state.mode.accepted_frames")),
    Column("command_number", COUNT, get("state.command.number")),
    Column("command_time", TIME, get("state.command.time")),
    Column("command_deadline", TIME, get("state.command.deadline")),
    Column("latency", TIME, get("state.monitor.latency")),
)
"""Integers of a tick."""

REAL_COLUMNS = (
    Column("rcm_condition", COUNT, get("state.estimation.estimate.rcm_condition")),
    Column("condition", COUNT, get("state.condition")),
    Column("period", TIME, get("state.monitor.frame_period")),
    Column("q", JOINTS, get("observation.q")),
    Column("q_exposure", JOINTS, get("observation.q_exposure")),
    Column("points", MARKERS, get("observation.points")),
    Column("applied_at_observation", RATES, get("observation.applied")),
    Column("o_c", IMAGE_POINT, get("state.o_c")),
    Column("p1", POSITION, get("state.p1")),
    Column("y", FEATURES, get("state.y")),
    Column("delta", FEATURES, get("state.delta")),
    Column("predicted_delta", FEATURES, get("state.estimation.estimate.predicted_delta")),
    Column("J_hat", JACOBIAN, get("state.J_hat")),
    Column("a_hat", PARAMETERS, _read_projection),
    Column("model", MARKERS, _predict_markers),
    Column("v", VELOCITY, get("state.v")),
    Column("command", RATES, get("state.command.rates")),
    Column("applied", RATES, get("applied")),
    Column("sizes", MARKER_SIZES, get("observation.sizes")),
    Column("jog", RATES, get("jog")),
    Column("quality", MARKER_QUALITIES, get("observation.quality")),
    Column("pose_bound", LENGTH, get("state.pose_bound")),
    Column("bound_parts", BOUND_PARTS, get("state.bound_parts")),
    Column("resting_rates", RATES, get("state.resting_rates")),
)
"""Real numbers of a tick.

`applied_at_observation` are the joint rates that the observation reports; `applied` are the rates
that the arm executed of the command; `jog` are the rates that the operator requested.
"""

LIMITS = "bound_parts", "resting_rates"

ADDED_COLUMNS = ("sizes",), ("jog",), ("quality",), ("pose_bound",), LIMITS
"""Real numbers that later versions of the format added, one group per version.

They are NaN in older records.
"""

FLAG_COLUMNS = (
    Column("enabled", FLAG, get("observation.enabled")),
    Column("recorded", FLAG, get("observation.recorded")),
    Column("command_enabled", FLAG, get("state.command.enabled")),
    Column("explored", FLAG, get("state.explored")),
)
"""Booleans of a tick."""

NAME_COLUMNS = (
    Column("phase", ("",), get("state.mode.phase.name")),
    Column("cause", ("",), get("state.mode.cause.name")),
    Column("action", ("",), get("state.mode.action.name")),
    Column("request", ("",), get("request.name")),
    Column("dropped", ("",), get("observation.drop_reason.name")),
)
"""Enum members of a tick, stored by name."""

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
