"""Recorded samples for all estimators, so that they observe the same motion and noise.

There are two kinds of stream: a servo run with the printed law, which moves at about 1 px/s, and an
endless exploration at its usual speed.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from rcmservo.control.saturated_controller import scale_rows
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.estimation.dlt import DltEstimator
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import NEVER_NS, Floats
from rcmservo.loop.servo_loop import Tick, servo_ticks
from rcmservo.loop.teach import teach
from rcmservo.paper.lab.closed_loop import make_servo
from rcmservo.paper.lab.evaluation import laboratory
from rcmservo.paper.lab.paper_settings import (
    FAST_ESTIMATOR,
    FLOW_ESTIMATOR,
    FLOW_EXPLORATION,
    PAPER_CONTROLLER,
    PAPER_SCENES,
    SLOW_ESTIMATOR,
    TEACHING_FRAMES,
    remove_limits,
)
from rcmservo.paper.lab.random_observations import RandomObservations
from rcmservo.paper.plan import Settings, TaskResult
from rcmservo.paper.statistics import finite, median
from rcmservo.sim import Rig

StreamKind = Literal["servo", "tour"]
"""A servo run, or an exploration without end."""


class ComparedEstimator(NamedTuple):
    """An estimator of the comparison, with its names.

    Parameters
    ----------
    estimator : Estimator
        Estimator of Ĵ.
    name : str
        Name in tables.
    short : str
        Short name in figures; `SHORT_NAMES_NOTE` explains it.
    """

    estimator: Estimator
    name: str
    short: str


_SLOW = "printed Γ, 10⁴ s per fit"
_REAL_TIME = RandomObservations(estimator_time=0.0)
ESTIMATORS: Mapping[str, ComparedEstimator] = {
    "flow": ComparedEstimator(FLOW_ESTIMATOR, "flow, γ = 0.001", "flow"),
    "random": ComparedEstimator(RandomObservations(), f"{_SLOW}, random observations", "random"),
    "given time": ComparedEstimator(SLOW_ESTIMATOR, f"{_SLOW}, chosen observations", "chosen"),
    "real time": ComparedEstimator(
        _REAL_TIME, "printed Γ, real time, random observations", "real time"
    ),
    "fast": ComparedEstimator(FAST_ESTIMATOR, "fast Γ, both markers", "fast Γ"),
    "whole": ComparedEstimator(DltEstimator(), "whole projection (default)", "whole"),
}
SHORT_NAMES = [compared.short for compared in ESTIMATORS.values()]
SHORT_NAMES_NOTE = (
    "Random and chosen: the printed Γ, 10⁴ s of estimator time per fit, on random observations and "
    "on observations chosen by leverage. Real time: the printed Γ on random observations in real "
    "time. Fast Γ: rcmservo's rule on both markers. Whole: the default of rcmservo, a fit of the "
    "whole projection to all frames."
)
"""Explanation of the short names in the figures."""

SERIES_LENGTH = 300
"""Number of medians over time that a figure shows."""
WINDOW_NS = 20_000_000
"""Time (ns) before and after an exposure over which the true velocity is averaged."""


class Stream(NamedTuple):
    """Samples of a servo, frame by frame, with the true Jacobian and velocity.

    Parameters
    ----------
    samples : list[Sample]
        One sample for each of the n frames that the servo used.
    time : Floats
        Times (n,) in s.
    phase : Floats
        Indices (n,) of the phase: exploration, saturated, end; or initial and later exploration.
    J : Floats
        True Jacobians (n, 3, 3), scaled.
    v : Floats
        True velocities (n, 3) of marker 1 in mm/s.
    """

    samples: list[Sample]
    time: Floats
    phase: Floats
    J: Floats
    v: Floats


def record_stream(
    seed: int, noise: float, settings: Settings, kind: StreamKind
) -> tuple[Rig, Stream]:
    """Return the samples of a servo with the fast Γ, with true Jacobians and velocities."""
    rig, plant = laboratory(seed, PAPER_SCENES, noise)
    exploration = FLOW_EXPLORATION if kind == "servo" else remove_limits(FLOW_EXPLORATION)
    servo = make_servo(rig.settings, FAST_ESTIMATOR, exploration)
    rig.move_to_target()
    target = teach(plant, TEACHING_FRAMES)
    rig.go_home()
    duration = settings.duration if kind == "servo" else settings.touring
    samples, rows, previous = list[Sample](), list[tuple[float, int, Floats, Floats]](), NEVER_NS
    for tick in servo_ticks(plant, servo, target, duration):
        state, exposure = tick.state, tick.state.estimation.estimate.exposure
        if exposure == previous:
            continue
        dt = 0.0 if previous == NEVER_NS else (exposure - previous) * 1e-9
        points, sizes = tick.observation.points, tick.observation.sizes
        samples.append(Sample(state.p1, points, state.o_c, dt, sizes))
        J = scale_rows(rig.truth.jacobian(rig.truth.joints_at(exposure), state.o_c))
        phase, v = _find_phase(tick, settings, kind), average_velocity(rig, exposure)
        rows.append((tick.time / 1e9, phase, J, v))
        previous = exposure
    columns = (np.array(values) for values in zip(*rows, strict=True))
    return rig, Stream(samples, *columns)


def _find_phase(tick: Tick, settings: Settings, kind: StreamKind) -> int:
    if kind == "tour":
        return int(tick.time > settings.learning * 1e9)
    if not tick.state.explored:
        return 0
    return 1 if bool(np.any(np.abs(tick.state.delta) > PAPER_CONTROLLER.bounds_array)) else 2


def average_velocity(rig: Rig, time: int, window: int = WINDOW_NS) -> Floats:
    """Return the true velocity (3,) of marker 1 in mm/s, averaged over `time` ± `window` (ns)."""
    before, after = (
        rig.body.points(rig.truth.joints_at(time + side * window))[0] for side in (-1, 1)
    )
    return (after - before) / (2e-9 * window)


def run_estimator(
    estimator: Estimator, samples: Sequence[Sample], tool: Tool
) -> tuple[Floats, Any]:
    """Return the scaled Ĵ (n, 3, 3) after each sample, and the final memory of the estimator."""
    memory = estimator.init()
    J_hat = np.empty((len(samples), 3, 3))
    for i, sample in enumerate(samples):
        memory = estimator.update(memory, tool, sample)
        J_hat[i] = scale_rows(estimator.jacobian(memory, tool, sample))
    return J_hat, memory


def summarise_jacobian_errors(
    J_hat: Floats, truth: Stream, least_speed: float, phases: int
) -> TaskResult:
    """Return two scaled errors of Ĵ (n, 3, 3): ``full`` of the matrix, ``along`` the motion.

    Each has the medians in the `phases` and a series of medians over time. The error along the
    motion is missing where marker 1 moves by no more than `least_speed` (mm/s).
    """
    error = J_hat - truth.J
    full = np.linalg.norm(error, axis=(1, 2)) / np.linalg.norm(truth.J, axis=(1, 2))
    flow, missing = (
        np.linalg.norm((matrix @ truth.v[:, :, None])[:, :, 0], axis=1)
        for matrix in (truth.J, error)
    )
    moves = np.linalg.norm(truth.v, axis=1) > least_speed
    along = np.where(moves, missing / np.maximum(flow, 1e-12), np.nan)
    in_phase = [truth.phase == phase for phase in range(phases)]
    return {
        measure: {
            "phases": np.array([median(finite(errors[selected])) for selected in in_phase]),
            "series": median_series(errors),
        }
        for measure, errors in {"full": full, "along": along}.items()
    }


def median_series(numbers: Floats) -> Floats:
    """Return medians over `SERIES_LENGTH` successive pieces of a series."""
    pieces = np.array_split(numbers, min(SERIES_LENGTH, len(numbers)))
    return np.array([median(finite(piece)) for piece in pieces])
