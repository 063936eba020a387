"""The paper's methods beside those that it positions itself against, in the same scenes with the same noise.

Four kinds that need no calibration: our projection-based default, the paper's two estimators with the printed gains,
and Broyden's update [15]-[17]. Two that are handed one, exact or wrong: the traditional image-based law [12] and
pose-based control [20]. And following a path given as moving reference pixels, as in [10].

All start at the same joints, are shown the same target and have the same time after their exploration, if they need
one. Whether a run has settled is judged on the true features without noise, about the true imaged RCM: single frames
with 0.3 px of noise leave a tolerance of 0.5° by chance, and pose-based control has no features of its own.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.charts import Curve, Figure, Panel, curve
from rcmservo.clock import ticks
from rcmservo.controller import SaturatedController
from rcmservo.estimators.base import Estimator
from rcmservo.estimators.broyden import BroydenEstimator
from rcmservo.estimators.projection import ProjectionEstimator
from rcmservo.experiments.calibrated import (
    Calibrated,
    Calibration,
    Miscalibration,
    PoseLaw,
    exact,
    pose_based,
    rolled,
    wrong,
)
from rcmservo.experiments.claims import Chapter, Claim, Experiment, Results, Shown, Task, median, rms
from rcmservo.experiments.closed_loop import FLOW, LONG, PRINTED_FIT, WIDE, servo_for
from rcmservo.exploration import Exploration
from rcmservo.features import SCALE, about, difference, features
from rcmservo.loop import Plant, Tick, run, teach
from rcmservo.outcome import LAST, SAME_POSE, TOLERANCE
from rcmservo.plant import Floats, Target
from rcmservo.servo import Cause, Phase, Servo, State
from rcmservo.sim import Rig, RigSettings, SceneSettings
from rcmservo.sim.optics import Optics
from rcmservo.tracking import PointMarkers

LINES_ONLY = Exploration(tolerance=1e3)
"""The default tour, of which a calibrated law needs nothing but the lines for o_c: it trusts its Ĵ."""

UNCALIBRATED: Mapping[str, tuple[Estimator, Exploration]] = {
    "ours": (ProjectionEstimator(), Exploration()),
    "printed": (PRINTED_FIT, WIDE),
    "flow": (FLOW, LONG),
    "broyden": (BroydenEstimator(), Exploration()),
    "broyden-1mm": (BroydenEstimator(min_step=1.0), Exploration()),
}
CALIBRATED = ("image-exact", "image-wrong", "image-rolled", "pose-exact", "pose-wrong")
METHODS = (*UNCALIBRATED, *CALIBRATED)

NAMES = {
    "ours": "our projection-based default",
    "printed": "the paper's projection rule (21), 10⁴ s of its own time a fit",
    "flow": "the paper's flow rule (28), γ = 0.001",
    "broyden": f"Broyden's update on displacements of {BroydenEstimator().min_step:g} mm (our default)",
    "broyden-1mm": "Broyden's update on displacements of 1 mm",
    "image-exact": "the image-based law with an exact calibration",
    "image-wrong": "the image-based law with a wrong calibration",
    "image-rolled": "the image-based law with a calibration from before the camera was rolled",
    "pose-exact": "pose-based control with an exact calibration",
    "pose-wrong": "pose-based control with a wrong calibration",
}
SHORT = {
    "ours": "ours",
    "printed": "printed Γ",
    "flow": "flow rule",
    "broyden": "Broyden",
    "broyden-1mm": "Broyden, 1 mm",
    "image-exact": "image, exact C",
    "image-wrong": "image, wrong C",
    "image-rolled": "image, rolled",
    "pose-exact": "pose, exact C",
    "pose-wrong": "pose, wrong C",
}
WHERE = {
    "ours": "(21), fast Γ",
    "printed": "(21)",
    "flow": "(28)",
    "broyden": "III-C, [15]-[17]",
    "broyden-1mm": "III-C, [15]-[17]",
    "image-exact": "Remark 2, [12]",
    "image-wrong": "Remark 2, [12]",
    "image-rolled": "Remark 2, [12]",
    "pose-exact": "IV-C, [20]",
    "pose-wrong": "IV-C, [20]",
}

EVERY = 10
"""Ticks between two looks at the truth."""

AT_END = 5.0
"""s at the end of a run over which its pose error is taken: noise makes the tool wander for a second at a time."""

AT_START = 0.15
"""Scaled feature error at which the first point of a path counts as reached."""

LONGEST_LAG = 2.0
"""s up to which the lag behind a path is looked for."""


@dataclass(frozen=True)
class Settings:
    """``duration`` s after the exploration; ``noise`` px; ``roll`` rad of the camera after it was calibrated.

    A path is a circle of ``radius`` mm about the target, gone round once in ``period`` s.
    """

    seeds: tuple[int, ...] = tuple(range(20))
    path_seeds: tuple[int, ...] = tuple(range(10))
    scene: SceneSettings = field(default_factory=lambda: SceneSettings(room=17.0))
    noise: float = 0.3
    duration: float = 20.0
    controller: SaturatedController = field(default_factory=SaturatedController)
    pose_law: PoseLaw = field(default_factory=PoseLaw)
    miscalibration: Miscalibration = field(default_factory=Miscalibration)
    roll: float = float(np.radians(90.0))
    radius: float = 10.0
    period: float = 30.0


def tasks(settings: Settings) -> list[Task]:
    regulation = [
        Task(method, regulate, {"settings": settings, "method": method}, cost=0.7 * len(settings.seeds))
        for method in METHODS
    ]
    paths = [
        Task(f"path-{method}", follow_paths, {"settings": settings, "method": method}, len(settings.path_seeds))
        for method in PATHS
    ]
    return regulation + paths


def regulate(folder: Path, settings: Settings, method: str) -> dict[str, Any]:
    """One method in every scene."""
    del folder
    return {"trials": [attempt(settings, method, seed) for seed in settings.seeds]}


def attempt(settings: Settings, method: str, seed: int) -> dict[str, Any]:
    """One method in one scene, and what the truth says of it."""
    rig, plant = laboratory(settings, seed)
    rig.show_target()
    target = teach(plant)
    rig.go_home()
    watch = Watch(rig)
    if method in UNCALIBRATED:
        estimator, exploration = UNCALIBRATED[method]
        servo_to(plant, servo_for(rig, estimator, exploration, settings.controller), target, settings.duration, watch)
        return watch.verdict(seed)
    kind, quality = method.split("-")
    given = calibration(rig.scene.optics, settings, quality, seed)
    servo = servo_for(rig, Calibrated(given), LINES_ONLY, settings.controller)
    if kind == "image":
        servo_to(plant, servo, target, settings.duration, watch)
    else:
        for k, time in enumerate(pose_based(plant, servo, given, settings.pose_law, target, settings.duration)):
            watch.look(k, time)
    return watch.verdict(seed)


def calibration(optics: Optics, settings: Settings, quality: str, seed: int) -> Calibration:
    """What a person hands over: exact, wrong in directions drawn from the seed, or from before a roll of the camera."""
    match quality:
        case "exact":
            return exact(optics)
        case "wrong":
            return wrong(optics, settings.miscalibration, np.random.default_rng([seed, 1]))
        case _:
            return rolled(optics, settings.roll)


def laboratory(settings: Settings, seed: int) -> tuple[Rig, Plant]:
    """A scene, and its plant with the camera that delivers points."""
    rig = Rig(seed, RigSettings(point_noise=settings.noise, scene=settings.scene), pictures=False)
    return rig, Plant(rig.mechanism, rig.camera, PointMarkers(), rig.clock)


def servo_to(plant: Plant, servo: Servo, target: Target, duration: float, watch: "Watch") -> None:
    """Explore, then servo for `duration` s."""

    def over(tick: Tick) -> bool:
        return watch.explored_at is not None and tick.time / 1e9 >= watch.explored_at + duration

    for k, tick in enumerate(run(plant, servo, target, servo.exploration.max_time + duration, done=over)):
        watch.look(k, tick.time / 1e9, tick.state, tick.seen.q_exposure)


class Watch:
    """The truth of a run to the scene's target, looked at EVERY ticks."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._y_d, self._p_d = self._features(rig.scene.target), rig.body.points(rig.scene.target)[1]
        self._times: list[float] = []
        self._errors: list[Floats] = []
        self._poses: list[float] = []
        self._jacobians: list[float] = []
        self._cause = Cause.NONE
        self.explored_at: float | None = None

    def _features(self, q: Floats) -> Floats:
        return features(about(self._rig.truth.pixels(q), self._rig.truth.imaged_rcm()))

    def look(self, k: int, time: float, state: State | None = None, q_exposure: Floats | None = None) -> None:
        """Take note of tick k at `time` s; pose-based control has no servo `state`."""
        if state is not None:
            self._cause = state.cause
            if state.explored and self.explored_at is None:
                self.explored_at = time
        if k % EVERY:
            return
        q = self._rig.clock.joints_at(self._rig.clock.now())
        self._times.append(time)
        self._errors.append(difference(self._features(q), self._y_d))
        self._poses.append(float(np.linalg.norm(self._rig.body.points(q)[1] - self._p_d)))
        if state is not None and state.explored and q_exposure is not None:
            self._jacobians.append(self._rig.truth.jacobian_error(state.J_hat, q_exposure, state.o_c))

    def verdict(self, seed: int) -> dict[str, Any]:
        """Plain numbers: ``settle_time`` s and ``explored_at`` s from the first tick or None, ``pose`` mm the root mean
        square of ‖p₂ − p_d‖ over AT_END s, ``jacobian`` the median error of Ĵ after the exploration.

        A run that was ended early by a cause stays where it ended.
        """
        last = np.array(self._times) > self._times[-1] - AT_END
        settle_time = self._settle_time()
        pose = rms(np.array(self._poses)[last]) if self._cause is Cause.NONE else self._poses[-1]
        why = self._why_not(settle_time, pose)
        return {
            "seed": seed,
            "why_not": why,
            "settle_time": None if why else settle_time,
            "explored_at": self.explored_at,
            "pose": pose,
            "jacobian": median(self._jacobians) if self._jacobians else None,
            "step": self._times[1],
            "poses": [round(pose, 5) for pose in self._poses],
        }

    def _settle_time(self) -> float | None:
        """When the true features last came within the tolerance, to stay for a second or more; None if they did not."""
        good = [bool(np.all(np.abs(error) < TOLERANCE)) for error in self._errors]
        since = len(good) - good[::-1].index(False) if False in good else 0
        stayed = since < len(good) and self._times[-1] - self._times[since] >= LAST - 1e-6
        return self._times[since] if stayed else None

    def _why_not(self, settle_time: float | None, pose: float) -> str:
        if self._cause is not Cause.NONE:
            return self._cause.value
        if settle_time is None:
            return "time ran out before the true features had settled"
        return "the features agree in another pose" if pose > SAME_POSE else ""


