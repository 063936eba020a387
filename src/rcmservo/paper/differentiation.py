"""Experiment `differentiation`: ẏ once per new frame, compared with ẏ once per tick.

The camera delivers 60 frames/s to a 100 Hz loop. On one exploration, the flow rule (28) updates Ĵ
with ẏ from each method; the true ẏ and J are the reference.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

from rcmservo.control.saturated_controller import scale_rows
from rcmservo.estimation.flow_rule import integrate_flow_rule
from rcmservo.figures.charts import Figure
from rcmservo.geometry.features import compute_feature_error, compute_features, shift_to_rcm
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.run import Tick, run
from rcmservo.paper.lab.cameras import PINHOLE, true_parameters
from rcmservo.paper.lab.closed_loop import (
    FAST_ARM,
    FLOW_ESTIMATOR,
    FLOW_EXPLORATION,
    POINT_NOISE_PX,
    remove_limits,
)
from rcmservo.paper.lab.evaluation import laboratory
from rcmservo.paper.lab.streams import velocity
from rcmservo.paper.plan import Measurement, ReportFigure, Results, Settings, Task, TaskResult
from rcmservo.paper.statistics import column, mark_panels, median
from rcmservo.servo.servo import Servo
from rcmservo.sim import Rig

DIFFERENTIATION_METHODS = {"frame": "by frame", "tick": "by tick", "stale": "zeros between"}
"""Methods to differentiate y: once per new frame, between exposures; once per tick, over the tick's
interval, zero for a repeated frame; once per tick, over the frame interval, zero for a repeated
frame."""
RESULT_LABELS = {
    "ratio": "scale of $\\dot{y}$ over the true [1]",
    "scatter": "scatter of $\\dot{y}$ over the true [1]",
    "size": "scale of $\\hat{J}$ along J [1]",
    "error": "$\\|\\hat{J} - J\\| / \\|J\\|$, scaled [1]",
}
ENDLESS_EXPLORATION = remove_limits(FLOW_EXPLORATION)
JUDGED_S = 5.0
"""Time (s) at the end over which the error of Ĵ is averaged, because the error of a flow rule
oscillates with each round."""
HALF_WINDOW_NS = 5_000_000
"""Half of the interval (ns) for the true ẏ."""


def fixed_settings() -> dict[str, object]:
    return {
        "estimator": FLOW_ESTIMATOR,
        "exploration": ENDLESS_EXPLORATION,
        "scene": PINHOLE,
        "noise": POINT_NOISE_PX,
    }


def tasks(settings: Settings) -> list[Task]:
    return Task.per_seed("tour", partial(tour, settings=settings), range(settings.seeds))


def tour(settings: Settings, seed: int) -> TaskResult:
    """Return the accuracy of ẏ by each method, and of the Ĵ of the flow rule that uses it.

    ``ratio`` is the least-squares factor of ẏ on the true ẏ and ``scatter`` the relative rms
    deviation. ``size`` of Ĵ along J and ``error`` ‖Ĵ − J‖/‖J‖ are medians of the scaled matrices.
    """
    rig, plant = laboratory(seed, PINHOLE, POINT_NOISE_PX)
    known = rig.settings
    servo = Servo(
        known.mechanism,
        known.tool,
        estimator=FLOW_ESTIMATOR,
        exploration=ENDLESS_EXPLORATION,
        gate=FAST_ARM,
    )
    here = Target(rig.truth.pixels(rig.scene.start), rig.scene.start)
    _a, o_c = true_parameters(rig)
    methods = {name: Differentiated(settings.gamma) for name in DIFFERENTIATION_METHODS}
    last: Tick | None = None
    true = np.zeros(3)
    for tick in run(plant, servo, here, settings.touring):
        if np.isfinite(tick.observation.points).all():
            if last is not None:
                true = _take(methods, rig, servo, (last, tick), o_c, true)
            last = tick
        if tick.time / 1e9 > settings.touring - JUDGED_S:
            J = rig.truth.jacobian(rig.arm.q_true, o_c)
            for one in methods.values():
                one.judge(J)
    return {name: one.found() for name, one in methods.items()}


def _take(
    methods: dict[str, "Differentiated"],
    rig: Rig,
    servo: Servo,
    ticks: tuple[Tick, Tick],
    o_c: Floats,
    true: Floats,
) -> Floats:
    """Differentiate y over two successive ticks by each method; return the true ẏ of the frame."""
    last, tick = ticks
    marker, seen, before = servo.position_of_marker_1, tick.observation, last.observation
    tau = (tick.time - last.time) * 1e-9
    y, y_before = (compute_features(shift_to_rcm(one.points, o_c)) for one in (seen, before))
    delta_y = compute_feature_error(y, y_before)
    if seen.frame > before.frame:
        J = rig.truth.jacobian(rig.truth.joints_at(seen.exposure), o_c)
        true = J @ velocity(rig, seen.exposure, HALF_WINDOW_NS)
        exposed = marker(seen.q_exposure) - marker(before.q_exposure)
        methods["frame"].add(exposed, delta_y, (seen.exposure - before.exposure) * 1e-9, true)
    moved = marker(seen.q) - marker(before.q)
    methods["tick"].add(moved, delta_y, tau, true)
    period = 1.0 / rig.settings.timing.frame_rate
    methods["stale"].add(moved, delta_y / period * tau, tau, true)
    return true


class Differentiated:
    """Flow rule (28) with ẏ from one method, and the errors of this ẏ and of Ĵ."""

    def __init__(self, gamma: float) -> None:
        self.gamma, self.J_hat = gamma, np.zeros((3, 3))
        self.product, self.square, self.missed = 0.0, 0.0, 0.0
        self.sizes: list[float] = []
        self.errors: list[float] = []

    def add(self, delta_p: Floats, delta_y: Floats, dt: float, true: Floats) -> None:
        """Update Ĵ with Δp₁ (mm) and Δy over `dt` (s); `true` (3,) is the true ẏ."""
        self.J_hat = integrate_flow_rule(self.J_hat, delta_p, delta_y, dt, self.gamma)
        measured, expected = scale_rows((delta_y / dt)[:, None]), scale_rows(true[:, None])
        self.product += dt * float(np.sum(measured * expected))
        self.square += dt * float(np.sum(expected**2))
        self.missed += dt * float(np.sum((measured - expected) ** 2))

    def judge(self, J: Floats) -> None:
        """Record the scale and the error of the present Ĵ relative to the true J (3, 3)."""
        J_hat, J = scale_rows(self.J_hat), scale_rows(J)
        self.sizes.append(float(np.sum(J_hat * J) / np.sum(J**2)))
        self.errors.append(float(np.linalg.norm(J_hat - J) / np.linalg.norm(J)))

    def found(self) -> TaskResult:
        return {
            "ratio": self.product / self.square,
            "scatter": float(np.sqrt(self.missed / self.square)),
            "size": median(self.sizes),
            "error": median(self.errors),
        }


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    seeds = range(settings.seeds)
    tours = results.per_seed("tour", seeds)
    middle = {
        m: {key: median(column(tours, m, key)) for key in RESULT_LABELS}
        for m in DIFFERENTIATION_METHODS
    }
    frame, tick, stale = middle.values()
    confirmed = abs(stale["ratio"] - 0.6) < 0.05
    yield Measurement("zeros-between", stale["ratio"], seeds, confirmed=confirmed, stale=stale)
    ratio = median(column(tours, "tick", "error") / column(tours, "frame", "error"))
    yield Measurement("by-tick", ratio, seeds, tick=tick, frame=frame)
    yield Measurement("by-frame", abs(frame["ratio"] - 1.0), seeds, frame=frame)


def draw(settings: Settings, results: Results) -> Iterator[ReportFigure]:
    seeds = range(settings.seeds)
    tours = results.per_seed("tour", seeds)
    panels = mark_panels(
        RESULT_LABELS,
        lambda key: [column(tours, method, key) for method in DIFFERENTIATION_METHODS],
        DIFFERENTIATION_METHODS.values(),
    )
    yield ReportFigure("frames", seeds, Figure("Differentiation of y", panels, columns=2))
