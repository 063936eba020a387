"""Check of IV-A: ẏ computed once per new frame, compared with ẏ computed once per tick.

Experiment `differentiation`. The camera delivers 60 frames/s to a 100 Hz loop. On one exploration,
the flow rule (28) updates Ĵ with ẏ from each method; the true ẏ and J are the reference.
"""

from collections.abc import Iterator, Mapping
from functools import partial

import numpy as np

from rcmservo.control.saturated_controller import scale_rows
from rcmservo.estimation.flow_rule import integrate_flow_rule
from rcmservo.figures.charts import Figure
from rcmservo.geometry.features import compute_feature_error, compute_features, shift_to_rcm
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.servo_loop import Tick, servo_ticks
from rcmservo.paper.lab.cameras import PINHOLE, true_parameters
from rcmservo.paper.lab.evaluation import laboratory
from rcmservo.paper.lab.paper_settings import (
    FAST_ARM,
    FLOW_ESTIMATOR,
    FLOW_EXPLORATION,
    POINT_NOISE_PX,
    remove_limits,
)
from rcmservo.paper.lab.streams import average_velocity
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, Task, TaskResult
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


def tasks(settings: Settings) -> list[Task]:
    return Task.per_seed("tour", partial(explore, settings=settings), range(settings.seeds))


def explore(settings: Settings, seed: int) -> TaskResult:
    """Return `FlowRuleTrial.results` for each method, on the same exploration."""
    rig, plant = laboratory(seed, PINHOLE, POINT_NOISE_PX)
    arm = rig.settings
    servo = Servo(
        arm.mechanism, arm.tool, FLOW_ESTIMATOR, exploration=ENDLESS_EXPLORATION, gate=FAST_ARM
    )
    here = Target(rig.truth.pixels(rig.scene.start), rig.scene.start)
    _a, o_c = true_parameters(rig)
    trials = {method: FlowRuleTrial(settings.gamma) for method in DIFFERENTIATION_METHODS}
    previous: Tick | None = None
    true_y_dot = np.zeros(3)
    for tick in servo_ticks(plant, servo, here, settings.touring):
        if np.isfinite(tick.observation.points).all():
            if previous is not None:
                ticks = previous, tick
                true_y_dot = differentiate(trials, rig, servo, ticks, o_c, true_y_dot)
            previous = tick
        if tick.time / 1e9 > settings.touring - JUDGED_S:
            J = rig.truth.jacobian(rig.truth.arm.q_true, o_c)
            for trial in trials.values():
                trial.judge(J)
    return {method: trial.results() for method, trial in trials.items()}


def differentiate(
    trials: Mapping[str, "FlowRuleTrial"],
    rig: Rig,
    servo: Servo,
    ticks: tuple[Tick, Tick],
    o_c: Floats,
    true_y_dot: Floats,
) -> Floats:
    """Differentiate y over two successive ticks by each method; return the true ẏ of the frame.

    `true_y_dot` is that of the frame before, which holds until the next frame.
    """
    position, (previous, tick) = servo.position_of_marker_1, ticks
    now, before = tick.observation, previous.observation
    dt = (tick.time - previous.time) * 1e-9
    y, y_before = (compute_features(shift_to_rcm(one.points, o_c)) for one in (now, before))
    delta_y = compute_feature_error(y, y_before)
    if now.frame > before.frame:
        J = rig.truth.jacobian(rig.truth.joints_at(now.exposure), o_c)
        true_y_dot = J @ average_velocity(rig, now.exposure, HALF_WINDOW_NS)
        exposed = position(now.q_exposure) - position(before.q_exposure)
        trials["frame"].add(exposed, delta_y, (now.exposure - before.exposure) * 1e-9, true_y_dot)
    delta_p = position(now.q) - position(before.q)
    trials["tick"].add(delta_p, delta_y, dt, true_y_dot)
    frame_period = 1.0 / rig.settings.timing.frame_rate
    trials["stale"].add(delta_p, delta_y / frame_period * dt, dt, true_y_dot)
    return true_y_dot


class FlowRuleTrial:
    """Flow rule (28) with ẏ from one method, and the errors of this ẏ and of Ĵ."""

    def __init__(self, gamma: float) -> None:
        self.gamma, self.J_hat = gamma, np.zeros((3, 3))
        self.product, self.square, self.squared_error = 0.0, 0.0, 0.0
        self.sizes, self.errors = list[float](), list[float]()

    def add(self, delta_p: Floats, delta_y: Floats, dt: float, true_y_dot: Floats) -> None:
        """Update Ĵ with Δp₁ (mm) and Δy over `dt` (s)."""
        self.J_hat = integrate_flow_rule(self.J_hat, delta_p, delta_y, dt, self.gamma)
        measured, true = scale_rows((delta_y / dt)[:, None]), scale_rows(true_y_dot[:, None])
        self.product += dt * float(np.sum(measured * true))
        self.square += dt * float(np.sum(true**2))
        self.squared_error += dt * float(np.sum((measured - true) ** 2))

    def judge(self, J: Floats) -> None:
        """Record the scale and the error of the present Ĵ relative to the true J (3, 3)."""
        J_hat, J = scale_rows(self.J_hat), scale_rows(J)
        self.sizes.append(float(np.sum(J_hat * J) / np.sum(J**2)))
        self.errors.append(float(np.linalg.norm(J_hat - J) / np.linalg.norm(J)))

    def results(self) -> TaskResult:
        """Return the accuracy of ẏ, and of the Ĵ of the flow rule that uses it.

        ``ratio`` is the least-squares factor of ẏ on the true ẏ and ``scatter`` the relative rms
        deviation. ``size`` of Ĵ along J and ``error`` ‖Ĵ − J‖/‖J‖ are medians of the scaled
        matrices.
        """
        scatter = float(np.sqrt(self.squared_error / self.square))
        size, error = median(self.sizes), median(self.errors)
        return dict(ratio=self.product / self.square, scatter=scatter, size=size, error=error)


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    seeds = range(settings.seeds)
    runs = results.per_seed("tour", seeds)
    frame, tick, stale = (
        {name: median(column(runs, method, name)) for name in RESULT_LABELS}
        for method in DIFFERENTIATION_METHODS
    )
    confirmed = abs(stale["ratio"] - 0.6) < 0.05
    yield Measurement("zeros-between", stale["ratio"], seeds, confirmed=confirmed, stale=stale)
    ratio = median(column(runs, "tick", "error") / column(runs, "frame", "error"))
    yield Measurement("by-tick", ratio, seeds, tick=tick, frame=frame)
    yield Measurement("by-frame", abs(frame["ratio"] - 1.0), seeds, frame=frame)


def draw(settings: Settings, results: Results) -> Iterator[PaperFigure]:
    seeds, names = range(settings.seeds), DIFFERENTIATION_METHODS
    runs = results.per_seed("tour", seeds)

    def list_values(name: str) -> list[Floats]:
        return [column(runs, method, name) for method in names]

    panels = mark_panels(RESULT_LABELS, list_values, names.values())
    yield PaperFigure("frames", seeds, Figure("Differentiation of y", panels, columns=2))