# Following a path, as in [10].

PATHS = ("ours", "flow")


@dataclass(frozen=True, eq=False)
class Circle:
    """A path of marker 1 in space, oblique to the tool, so that it asks for yaw, pitch and insertion.

    ``middle`` (3,) mm is p₁ at the target; ``across`` and ``along`` (3,) mm are two radii at right angles.
    """

    middle: Floats
    across: Floats
    along: Floats
    period: float

    def p1(self, time: float) -> Floats:
        """Where marker 1 should be `time` s after the start, (3,) mm; before it, at the first point."""
        angle = 2.0 * np.pi * max(time, 0.0) / self.period
        return self.middle + np.cos(angle) * self.across + np.sin(angle) * self.along


def circle(rig: Rig, settings: Settings) -> Circle:
    """The circle about the scene's target."""
    middle = rig.body.points(rig.scene.target)[0]
    n = middle / np.linalg.norm(middle)
    across = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
    across /= np.linalg.norm(across)
    along = (np.cross(n, across) + n) / np.sqrt(2.0)
    return Circle(middle, settings.radius * across, settings.radius * along, settings.period)


def follow_paths(folder: Path, settings: Settings, method: str) -> dict[str, Any]:
    """One estimator on the path of every scene."""
    del folder
    return {"trials": [follow(settings, method, seed) for seed in settings.path_seeds]}


