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
from rcmservo.interfaces import Floats
from rcmservo.loop.run import Tick, run
from rcmservo.loop.teach import teach
from rcmservo.paper.lab.closed_loop import (
    FAST_FIT,
    FLOW_ESTIMATOR,
    FLOW_EXPLORATION,
    PAPER_PROJECTION_ESTIMATOR,
    PAPER_SCENES,
    PRINTED_LAW,
    TEACHING_FRAMES,
    make_servo,
    remove_limits,
)
from rcmservo.paper.lab.evaluation import laboratory
from rcmservo.paper.lab.random_observations import RandomObservations
from rcmservo.paper.plan import Settings, TaskResult
from rcmservo.paper.statistics import finite, median
from rcmservo.sim import Rig

Kind = Literal["servo", "tour"]

ESTIMATORS: Mapping[str, Estimator] = {
    "flow": FLOW_ESTIMATOR,
    "random": RandomObservations(),
    "given time": PAPER_PROJECTION_ESTIMATOR,
    "real time": RandomObservations(estimator_time=0.0),
    "fast": FAST_FIT,
    "whole": DltEstimator(),
}
ESTIMATOR_NAMES = {
    "flow": "flow, γ = 0.001",
    "random": "printed Γ, 10⁴ s per fit, random observations",
    "given time": "printed Γ, 10⁴ s per fit, chosen observations",
    "real time": "printed Γ, real time, random observations",
    "fast": "fast Γ, both markers",
    "whole": "whole projection (default)",
}
SHORT_NAMES = ["flow", "random", "chosen", "real time", "fast Γ", "whole"]
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


def stream(seed: int, noise: float, settings: Settings, kind: Kind) -> tuple[Rig, Stream]:
    """Return the samples of a servo with the fast fit, with true Jacobians and velocities."""
    rig, plant = laboratory(seed, PAPER_SCENES, noise)
    exploration = FLOW_EXPLORATION if kind == "servo" else remove_limits(FLOW_EXPLORATION)
    servo = make_servo(rig.settings, FAST_FIT, exploration, PRINTED_LAW)
    rig.move_to_target()
    target = teach(plant, TEACHING_FRAMES)
    rig.move_to_start()
    duration = settings.duration if kind == "servo" else settings.touring
    samples, rows, last = list[Sample](), list[tuple[float, int, Floats, Floats]](), -1
    for tick in run(plant, servo, target, duration):
        state, time = tick.state, tick.state.estimation.estimate.exposure
        if time == last:
            continue
        dt = (time - last) * 1e-9 if last >= 0 else 0.0
        last = time
        samples.append(
            Sample(state.p1, tick.observation.points, state.o_c, dt, tick.observation.sizes)
        )
        J = scale_rows(rig.truth.jacobian(rig.truth.joints_at(time), state.o_c))
        rows.append((tick.time / 1e9, _phase(tick, settings, kind), J, velocity(rig, time)))
    columns = (np.array(column) for column in zip(*rows, strict=True))
    return rig, Stream(samples, *columns)


def _phase(tick: Tick, settings: Settings, kind: Kind) -> int:
    if kind == "tour":
        return int(tick.time > settings.learning * 1e9)
    if not tick.state.explored:
        return 0
    return 1 if bool(np.any(np.abs(tick.state.delta) > PRINTED_LAW.bounds_array)) else 2


def velocity(rig: Rig, time: int, window: int = WINDOW_NS) -> Floats:
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


def jacobian_errors(J_hat: Floats, truth: Stream, least_speed: float) -> dict[str, Floats]:
    """Return two scaled errors (n,) of Ĵ (n, 3, 3): of the whole matrix, and along the motion.

    The latter is NaN where marker 1 moves by no more than `least_speed` (mm/s).
    """
    error = J_hat - truth.J
    full = np.linalg.norm(error, axis=(1, 2)) / np.linalg.norm(truth.J, axis=(1, 2))
    flow, missing = (
        np.linalg.norm((matrix @ truth.v[:, :, None])[:, :, 0], axis=1)
        for matrix in (truth.J, error)
    )
    moves = np.linalg.norm(truth.v, axis=1) > least_speed
    return {"full": full, "along": np.where(moves, missing / np.maximum(flow, 1e-12), np.nan)}


def summarise_error(error: Floats, phase: Floats, phases: int) -> TaskResult:
    """Return the median of an error (n,) in each phase, and a series of medians over time."""
    medians = np.array([median(finite(error[phase == i])) for i in range(phases)])
    return {"phases": medians, "series": median_series(error)}


def median_series(numbers: Floats) -> Floats:
    """Return medians over `SERIES_LENGTH` successive pieces of a series."""
    pieces = np.array_split(numbers, min(SERIES_LENGTH, len(numbers)))
    return np.array([median(finite(piece)) for piece in pieces])
