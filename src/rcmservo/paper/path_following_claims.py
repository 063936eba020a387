"""Comparison with [10]: the tool follows moving reference pixels, without calibration.

Experiment `path-following`. Marker 1 follows a circle in space. The reference is the image of the
circle in the true camera, as [10] computes it by a forward model; the servo receives only these
pixels. A controller without feed-forward follows at the speed v with an error of v/k, where k is
its gain.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from rcmservo.figures.charts import Curve, Figure, Panel, make_curve
from rcmservo.geometry.features import FEATURE_SCALE
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.operator import OperatorRequest
from rcmservo.loop.servo_loop import servo_ticks
from rcmservo.loop.tick import Tick
from rcmservo.paper.lab.closed_loop import make_servo
from rcmservo.paper.lab.evaluation import STRIDE_TICKS, laboratory
from rcmservo.paper.lab.methods import FLOW_RULE, RCMSERVO_METHODS, EstimatingMethod
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, Task, TaskResult, Texts
from rcmservo.paper.statistics import column, median, rms
from rcmservo.safety.state_machine import Phase, Request
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.servo import State
from rcmservo.sim import Rig, SceneSettings

FOLLOWING_METHODS: Mapping[str, EstimatingMethod] = {**RCMSERVO_METHODS, "flow": FLOW_RULE}
SCENES = SceneSettings(room=17.0)
PIXELS_ALONE = Thresholds(max_target_mismatch=np.inf)
"""Thresholds that do not slow the tool down although the reference has no joints."""
MAX_START_ERROR = 0.15
"""Scaled feature error below which the first point of a path counts as reached."""
END_TOLERANCE_S = 0.2
"""Time (s) before the end of a path at which it counts as completed: two samples."""
MAX_LAG_S, LAG_STEP_S = 2.0, 0.02
"""Upper bound and step (s) of the search for the lag behind the reference."""
MAX_LAG_RATIO = 1.5
"""Largest ratio of the rms error to v/k."""
MAX_STEADY_ERROR_MM = 0.3
"""Error (mm) without the lag above which the report explains it by the start of the path."""


def tasks(settings: Settings) -> list[Task]:
    work = partial(follow_in_all_scenes, settings=settings)
    return [Task(name, partial(work, method=name), settings.seeds) for name in FOLLOWING_METHODS]


def follow_in_all_scenes(settings: Settings, method: str) -> TaskResult:
    """Return the results of `follow` in each scene."""
    following_method = FOLLOWING_METHODS[method]
    return {"trials": [follow(settings, following_method, i) for i in range(settings.seeds)]}


class CirclePath:
    """Circular path of marker 1, oblique to the tool so that it needs yaw, pitch and insertion."""

    def __init__(self, rig: Rig, radius: float, period: float) -> None:
        self.rig, self.period = rig, period
        self.centre: Floats = rig.body.points(rig.scene.target)[0]
        n = self.centre / np.linalg.norm(self.centre)
        least_parallel_axis: Floats = np.eye(3)[np.argmin(np.abs(n))]
        across = np.cross(n, least_parallel_axis)
        across /= np.linalg.norm(across)
        along = (np.cross(n, across) + n) / np.sqrt(2.0)
        self.across, self.along = radius * across, radius * along

    def p1(self, time_s: float) -> Floats:
        """Return the reference (3,) of marker 1 in mm at `time_s`; times below 0 count as 0."""
        angle = 2.0 * np.pi * max(time_s, 0.0) / self.period
        return self.centre + np.cos(angle) * self.across + np.sin(angle) * self.along

    def target(self, time_s: float) -> Target:
        """Return the reference pixels at `time_s` as a target."""
        q = self.rig.settings.mechanism.joints(self.p1(time_s))
        return Target(self.rig.truth.pixels(q), np.full(3, np.nan))


class PathOperator:
    """Operator who moves the target along a path as soon as the tool is at its first point."""

    def __init__(self, path: CirclePath, tick_period_ns: int) -> None:
        self.path, self.tick_period_ns = path, tick_period_ns
        self.start_ns: int | None = None

    def __call__(self, tick: Tick) -> OperatorRequest:
        """Return the target of the next tick."""
        next_tick_ns = tick.observation.now + self.tick_period_ns
        if self.start_ns is None and is_at_start(tick.state):
            self.start_ns = next_tick_ns
        if self.start_ns is None:
            return Request.NONE
        return self.path.target(self.elapsed_s(next_tick_ns))

    def elapsed_s(self, now_ns: int) -> float:
        """Return the time (s) since the start of the path; 0 before."""
        return 0.0 if self.start_ns is None else (now_ns - self.start_ns) / 1e9


class PathSample(NamedTuple):
    """True state of the tool at one time on the path.

    Parameters
    ----------
    time_s : float
        Time since the start of the path.
    p1 : Floats
        True position (3,) of marker 1 in mm.
    m1 : Floats
        True pixels (2,) of marker 1.
    """

    time_s: float
    p1: Floats
    m1: Floats


def follow(settings: Settings, method: EstimatingMethod, seed: int) -> TaskResult:
    """Explore, servo to the first point of the path, then follow the moving reference pixels.

    Returns the seed, the cause if the path was not completed, and `path_errors` of a completed one.
    """
    rig, plant = laboratory(seed, SCENES, settings.noise)
    servo = make_servo(rig.settings, method.estimator, method.exploration, method.controller)
    servo = replace(servo, thresholds=PIXELS_ALONE)
    path = CirclePath(rig, settings.radius, settings.period)
    operator, samples = PathOperator(path, servo.period), list[PathSample]()
    max_duration_s = servo.exploration.max_time + settings.approach + settings.period
    ticks, cause = (
        servo_ticks(plant, servo, path.target(0.0), max_duration_s, operator=operator),
        "",
    )
    for k, tick in enumerate(ticks):
        time_s, cause = operator.elapsed_s(tick.observation.now), tick.state.cause.stop_sentence
        if time_s > settings.period:
            break
        if operator.start_ns is not None and k % STRIDE_TICKS == 0:
            q = rig.truth.arm.q_true
            samples.append(PathSample(time_s, rig.body.points(q)[0], rig.truth.pixels(q)[0]))
        if tick.state.phase in (Phase.PAUSED, Phase.FAULT):
            break
    if samples and samples[-1].time_s > settings.period - END_TOLERANCE_S:
        return {"seed": seed, "cause": "", **path_errors(path, samples)}
    place = "before its start" if operator.start_ns is None else "on the path"
    return {"seed": seed, "cause": cause or f"time ran out {place}"}


def is_at_start(state: State) -> bool:
    """Return True if the servo measures the tool at the first point of the path."""
    error = np.max(np.abs(state.delta) / FEATURE_SCALE)
    return state.phase is Phase.SERVO and bool(error < MAX_START_ERROR)


def path_errors(path: CirclePath, samples: list[PathSample]) -> TaskResult:
    """Return the errors (mm) of a completed path.

    ``lag`` (s) is the delay of the reference that minimises the rms error, ``left`` that minimum.
    """
    times_s, points, pixels = (np.array(values) for values in zip(*samples, strict=True))

    def errors_behind(lag_s: float) -> Floats:
        reference = np.array([path.p1(time_s - lag_s) for time_s in times_s])
        return np.linalg.norm(points - reference, axis=1)

    reference_pixels = np.array([path.target(time_s).points[0] for time_s in times_s])
    lags_s = np.arange(0.0, MAX_LAG_S, LAG_STEP_S)
    rms_by_lag = [rms(errors_behind(lag_s)) for lag_s in lags_s]
    errors_mm = errors_behind(0.0)
    return {
        "rms": rms(errors_mm),
        "max": errors_mm.max(),
        "pixels_rms": rms(np.linalg.norm(pixels - reference_pixels, axis=1)),
        "lag": lags_s[np.argmin(rms_by_lag)],
        "left": min(rms_by_lag),
        "times": times_s,
        "errors": errors_mm,
        "pixels": pixels,
        "reference": reference_pixels,
    }


def speed_on_circle(settings: Settings) -> float:
    """Return the speed v (mm/s) on the circle."""
    return 2.0 * np.pi * settings.radius / settings.period


def completed_trials(results: Results) -> dict[str, list[TaskResult]]:
    """Return the completed trials of each method that completed any."""
    trials = {name: results[name]["trials"] for name in FOLLOWING_METHODS}
    completed = {name: [t for t in trials[name] if not t["cause"]] for name in trials}
    return {name: completed[name] for name in completed if completed[name]}


def describe_failures(results: Results, method: str) -> str:
    """Return the numbers of paths that were not completed, by cause, as text."""
    trials = results[method]["trials"]
    causes = Counter(trial["cause"] for trial in trials if trial["cause"]).items()
    return "; ".join(f"{n} of {len(trials)} not completed: {cause}" for cause, n in causes)


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    seeds = range(settings.seeds)
    speed = speed_on_circle(settings)
    completed = completed_trials(results)
    failures = {name: describe_failures(results, name) for name in FOLLOWING_METHODS}
    gains = {name: method.controller.gain for name, method in FOLLOWING_METHODS.items()}
    cases = {name: (method.name,) for name, method in FOLLOWING_METHODS.items()}
    for name in FOLLOWING_METHODS:
        percentage = 100.0 * len(completed.get(name, [])) / settings.seeds
        texts = Texts(failures=failures[name], speed=speed)
        yield Measurement("gets-round", percentage, seeds, case=cases[name], **texts)
    for name, trials in completed.items():
        expected_mm, largest = speed / gains[name], column(trials, "max")
        error_mm, pixels = (median(column(trials, key)) for key in ("rms", "pixels_rms"))
        bound, texts = MAX_LAG_RATIO * expected_mm, Texts(failures=failures[name], lag=expected_mm)
        texts |= Texts(largest=median(largest), worst=largest.max(), pixels=pixels)
        yield Measurement(
            "lags-by-v-over-k", error_mm, seeds, bound=bound, case=cases[name], **texts
        )
    for name, trials in completed.items():
        error_mm = median(column(trials, "left"))
        start_mm = median([trial["errors"][0] for trial in trials])
        start = f"this includes the start, where the tool is {start_mm:.1f} mm from the reference"
        remarks = failures[name], start if error_mm > MAX_STEADY_ERROR_MM else ""
        texts = Texts(summary="; ".join(filter(None, remarks)), time_constant=1.0 / gains[name])
        lag_s = median(column(trials, "lag"))
        yield Measurement("keeps-beside", error_mm, seeds, case=cases[name], lag=lag_s, **texts)


def draw(settings: Settings, results: Results) -> Iterator[PaperFigure]:
    completed = completed_trials(results)
    path_curves, error_curves = list[Curve](), list[Curve]()
    for style, (name, trials) in enumerate(completed.items()):
        short, first = FOLLOWING_METHODS[name].short, trials[0]
        path_curves.append(make_pixel_curve(short, first["pixels"], style))
        shortest = min(len(trial["errors"]) for trial in trials)
        errors_mm = np.median([trial["errors"][:shortest] for trial in trials], axis=0)
        error_curves.append(make_curve(short, first["times"][:shortest], errors_mm, style))
    for first, *_ in list(completed.values())[:1]:
        path_curves.insert(0, make_pixel_curve("reference", first["reference"], -1))
    v = [value for curve in path_curves for value in curve.y if value is not None] or [0.0]
    v_limits = (max(v) + 3.0, min(v) - 3.0)
    gains = {method.controller.gain for method in FOLLOWING_METHODS.values()}
    levels = [(f"v/k, k = {gain:g}", speed_on_circle(settings) / gain) for gain in sorted(gains)]
    label = "$\\|p_1 - p_{ref}\\|$ [mm]"
    panels = [
        Panel("u [px]", "v [px], downwards", path_curves, y_limits=v_limits),
        Panel("time on the path [s]", label, error_curves, levels),
    ]
    scene = next((trial["seed"] for trials in completed.values() for trial in trials), "–")
    figure, texts = Figure("Following a path", panels, columns=2), {"scene": scene}
    yield PaperFigure("path", range(settings.seeds), figure, texts=texts)


def make_pixel_curve(label: str, pixels: Floats, style: int) -> Curve:
    """Return the path of pixels (n, 2) in the image."""
    return make_curve(label, pixels[:, 0], pixels[:, 1], style)