def follow(settings: Settings, method: str, seed: int) -> dict[str, Any]:
    """Explore, go to the path's first point, then servo to reference pixels that move along it.

    The reference is the path's picture in the true camera, as [10] computes it by its forward model; the servo is told
    these pixels and nothing else.
    """
    rig, plant = laboratory(settings, seed)
    path = circle(rig, settings)
    servo = servo_for(rig, *UNCALIBRATED[method], settings.controller)
    state, target, began = servo.init(), reference(rig, path, 0.0), None
    trace = Trace(rig, path)
    for k, _ in enumerate(
        ticks(plant.clock, duration=servo.exploration.max_time + settings.duration + settings.period)
    ):
        seen = plant.read()
        if began is None and at_start(state):
            began = seen.now
        if began is not None:
            time = (seen.now - began) / 1e9
            if time > settings.period:
                break
            target = reference(rig, path, time)
            trace.look(k, time)
        state = servo.step(state, seen, target)
        plant.send(state.command)
        if state.phase is Phase.PAUSED:
            break
    return trace.verdict(seed, state.cause)


def reference(rig: Rig, path: Circle, time: float) -> Target:
    """What the servo is to see `time` s after the start of the path."""
    q = rig.settings.mechanism.joints(path.p1(time))
    return Target(rig.truth.pixels(q), np.full(3, np.nan))


