"""One stream of samples through every estimator, so that all learn from the same motion and noise.

Two kinds of stream: a servo run with the printed law, which moves at about 1 px/s, and a tour that
keeps moving at exploration's speed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from rcmservo.experiments.harness.lab.closed_loop import (
    FAST_FIT,
    FLOW,
    LONG,
    PAPER_SCENES,
    PRINTED_FIT,
    PRINTED_LAW,
    SHOWN,
    for_ever,
    servo_for,
)
from rcmservo.experiments.harness.lab.random_observations import RandomObservations
from rcmservo.experiments.harness.lab.witness import laboratory
from rcmservo.interfaces import Floats
from rcmservo.loop.run import Tick, run
from rcmservo.loop.teach import teach
from rcmservo.method.controller import scaled
from rcmservo.method.estimators.base import Estimator, Sample
from rcmservo.method.estimators.dlt import DltEstimator
from rcmservo.method.exploration import Exploration
from rcmservo.method.tool import Tool
from rcmservo.servo.servo import State
from rcmservo.sim import Rig, SceneSettings

Kind = Literal["servo", "tour"]

ESTIMATORS: Mapping[str, Estimator] = {
    "flow": FLOW,
    "random": RandomObservations(),
    "given time": PRINTED_FIT,
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
"""What the short names in the figures mean."""

WINDOW = 20_000_000
"""ns before and after an exposure over which the true velocity is taken."""


@dataclass(frozen=True)
class StreamSettings:
    """What a servo does while its samples are taken."""

    duration: float = 120.0
    """s of a servo run."""
    touring: float = 40.0
    """s of a tour."""
    learning: float = 20.0
    """s at the start of a tour that are not judged."""
    scene: SceneSettings = PAPER_SCENES
    """What the scenes are drawn from."""
    exploration: Exploration = LONG
    """Of a servo run; a tour is the same without an end."""


@dataclass(frozen=True, eq=False)
class Stream:
    """What a servo saw, frame by frame, and the truth."""

    samples: list[Sample]
    """One for each frame that the servo learnt from, n of them."""
    time: Floats
    """s (n,)."""
    phase: Floats
    """(n,): exploring, saturated, at the end; or learning, touring."""
    J: Floats
    """Scaled (n, 3, 3)."""
    v: Floats
    """mm/s of marker 1, (n, 3)."""


def stream(seed: int, noise: float, settings: StreamSettings, kind: Kind) -> tuple[Rig, Stream]:
    """The samples that a servo with the fast fit learnt from, and the truth at each."""
    rig, plant = laboratory(seed, settings.scene, noise)
    servo = servo_for(rig.settings, FAST_FIT, _exploration(settings, kind), PRINTED_LAW)
    rig.show_target()
    target = teach(plant, SHOWN)
    rig.go_home()
    duration = settings.duration if kind == "servo" else settings.touring
    samples = list[Sample]()
    rows = list[tuple[float, int, Floats, Floats]]()
    last = -1
    for tick in run(plant, servo, target, duration):
        state = tick.state
        if state.learnt.estimate.exposure == last:
            continue
        dt = (state.learnt.estimate.exposure - last) * 1e-9 if last >= 0 else 0.0
        last = state.learnt.estimate.exposure
        sizes = tick.seen.sizes
        samples.append(Sample(state.p1, tick.seen.points, state.o_c, dt, sizes))
        rows.append((tick.time / 1e9, _phase(tick, settings, kind), *_truth(rig, state)))
    time, phases, Js, vs = (np.array(column) for column in zip(*rows, strict=True))
    return rig, Stream(samples, time, phases, Js, vs)


def _exploration(settings: StreamSettings, kind: Kind) -> Exploration:
    return settings.exploration if kind == "servo" else for_ever(settings.exploration)


def _truth(rig: Rig, state: State) -> tuple[Floats, Floats]:
    """Scaled J (3, 3), and v (3,) mm/s of marker 1, at the exposure."""
    J = rig.truth.jacobian(rig.truth.joints_at(state.learnt.estimate.exposure), state.o_c)
    return scaled(J), velocity(rig, state.learnt.estimate.exposure)


def _phase(tick: Tick, settings: StreamSettings, kind: Kind) -> int:
    if kind == "tour":
        return int(tick.time > settings.learning * 1e9)
    if not tick.state.explored:
        return 0
    return 1 if bool(np.any(np.abs(tick.state.delta) > PRINTED_LAW.b)) else 2


def velocity(rig: Rig, time: int) -> Floats:
    """True velocity (3,) mm/s of marker 1 about a moment (ns)."""
    before, after = (
        rig.body.points(rig.truth.joints_at(time + side * WINDOW))[0] for side in (-1, 1)
    )
    return (after - before) / (2e-9 * WINDOW)


def learnt(estimator: Estimator, samples: Sequence[Sample], tool: Tool) -> tuple[Floats, Any]:
    """Ĵ (n, 3, 3) scaled after every sample, and the estimator's memory at the end."""
    memory = estimator.init()
    J_hat = np.empty((len(samples), 3, 3))
    for i, sample in enumerate(samples):
        memory = estimator.update(memory, tool, sample)
        J_hat[i] = scaled(estimator.jacobian(memory, tool, sample))
    return J_hat, memory
