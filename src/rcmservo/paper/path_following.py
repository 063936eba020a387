"""Experiment `path-following`: moving reference pixels as in [10], without calibration.

Marker 1 follows a circle in space. The reference is the image of the circle in the true camera, as
[10] computes it by a forward model; the servo receives only these pixels. A law without
feed-forward has a following error of v/k.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from functools import partial

import numpy as np

from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.figures.charts import Curve, Figure, Panel, make_curve
from rcmservo.geometry.features import FEATURE_SCALE
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.operator import OperatorRequest
from rcmservo.loop.run import run
from rcmservo.loop.tick import Tick
from rcmservo.paper.lab.closed_loop import FAST_LAW, make_servo
from rcmservo.paper.lab.evaluation import STRIDE_TICKS, laboratory
from rcmservo.paper.lab.methods import FLOW_RULE, RCMSERVO_METHODS, EstimatingMethod
from rcmservo.paper.plan import Measurement, ReportFigure, Results, Settings, Task, TaskResult
from rcmservo.paper.statistics import column, median, rms
from rcmservo.safety.state_machine import Phase, Request
from rcmservo.servo.servo import State
from rcmservo.sim import Rig, SceneSettings

FOLLOWING_METHODS: Mapping[str, EstimatingMethod] = {**RCMSERVO_METHODS, "flow": FLOW_RULE}
SCENES = SceneSettings(room=17.0)
AT_START = 0.15
"""Scaled feature error below which the first point of a path counts as reached."""
NEAR_END_S = 0.2
"""Time (s) before the end of a path at which it counts as completed: two samples."""
MAX_LAG_S = 2.0
"""Upper bound (s) of the search for the lag behind the reference."""


def fixed_settings() -> dict[str, object]:
    return {"methods": FOLLOWING_METHODS, "controller": FAST_LAW, "scene": SCENES}


def tasks(settings: Settings) -> list[Task]:
    return [
        Task(method, partial(follow_all, settings=settings, method=method), settings.seeds)
        for method in FOLLOWING_METHODS
    ]


def law(method: EstimatingMethod) -> SaturatedController:
    """Return the controller of a method, by default the common one."""
    return method.controller or FAST_LAW


def follow_all(settings: Settings, method: str) -> TaskResult:
    """Return the results of `follow` in each scene."""
    return {
        "trials": [follow(settings, FOLLOWING_METHODS[method], i) for i in range(settings.seeds)]
    }


class Circle:
    """Circular path of marker 1, oblique to the tool so that it needs yaw, pitch and insertion."""

    def __init__(self, rig: Rig, radius: float, period: float) -> None:
        self.rig, self.period = rig, period
        self.middle: Floats = rig.body.points(rig.scene.target)[0]
        n = self.middle / np.linalg.norm(self.middle)
        axis: Floats = np.eye(3)[np.argmin(np.abs(n))]
        across = np.cross(n, axis)
        across /= np.linalg.norm(across)
        along = (np.cross(n, across) + n) / np.sqrt(2.0)
        self.across, self.along = radius * across, radius * along

    def p1(self, time: float) -> Floats:
        """Return the reference (3,) of marker 1 in mm at `time` (s); times below 0 count as 0."""
        angle = 2.0 * np.pi * max(time, 0.0) / self.period
        return self.middle + np.cos(angle) * self.across + np.sin(angle) * self.along

    def target(self, time: float) -> Target:
        """Return the reference pixels at `time` (s) as a target."""
        q = self.rig.settings.mechanism.joints(self.p1(time))
        return Target(self.rig.truth.pixels(q), np.full(3, np.nan))


class Guide:
    """Operator who moves the target along a path as soon as the tool is at its first point."""

    def __init__(self, path: Circle, period: int) -> None:
        self.path, self.period = path, period
        self.began: int | None = None

    def __call__(self, tick: Tick) -> OperatorRequest:
        """Return the target of the next tick."""
        due = tick.observation.now + self.period
        if self.began is None and at_start(tick.state):
            self.began = due
        return Request.NONE if self.began is None else self.path.target(self.elapsed(due))

    def elapsed(self, now: int) -> float:
        """Return the time (s) since the start of the path; 0 before."""
        return 0.0 if self.began is None else (now - self.began) / 1e9


def follow(settings: Settings, method: EstimatingMethod, seed: int) -> TaskResult:
    """Explore, servo to the first point of the path, then follow the moving reference pixels.

    Returns the seed, the cause if the path was not completed, and `errors_on` a completed path.
    """
    rig, plant = laboratory(seed, SCENES, settings.noise)
    servo = make_servo(rig.settings, method.estimator, method.exploration, law(method))
    path = Circle(rig, settings.radius, settings.period)
    guide, samples = Guide(path, servo.period), list[tuple[float, Floats, Floats]]()
    longest = servo.exploration.max_time + settings.approach + settings.period
    ticks, cause = run(plant, servo, path.target(0.0), longest, operator=guide), ""
    for k, tick in enumerate(ticks):
        time, cause = guide.elapsed(tick.observation.now), tick.state.cause.stop_sentence
        if time > settings.period:
            break
        if guide.began is not None and k % STRIDE_TICKS == 0:
            q = rig.arm.q_true
            samples.append((time, rig.body.points(q)[0], rig.truth.pixels(q)[0]))
        if tick.state.phase in (Phase.PAUSED, Phase.FAULT):
            break
    if samples and samples[-1][0] > settings.period - NEAR_END_S:
        return {"seed": seed, "cause": "", **errors_on(path, samples)}
    where = "before its start" if guide.began is None else "on the path"
    return {"seed": seed, "cause": cause or f"time ran out {where}"}


def at_start(state: State) -> bool:
    """Return True if the servo measures the tool at the first point of the path."""
    return state.phase is Phase.SERVO and bool(
        np.max(np.abs(state.delta) / FEATURE_SCALE) < AT_START
    )


def errors_on(path: Circle, samples: list[tuple[float, Floats, Floats]]) -> TaskResult:
    """Return the errors (mm) of a completed path.

    ``lag`` (s) is the delay of the reference that minimises the rms error, ``left`` that minimum.
    The samples are time (s), true p₁ (3,) in mm, and true m₁ (2,) in px.
    """
    times, points, pixels = (np.array(values) for values in zip(*samples, strict=True))

    def behind(lag: float) -> Floats:
        reference = np.array([path.p1(time - lag) for time in times])
        return np.linalg.norm(points - reference, axis=1)

    reference = np.array([path.target(time).points[0] for time in times])
    lags = np.arange(0.0, MAX_LAG_S, 0.02)
    left = [rms(behind(lag)) for lag in lags]
    errors = behind(0.0)
    return {
        "rms": rms(errors),
        "max": errors.max(),
        "pixels_rms": rms(np.linalg.norm(pixels - reference, axis=1)),
        "lag": lags[np.argmin(left)],
        "left": min(left),
        "times": times,
        "errors": errors,
        "pixels": pixels,
        "reference": reference,
    }


def speed(settings: Settings) -> float:
    """Return the speed v (mm/s) on the circle."""
    return 2.0 * np.pi * settings.radius / settings.period


def completed(results: Results, method: str) -> list[TaskResult]:
    return [trial for trial in results[method]["trials"] if not trial["cause"]]


def failures(results: Results, method: str) -> str:
    trials = results[method]["trials"]
    causes = Counter(trial["cause"] for trial in trials if trial["cause"])
    total = len(trials)
    return "; ".join(f"{n} of {total} not completed: {cause}" for cause, n in causes.items())


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    seeds, v = range(settings.seeds), speed(settings)
    for name, method in FOLLOWING_METHODS.items():
        value = 100.0 * len(completed(results, name)) / settings.seeds
        words = failures(results, name)
        yield Measurement("gets-round", value, seeds, case=(method.name,), failures=words, speed=v)
    done = {name: found for name in FOLLOWING_METHODS if (found := completed(results, name))}
    for name, found in done.items():
        lag, worst = v / law(FOLLOWING_METHODS[name]).gain, column(found, "max")
        yield Measurement(
            "lags-by-v-over-k",
            median(column(found, "rms")),
            seeds,
            bound=1.5 * lag,
            case=(FOLLOWING_METHODS[name].name,),
            failures=failures(results, name),
            lag=lag,
            largest=median(worst),
            worst=worst.max(),
            pixels=median(column(found, "pixels_rms")),
        )
    for name, found in done.items():
        left = median(column(found, "left"))
        start = median([one["errors"][0] for one in found])
        late = f"this includes the start, where the tool is {start:.1f} mm from the reference"
        remark = "; ".join(filter(None, (failures(results, name), late if left > 0.3 else "")))
        yield Measurement(
            "keeps-beside",
            left,
            seeds,
            case=(FOLLOWING_METHODS[name].name,),
            words=remark,
            lag=median(column(found, "lag")),
            time_constant=1.0 / law(FOLLOWING_METHODS[name]).gain,
        )


def draw(settings: Settings, results: Results) -> Iterator[ReportFigure]:
    done = {name: found for name in FOLLOWING_METHODS if (found := completed(results, name))}
    pictures = [
        make_curve(
            FOLLOWING_METHODS[name].short, found[0]["pixels"][:, 0], found[0]["pixels"][:, 1], style
        )
        for style, (name, found) in enumerate(done.items())
    ]
    for found in list(done.values())[:1]:
        u, v = found[0]["reference"].T
        pictures.insert(0, make_curve("reference", u, v, -1))
    rows = [value for one in pictures for value in one.y if value is not None] or [0.0]
    errors = list[Curve]()
    for style, (name, found) in enumerate(done.items()):
        shortest = min(len(one["errors"]) for one in found)
        middle = np.median([one["errors"][:shortest] for one in found], axis=0)
        errors.append(
            make_curve(FOLLOWING_METHODS[name].short, found[0]["times"][:shortest], middle, style)
        )
    lags = {
        gain: speed(settings) / gain
        for gain in (law(one).gain for one in FOLLOWING_METHODS.values())
    }
    panels = [
        Panel("u [px]", "v [px], downwards", pictures, y_limits=(max(rows) + 3.0, min(rows) - 3.0)),
        Panel(
            "time on the path [s]",
            "$\\|p_1 - p_{ref}\\|$ [mm]",
            errors,
            levels=[(f"v/k, k = {gain:g}", lag) for gain, lag in lags.items()],
        ),
    ]
    first = next((one["seed"] for found in done.values() for one in found), "–")
    figure = Figure("Following a path", panels, columns=2)
    yield ReportFigure("path", range(settings.seeds), figure, words={"scene": first})