def at_start(state: State) -> bool:
    """Whether the servo sees the tool at the path's first point."""
    return state.phase is Phase.SERVO and bool(np.max(np.abs(state.delta) / SCALE) < AT_START)


class Trace:
    """Where marker 1 truly was along a path, and where it should have been."""

    def __init__(self, rig: Rig, path: Circle) -> None:
        self._rig, self._path = rig, path
        self._times: list[float] = []
        self._points: list[Floats] = []
        self._pixels: list[Floats] = []

    def look(self, k: int, time: float) -> None:
        """Take note of tick k, `time` s after the start of the path."""
        if k % EVERY:
            return
        q = self._rig.clock.joints_at(self._rig.clock.now())
        self._times.append(time)
        self._points.append(self._rig.body.points(q)[0])
        self._pixels.append(self._rig.truth.pixels(q)[0])

    def verdict(self, seed: int, cause: Cause) -> dict[str, Any]:
        """Errors in mm and px over the path, the ``lag`` s that explains most, and the ``beside`` mm that it leaves."""
        completed = bool(self._times) and self._times[-1] > self._path.period - 0.2
        found = {"seed": seed, "completed": completed, "cause": cause.value}
        if not completed:
            return found
        wanted = np.array([reference(self._rig, self._path, time).points[0] for time in self._times])
        errors = self._behind(0.0)
        pixels = np.linalg.norm(np.array(self._pixels) - wanted, axis=1)
        lags = np.arange(0.0, LONGEST_LAG, 0.02)
        left = [rms(self._behind(lag)) for lag in lags]
        return found | {
            "rms": rms(errors),
            "max": float(errors.max()),
            "pixels_rms": rms(pixels),
            "pixels_max": float(pixels.max()),
            "lag": float(lags[np.argmin(left)]),
            "beside": float(min(left)),
            "times": self._times,
            "errors": errors.tolist(),
            "seen": np.array(self._pixels).tolist(),
            "wanted": wanted.tolist(),
        }

    def _behind(self, lag: float) -> Floats:
        """How far marker 1 was from where it should have been `lag` s before, mm, at every time."""
        wanted = np.array([self._path.p1(time - lag) for time in self._times])
        return np.linalg.norm(np.array(self._points) - wanted, axis=1)


# What was found.


@dataclass(frozen=True)
class Summary:
    """A method over all scenes: ``settled`` as a share, medians in s and mm, and ``failures`` in words."""

    settled: float
    time: float
    explored: float
    pose: float
    worst: float
    jacobian: float
    failures: str

    def words(self) -> str:
        jacobian = f", error of Ĵ {100 * self.jacobian:.0f} %" if np.isfinite(self.jacobian) else ""
        settled = f"settled after {self.time:.1f} s" if np.isfinite(self.time) else "never settled"
        return (
            f"{settled}, explored for {self.explored:.1f} s; pose error {self.pose:.2f} mm, "
            f"worst scene {self.worst:.2f} mm{jacobian} (medians but for the worst)"
        )


