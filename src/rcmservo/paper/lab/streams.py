"""One stream of samples for every estimator, so that all learn from the same motion and noise.

Two kinds of stream: a servo run with the printed law, which moves at about 1 px/s, and an
exploration that keeps moving at its speed.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from rcmservo.control.saturated_controller import scaled
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.estimation.dlt import DltEstimator
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.loop.run import Tick, run
from rcmservo.loop.teach import teach
from rcmservo.paper.lab.closed_loop import (
    FAST_FIT,
    FLOW,
    LONG,
    PAPER_SCENES,
    PRINTED,
    PRINTED_LAW,
    TEACHING_FRAMES,
    endless,
    servo_for,
)
from rcmservo.paper.lab.random_observations import RandomObservations
from rcmservo.paper.lab.witness import laboratory
from rcmservo.paper.plan import Found, Settings
from rcmservo.paper.statistics import finite, median
from rcmservo.sim import Rig

Kind = Literal["servo", "tour"]

ESTIMATORS: Mapping[str, Estimator] = {
    "flow": FLOW,
    "random": RandomObservations(),
    "given time": PRINTED,
    "real time": RandomObservations(estimator_time=0.0),
    "fast": FAST_FIT,
    "whole": DltEstimator(),
}
LABELS = {
    "flow": "flow, γ = 0.001",
    "random": "printed Γ, 10⁴ s a fit, random observations",
    "given time": "printed Γ, 10⁴ s a fit, chosen observations",
    "real time": "printed Γ, real time, random observations",
    "fast": "fast Γ, both markers (ours)",
    "whole": "the whole projection (our default)",
}
SHORT = ["flow", "random", "chosen", "real time", "fast Γ", "whole"]
NAMES = (
    "Random and chosen: the printed Γ, 10⁴ s a fit, on random observations and on those chosen by "
    "leverage; real time: the printed Γ on random ones in real time; fast Γ: ours, both "
    "markers; whole: our default, the whole projection fitted to all frames."
)
"""Meaning of the short names in the figures."""

POINTS = 300
"""Medians over time that a series has for its figure."""
WINDOW_NS = 20_000_000
"""ns before and after an exposure over which the true velocity is taken."""


class Stream(NamedTuple):
    """Observations of a servo, frame by frame, and the truth.

    Parameters
    ----------
    samples : list[Sample]
        One for each frame that the servo used, n of them.
    time : Floats
        (n,) s.
    phase : Floats
        (n,): exploring, saturated, at the end; or learning, touring.
    J : Floats
        (n, 3, 3), scaled.
    v : Floats
        (n, 3) mm/s of marker 1.
    """

    samples: list[Sample]
    time: Floats
    phase: Floats
    J: Floats
    v: Floats


def stream(seed: int, noise: float, settings: Settings, kind: Kind) -> tuple[Rig, Stream]:
    """Return the samples that a servo with the fast fit used, and the truth at each."""
    rig, plant = laboratory(seed, PAPER_SCENES, noise)
    exploration = LONG if kind == "servo" else endless(LONG)
    servo = servo_for(rig.settings, FAST_FIT, exploration, PRINTED_LAW)
    rig.move_to_target()
    target = teach(plant, TEACHING_FRAMES)
    rig.move_to_start()
    duration = settings.duration if kind == "servo" else settings.touring
    samples, rows, last = list[Sample](), list[tuple[float, int, Floats, Floats]](), -1
    for tick in run(plant, servo, target, duration):
        state, time = tick.state, tick.state.learnt.estimate.exposure
        if time == last:
            continue
        dt = (time - last) * 1e-9 if last >= 0 else 0.0
        last = time
        samples.append(Sample(state.p1, tick.seen.points, state.o_c, dt, tick.seen.sizes))
        J = scaled(rig.truth.jacobian(rig.truth.joints_at(time), state.o_c))
        rows.append((tick.time / 1e9, _phase(tick, settings, kind), J, velocity(rig, time)))
    columns = (np.array(column) for column in zip(*rows, strict=True))
    return rig, Stream(samples, *columns)


def _phase(tick: Tick, settings: Settings, kind: Kind) -> int:
    if kind == "tour":
        return int(tick.time > settings.learning * 1e9)
    if not tick.state.explored:
        return 0
    return 1 if bool(np.any(np.abs(tick.state.delta) > PRINTED_LAW.b)) else 2


def velocity(rig: Rig, time: int, window: int = WINDOW_NS) -> Floats:
    """Return the true velocity (3,) mm/s of marker 1 about a moment (ns), over ± `window` ns."""
    before, after = (
        rig.body.points(rig.truth.joints_at(time + side * window))[0] for side in (-1, 1)
    )
    return (after - before) / (2e-9 * window)


def estimated(estimator: Estimator, samples: Sequence[Sample], tool: Tool) -> tuple[Floats, Any]:
    """Return Ĵ (n, 3, 3) scaled after every sample, and the estimator's memory at the end."""
    memory = estimator.init()
    J_hat = np.empty((len(samples), 3, 3))
    for i, sample in enumerate(samples):
        memory = estimator.update(memory, tool, sample)
        J_hat[i] = scaled(estimator.jacobian(memory, tool, sample))
    return J_hat, memory


def errors_over(J_hat: Floats, seen: Stream, least_speed: float) -> dict[str, Floats]:
    """Return two scaled errors (n,) of Ĵ (n, 3, 3): of the whole matrix, and along the motion.

    The latter is NaN where marker 1 moves by no more than `least_speed` mm/s.
    """
    wrong = J_hat - seen.J
    full = np.linalg.norm(wrong, axis=(1, 2)) / np.linalg.norm(seen.J, axis=(1, 2))
    flow, missing = (
        np.linalg.norm((matrix @ seen.v[:, :, None])[:, :, 0], axis=1) for matrix in (seen.J, wrong)
    )
    moves = np.linalg.norm(seen.v, axis=1) > least_speed
    return {"full": full, "along": np.where(moves, missing / np.maximum(flow, 1e-12), np.nan)}


def in_short(error: Floats, phase: Floats, phases: int) -> Found:
    """Return the median of an error (n,) in every phase, and its course over time."""
    medians = np.array([median(finite(error[phase == i])) for i in range(phases)])
    return {"phases": medians, "series": over_time(error)}


def over_time(numbers: Floats) -> Floats:
    """Return POINTS medians of successive numbers."""
    pieces = np.array_split(numbers, min(POINTS, len(numbers)))
    return np.array([median(finite(piece)) for piece in pieces])