def summary(trials: Sequence[dict[str, Any]]) -> Summary:
    causes = Counter(trial["why_not"] for trial in trials if trial["why_not"])
    return Summary(
        settled=100.0 * float(np.mean([not trial["why_not"] for trial in trials])),
        time=median([trial["settle_time"] for trial in trials if trial["settle_time"] is not None]),
        explored=median([trial["explored_at"] or 0.0 for trial in trials]),
        pose=median([trial["pose"] for trial in trials]),
        worst=max(trial["pose"] for trial in trials),
        jacobian=median([trial["jacobian"] for trial in trials if trial["jacobian"] is not None]),
        failures="; ".join(f"{count} of {len(trials)} not settled: {cause}" for cause, count in causes.items()),
    )


def chapter(settings: Settings, results: Results) -> Chapter:
    trials = {method: results[method].values["trials"] for method in METHODS}
    paths = {method: results[f"path-{method}"].values["trials"] for method in PATHS}
    found = {method: summary(some) for method, some in trials.items()}
    claims = [_settles(method, found[method], settings) for method in METHODS]
    claims += _comparisons(found, settings) + _on_broyden(found, settings) + _on_paths(paths, settings)
    return Chapter(claims, [_over_time(trials, settings), _final(trials, settings), _costs(trials, settings),
                            _paths(paths, settings)])  # fmt: skip


def _settles(method: str, found: Summary, settings: Settings) -> Claim:
    return Claim(
        f"{NAMES[method]} settles in at least 95 % of the scenes", WHERE[method], found.settled, "%", ">=", 95.0,
        settings.seeds, remark=found.failures, detail=found.words(), figure="baselines-final",
    )  # fmt: skip


def _comparisons(found: dict[str, Summary], settings: Settings) -> list[Claim]:
    """What the paper says of calibrated methods."""
    ours, image, misled = found["ours"], found["image-exact"], found["image-wrong"]
    pose, lost = found["pose-exact"], found["pose-wrong"]
    by = settings.miscalibration
    error = f"f {100 * by.focal:g} % off, the camera turned by {np.degrees(by.turn):g}° and moved by {by.shift:g} mm"
    seeds = settings.seeds
    return [
        Claim(
            "without calibration the tool ends as near as with an exact one (image-based)",
            "Remark 2, [12]", ours.pose / image.pose, "x the pose error", "<=", 1.25, seeds,
            detail=f"median {ours.pose:.2f} mm against {image.pose:.2f} mm, Ĵ {100 * ours.jacobian:.1f} % wrong, not "
            f"{100 * image.jacobian:.1f} %: the exact C leaves the lens's distortion out", figure="baselines-final",
        ),
        Claim(
            "the traditional approach needs exact knowledge of C: with a wrong one at most half of the scenes settle",
            "Remark 2, [12]", misled.settled, "%", "<=", 50.0, seeds,
            remark="" if misled.settled <= 50.0 else f"with {error}, Ĵ is {100 * misled.jacobian:.0f} % wrong and "
            "feedback makes up for it: a target that was shown is wrong in the same way as what is seen. Exact "
            "knowledge would be needed for a target given in mm",
            detail=f"median pose error {misled.pose:.2f} mm against {image.pose:.2f} mm with the exact C, settled "
            f"after {misled.time:.1f} s against {image.time:.1f} s", figure="baselines-final",
        ),
        Claim(
            "… or with one from before somebody rolled the camera",
            "Remark 2, [12]", found["image-rolled"].settled, "%", "<=", 50.0, seeds,
            detail=f"rolled by {np.degrees(settings.roll):g}°; Ĵ {100 * found['image-rolled'].jacobian:.0f} % wrong, "
            f"median pose error {found['image-rolled'].pose:.1f} mm", figure="baselines-final",
        ),
        Claim(
            "without a pose estimation algorithm the tool ends as near as with one and an exact calibration",
            "IV-C, [20]", ours.pose / pose.pose, "x the pose error", "<=", 1.25, seeds,
            remark="" if ours.pose <= 1.25 * pose.pose else "the fit of a pose weighs all four pixel coordinates by "
            "what they say of p₁, while the three features keep less of them",
            detail=f"median {ours.pose:.2f} mm against {pose.pose:.2f} mm", figure="baselines-final",
        ),
        Claim(
            "… and nearer than with one and a wrong calibration",
            "IV-C, [20]", ours.pose / lost.pose, "x the pose error", "<=", 1.0, seeds,
            remark="" if ours.pose <= lost.pose else "what is wrong in the target's pose is wrong in the same way in "
            f"the present one; but {lost.settled:.0f} % of the scenes settled, ours {ours.settled:.0f} %",
            detail=f"median {ours.pose:.2f} mm against {lost.pose:.2f} mm; {error}", figure="baselines-final",
        ),
        Claim(
            "what takes the place of a calibration, the exploration, costs at most 3 s until settled",
            "ours", ours.time - pose.time, "s", "<=", 3.0, seeds,
            detail=f"settled after {ours.time:.1f} s against {pose.time:.1f} s of pose-based control, which needs no "
            f"exploration (exact C); explored for {ours.explored:.1f} s. With the paper's gains for Γ and γ the "
            f"exploration takes {found['printed'].explored:.1f} s and {found['flow'].explored:.1f} s",
            figure="baselines-costs",
        ),
        Claim(
            "the pose error stays below 4 mm in every scene, with the flow rule as in the paper",
            "IV-C", found["flow"].worst, "mm", "<=", 4.0, seeds,
            detail=f"worst scene of our default {ours.worst:.2f} mm", figure="baselines-final",
        ),
    ]  # fmt: skip


def _on_broyden(found: dict[str, Summary], settings: Settings) -> list[Claim]:
    """The flow rule resembles Broyden's method, III-C; and T7 says that this one is better."""
    flow, broyden, short = found["flow"], found["broyden"], found["broyden-1mm"]
    return [
        Claim(
            "Broyden's update on displacements of 1 mm settles in no fewer scenes than the flow rule with γ = 0.001",
            "III-C", short.settled - flow.settled, "% points", ">=", 0.0, settings.seeds,
            remark="" if short.settled >= flow.settled else
            f"{settings.noise:g} px of noise over 1 mm leave Ĵ {100 * short.jacobian:.0f} % wrong, and on the "
            "way it turns singular; the flow rule averages over its long exploration",
            detail=f"{short.settled:.0f} % against {flow.settled:.0f} %", figure="baselines-final",
        ),
        Claim(
            f"Broyden's update on displacements of {BroydenEstimator().min_step:g} mm settles in no fewer",
            "III-C", broyden.settled - flow.settled, "% points", ">=", 0.0, settings.seeds,
            remark=broyden.failures,
            detail=f"{broyden.settled:.0f} % against {flow.settled:.0f} %; Ĵ {100 * broyden.jacobian:.0f} % wrong "
            f"against {100 * flow.jacobian:.0f} %", figure="baselines-final",
        ),
        Claim(
            "where it settles, Broyden's update needs less than half of the flow rule's time",
            "III-C", broyden.time / flow.time, "x the time", "<=", 0.5, settings.seeds,
            detail=f"{broyden.time:.1f} s against {flow.time:.1f} s, of which {flow.explored:.1f} s are the "
            "exploration from which γ = 0.001 can learn", figure="baselines-costs", trap="T7",
            confirmed=broyden.time <= 0.5 * flow.time,
        ),
    ]  # fmt: skip


def _on_paths(paths: dict[str, list[dict[str, Any]]], settings: Settings) -> list[Claim]:
    speed, k = 2.0 * np.pi * settings.radius / settings.period, settings.controller.gain
    words = {"ours": NAMES["ours"], "flow": NAMES["flow"]}
    claims: list[Claim] = []
    for method, trials in paths.items():
        done = [trial for trial in trials if trial["completed"]]
        causes = Counter(
            trial["cause"] or "time ran out before its start" for trial in trials if not trial["completed"]
        )
        failures = "; ".join(f"{count} of {len(trials)} not completed: {cause}" for cause, count in causes.items())
        of = {key: median([trial[key] for trial in done]) for key in ("rms", "max", "pixels_rms", "lag", "beside")}
        worst = max((trial["max"] for trial in done), default=np.nan)
        claims += [
            Claim(
                f"{words[method]} follows moving reference pixels round the whole path in every scene", "Intro, [10]",
                100.0 * len(done) / len(trials), "%", ">=", 100.0, settings.path_seeds, remark=failures,
                detail=f"circle of {settings.radius:g} mm in {settings.period:g} s, {speed:.1f} mm/s", figure="path",
            ),
            Claim(
                "… within 1.5 times the lag v/k that the law without feed-forward must have", "Intro, [10]",
                of["rms"], "mm rms", "<=", 1.5 * speed / k, settings.path_seeds, remark=failures,
                detail=f"median over the scenes; v/k = {speed / k:.2f} mm; in a scene at most {of['max']:.2f} mm "
                f"(median), {worst:.2f} mm (worst), {of['pixels_rms']:.1f} px rms in the picture", figure="path",
            ),
            Claim(
                "… and but for the lag within 0.3 mm of the path", "Intro, [10]", of["beside"], "mm rms", "<=", 0.3,
                settings.path_seeds, remark=failures,
                detail=f"median over the scenes, after a lag of {of['lag']:.2f} s; 1/k is {1.0 / k:.2f} s",
                figure="path",
            ),
        ]  # fmt: skip
    return claims


def _over_time(trials: dict[str, list[dict[str, Any]]], settings: Settings) -> Shown:
    def panel(methods: Sequence[str]) -> Panel:
        curves = [_median_over_time(method, trials[method], settings, i) for i, method in enumerate(methods)]
        return Panel("time, exploration included [s]", "$\\|p_2 - p_d\\|$ [mm]", curves, log_y=True)

    figure = Figure("Pose error, median over the scenes", [panel(tuple(UNCALIBRATED)), panel(("ours", *CALIBRATED))])
    caption = (
        "Median pose error by the truth, over all scenes, those that failed included. Above, methods without a "
        "calibration; below, those with one beside our default. C is the calibration matrix."
    )
    return Shown("baselines-time", "[12], [15]-[17], [20]", caption, settings.seeds, figure)


def _median_over_time(method: str, trials: list[dict[str, Any]], settings: Settings, style: int) -> Curve:
    """The median over runs; one that ended earlier stays where it ended."""
    whole = round(settings.duration / trials[0]["step"])
    longest = max(whole, *(len(trial["poses"]) for trial in trials))
    rows = [trial["poses"] + [trial["poses"][-1]] * (longest - len(trial["poses"])) for trial in trials]
    return curve(SHORT[method], trials[0]["step"] * np.arange(longest), np.median(rows, axis=0), style)


def _by_method(trials: dict[str, list[dict[str, Any]]], key: str, legend: bool = True) -> list[Curve]:
    """One number of every run as a point over its method: settled and not, and the medians."""
    curves: list[Curve] = []
    for label, style, settled in (("settled", 0, True), ("not settled", 1, False)):
        x: list[float] = []
        y: list[float] = []
        for i, method in enumerate(METHODS):
            for k, trial in enumerate(trials[method]):
                if (not trial["why_not"]) is settled and trial[key] is not None:
                    x.append(i + 0.5 * (k + 0.5) / len(trials[method]) - 0.25)
                    y.append(trial[key])
        curves.append(curve(label if legend else "", x, y, style, marks=True))
    known = {i: [trial[key] for trial in trials[method] if trial[key] is not None] for i, method in enumerate(METHODS)}
    middle = [(i, median(values)) for i, values in known.items() if values]
    curves.append(
        curve("median" if legend else "", [i + 0.36 for i, _ in middle], [value for _, value in middle], 3, marks=True)
    )
    return curves


def _final(trials: dict[str, list[dict[str, Any]]], settings: Settings) -> Shown:
    categories = [SHORT[method] for method in METHODS]
    share = [summary(trials[method]).settled for method in METHODS]
    panels = [
        Panel("method", "$\\|p_2 - p_d\\|$ [mm]", _by_method(trials, "pose"), levels=[("4 mm", 4.0)], log_y=True,
              categories=categories),
        Panel("method", "settled [% of scenes]", [curve("", range(len(METHODS)), share, 0, marks=True)],
              y_limits=(-5.0, 105.0), categories=categories),
    ]  # fmt: skip
    caption = (
        "Root mean square pose error at the end, a point per scene, and how many scenes settled. C: calibration matrix."
    )
    figure = Figure("Where the methods end", panels)
    return Shown("baselines-final", "[12], [15]-[17], [20]", caption, settings.seeds, figure)


def _costs(trials: dict[str, list[dict[str, Any]]], settings: Settings) -> Shown:
    categories = [SHORT[method] for method in METHODS]
    labels = {
        "settle_time": "settled after [s]",
        "explored_at": "explored for [s]",
        "jacobian": "$\\|\\hat{J} - J\\| / \\|J\\|$ [1]",
    }
    panels = [
        Panel("method", label, _by_method(trials, key, legend=i == 0), log_y=key == "jacobian", categories=categories)
        for i, (key, label) in enumerate(labels.items())
    ]
    caption = (
        "Time until settled, the exploration included, the exploration alone, and the scaled error of Ĵ (median over "
        "the time after the exploration). Pose-based control neither explores nor has an image Jacobian; the "
        "image-based law with a given C explores for the imaged RCM alone."
    )
    figure = Figure("What the methods cost", panels)
    return Shown("baselines-costs", "[12], [15]-[17], [20]", caption, settings.seeds, figure)


def _paths(paths: dict[str, list[dict[str, Any]]], settings: Settings) -> Shown:
    labels = {"ours": "ours", "flow": "flow rule"}
    shown = {method: next((t for t in trials if t["completed"]), None) for method, trials in paths.items()}
    pictures: list[Curve] = []
    errors: list[Curve] = []
    for style, (method, one) in enumerate(shown.items()):
        if one is None:
            continue
        seen, wanted = np.array(one["seen"]), np.array(one["wanted"])
        if not pictures:
            pictures.append(curve("reference", wanted[:, 0], wanted[:, 1], -1))
        pictures.append(curve(labels[method], seen[:, 0], seen[:, 1], style))
        rows = [trial["errors"] for trial in paths[method] if trial["completed"]]
        shortest = min(map(len, rows))
        middle = np.median([row[:shortest] for row in rows], axis=0)
        errors.append(curve(labels[method], one["times"][:shortest], middle, style))
    lag = 2.0 * np.pi * settings.radius / settings.period / settings.controller.gain
    panels = [
        Panel("u [px]", "v [px], downwards", pictures, y_limits=_downwards(pictures)),
        Panel("time on the path [s]", "$\\|p_1 - p_{ref}\\|$ [mm]", errors, levels=[("v/k", lag)]),
    ]
    seed = next((one["seed"] for one in shown.values() if one is not None), None)
    caption = (
        f"Left, marker 1 in the picture of scene {seed}; right, how far it is from the moving reference, median over "
        "the scenes."
    )
    return Shown("path", "[10]", caption, settings.path_seeds, Figure("Following a path", panels, columns=2))


def _downwards(curves: Sequence[Curve]) -> tuple[float, float]:
    """Limits of an axis of v, which grows downwards as in the picture."""
    v = [value for one in curves for value in one.y if value is not None] or [0.0]
    return max(v) + 3.0, min(v) - 3.0


EXPERIMENT = Experiment(
    name="baselines",
    title="Beside other methods",
    about="The paper's methods and our default beside Broyden's update [15]-[17], the traditional image-based law with "
    "a calibration [12], pose-based control [20] and path following by reference pixels [10], in the same scenes "
    "with the same gains and noise. Settled is judged on the true features, without noise.",
    whole=Settings(),
    quick=Settings(seeds=(0, 1), path_seeds=(0,), duration=8.0, radius=5.0, period=15.0),
    tasks=tasks,
    chapter=chapter,
)
