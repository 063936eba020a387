"""The paper's methods beside those that it positions itself against, in the same scenes with the
same noise.

Five need no calibration: our projection-based default, the paper's two estimators with the printed
gains, and Broyden's update [15]-[17] on two lengths of displacement. Five are handed one, exact or
wrong: the traditional image-based law [12] and pose-based control [20].

All start at the same joints, are shown the same target and have the same time after their
exploration, if they need one. Whether a run has settled is judged by the truth.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from rcmservo.experiments.harness.calibrated import (
    Calibrated,
    Calibration,
    Miscalibration,
    PoseLaw,
    exact,
    pose_based,
    rolled,
    wrong,
)
from rcmservo.experiments.harness.claims import (
    Chapter,
    Claim,
    Experiment,
    Results,
    Shown,
    Task,
    median,
)
from rcmservo.experiments.harness.closed_loop import PRINTED_FIT, WIDE, servo_for
from rcmservo.experiments.harness.comparison import (
    FLOW_RULE,
    OURS,
    Learner,
    Method,
    Watch,
    laboratory,
)
from rcmservo.figures.charts import Curve, Figure, Panel, curve
from rcmservo.interfaces import Target
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import Tick, run
from rcmservo.loop.teach import teach
from rcmservo.method.controller import SaturatedController
from rcmservo.method.estimators.broyden import BroydenEstimator
from rcmservo.method.exploration import Exploration
from rcmservo.servo.servo import Servo
from rcmservo.sim import SceneSettings
from rcmservo.sim.optics import Optics

Trials = Mapping[str, list[dict[str, Any]]]
"""What the truth says of every run, by method, in the order of METHODS."""

LINES_ONLY = Exploration(tolerance=1e3)
"""The default tour, of which a calibrated law needs nothing but the lines for o_c: it trusts its
Ĵ."""


@dataclass(frozen=True)
class HandedOver(Method):
    """A method that is handed a calibration: exact, wrong, or from before the camera was rolled."""

    law: Literal["image", "pose"]
    quality: Literal["exact", "wrong", "rolled"]


STEP = BroydenEstimator().min_step
IMAGE, POSE = "Remark 2, [12]", "IV-C, [20]"
METHODS: Mapping[str, Method] = {
    "ours": OURS,
    "printed": Learner(
        "the paper's projection rule (21) with 10⁴ s of its own time a fit",
        "printed Γ",
        "(21)",
        PRINTED_FIT,
        WIDE,
    ),
    "flow": FLOW_RULE,
    "broyden": Learner(
        f"Broyden's update on displacements of {STEP:g} mm (our default)",
        "Broyden",
        "III-C, [15]-[17]",
        BroydenEstimator(),
        Exploration(),
    ),
    "broyden-1mm": Learner(
        "Broyden's update on displacements of 1 mm",
        "Broyden, 1 mm",
        "III-C, [15]-[17]",
        BroydenEstimator(min_step=1.0),
        Exploration(),
    ),
    "image-exact": HandedOver(
        "the image-based law with an exact calibration", "image, exact C", IMAGE, "image", "exact"
    ),
    "image-wrong": HandedOver(
        "the image-based law with a wrong calibration", "image, wrong C", IMAGE, "image", "wrong"
    ),
    "image-rolled": HandedOver(
        "the image-based law with a calibration from before the camera was rolled",
        "image, rolled",
        IMAGE,
        "image",
        "rolled",
    ),
    "pose-exact": HandedOver(
        "pose-based control with an exact calibration", "pose, exact C", POSE, "pose", "exact"
    ),
    "pose-wrong": HandedOver(
        "pose-based control with a wrong calibration", "pose, wrong C", POSE, "pose", "wrong"
    ),
}
SHORT = [method.short for method in METHODS.values()]


@dataclass(frozen=True)
class Settings:
    """``duration`` s after the exploration; ``noise`` px; ``roll`` rad of the camera after it was
    calibrated."""

    seeds: tuple[int, ...] = tuple(range(20))
    scene: SceneSettings = field(default_factory=lambda: SceneSettings(room=17.0))
    noise: float = 0.3
    duration: float = 20.0
    controller: SaturatedController = field(default_factory=SaturatedController)
    pose_law: PoseLaw = field(default_factory=PoseLaw)
    miscalibration: Miscalibration = field(default_factory=Miscalibration)
    roll: float = float(np.radians(90.0))


def tasks(settings: Settings) -> list[Task]:
    return [
        Task(
            method,
            regulate,
            {"settings": settings, "method": method},
            cost=0.7 * len(settings.seeds),
        )
        for method in METHODS
    ]


def regulate(folder: Path, settings: Settings, method: str) -> dict[str, Any]:
    """One method in every scene."""
    del folder
    return {"trials": [attempt(settings, METHODS[method], seed) for seed in settings.seeds]}


def attempt(settings: Settings, method: Method, seed: int) -> dict[str, Any]:
    """One method in one scene, and what the truth says of it."""
    rig, plant = laboratory(seed, settings.scene, settings.noise)
    rig.show_target()
    target = teach(plant)
    rig.go_home()
    watch = Watch(rig)
    if isinstance(method, Learner):
        servo = servo_for(rig, method.estimator, method.exploration, settings.controller)
        servo_to(plant, servo, target, settings.duration, watch)
    elif isinstance(method, HandedOver):
        given = calibration(rig.scene.optics, settings, method.quality, seed)
        servo = servo_for(rig, Calibrated(given), LINES_ONLY, settings.controller)
        if method.law == "image":
            servo_to(plant, servo, target, settings.duration, watch)
        else:
            for k, time in enumerate(
                pose_based(plant, servo, given, settings.pose_law, target, settings.duration)
            ):
                watch.look(k, time)
    return {"seed": seed, **watch.verdict()}


def calibration(optics: Optics, settings: Settings, quality: str, seed: int) -> Calibration:
    """What a person hands over: exact, wrong in directions drawn from the seed, or from before a
    roll of the camera."""
    match quality:
        case "exact":
            return exact(optics)
        case "wrong":
            return wrong(optics, settings.miscalibration, np.random.default_rng([seed, 1]))
        case _:
            return rolled(optics, settings.roll)


def servo_to(plant: Plant, servo: Servo, target: Target, duration: float, watch: Watch) -> None:
    """Explore, then servo for `duration` s."""

    def over(tick: Tick) -> bool:
        return watch.explored_at is not None and tick.time / 1e9 >= watch.explored_at + duration

    for k, tick in enumerate(
        run(plant, servo, target, servo.exploration.max_time + duration, done=over)
    ):
        watch.look(k, tick.time / 1e9, tick.state, tick.seen.q_exposure)


@dataclass(frozen=True)
class Summary:
    """A method over all scenes: ``settled`` %, medians in s and mm, ``worst`` mm, and ``failures``
    in words."""

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


def summary(trials: list[dict[str, Any]]) -> Summary:
    """A method's runs in a few numbers."""
    causes = Counter(trial["why_not"] for trial in trials if trial["why_not"])
    return Summary(
        settled=100.0 * float(np.mean([not trial["why_not"] for trial in trials])),
        time=median([trial["settle_time"] for trial in trials if trial["settle_time"] is not None]),
        explored=median([trial["explored_at"] or 0.0 for trial in trials]),
        pose=median([trial["pose"] for trial in trials]),
        worst=max(trial["pose"] for trial in trials),
        jacobian=median([trial["jacobian"] for trial in trials if trial["jacobian"] is not None]),
        failures="; ".join(
            f"{count} of {len(trials)} not settled: {cause}" for cause, count in causes.items()
        ),
    )


def chapter(settings: Settings, results: Results) -> Chapter:
    trials = {method: results[method].values["trials"] for method in METHODS}
    found = {method: summary(some) for method, some in trials.items()}
    claims = [_settles(METHODS[method], one, settings) for method, one in found.items()]
    claims += (
        _on_image_based(found, settings)
        + _on_pose_based(found, settings)
        + _on_broyden(found, settings)
    )
    figures = [
        _over_time(trials, settings),
        _final(trials, found, settings),
        _costs(trials, settings),
    ]
    return Chapter(claims, figures)


def _settles(method: Method, found: Summary, settings: Settings) -> Claim:
    return Claim(
        f"{method.name} settles in at least 95 % of the scenes",
        method.where,
        found.settled,
        "%",
        ">=",
        95.0,
        settings.seeds,
        remark=found.failures,
        detail=found.words(),
        figure="baselines-final",
    )


def _error(by: Miscalibration) -> str:
    """In words, how wrong a wrong calibration is."""
    return (
        f"f {100 * by.focal:g} % off, the camera turned by {np.degrees(by.turn):g}° and moved "
        f"by {by.shift:g} mm"
    )


def _on_image_based(found: Mapping[str, Summary], settings: Settings) -> list[Claim]:
    """The traditional approach, of which Remark 2 says that it needs exact knowledge of C."""
    ours, image, misled, stale = (
        found[method] for method in ("ours", "image-exact", "image-wrong", "image-rolled")
    )
    return [
        Claim(
            "our default ends as near the target's pose as the image-based law with an exact "
            "calibration",
            IMAGE,
            ours.pose / image.pose,
            "x the pose error",
            "<=",
            1.25,
            settings.seeds,
            detail=f"median {ours.pose:.2f} mm against {image.pose:.2f} mm, Ĵ "
            f"{100 * ours.jacobian:.1f} % wrong, not "
            f"{100 * image.jacobian:.1f} %: the exact C leaves the lens's distortion out",
            figure="baselines-final",
        ),
        Claim(
            "the image-based law needs exact knowledge of C: with a wrong one at most half of "
            "the scenes settle",
            IMAGE,
            misled.settled,
            "%",
            "<=",
            50.0,
            settings.seeds,
            remark=""
            if misled.settled <= 50.0
            else f"with {_error(settings.miscalibration)}, Ĵ "
            f"is "
            f"{100 * misled.jacobian:.0f} % wrong and feedback makes up for it: a target that "
            f"was shown is wrong in "
            "the same way as what is seen. Exact knowledge would be needed for a target given in "
            "mm",
            detail=f"median pose error {misled.pose:.2f} mm against {image.pose:.2f} mm with the "
            f"exact C, settled "
            f"after {misled.time:.1f} s against {image.time:.1f} s",
            figure="baselines-final",
        ),
        Claim(
            "the image-based law needs an up-to-date C: with one from before the camera was "
            "rolled at most half of the "
            "scenes settle",
            IMAGE,
            stale.settled,
            "%",
            "<=",
            50.0,
            settings.seeds,
            detail=f"rolled by {np.degrees(settings.roll):g}°; Ĵ {100 * stale.jacobian:.0f} % "
            f"wrong, median pose "
            f"error {stale.pose:.1f} mm",
            figure="baselines-final",
        ),
    ]


def _on_pose_based(found: Mapping[str, Summary], settings: Settings) -> list[Claim]:
    """IV-C: what the paper reaches without a pose estimation algorithm, and what that costs."""
    ours, flow, pose, lost = (
        found[method] for method in ("ours", "flow", "pose-exact", "pose-wrong")
    )
    return [
        Claim(
            "our default ends as near the target's pose as pose-based control with an exact "
            "calibration",
            POSE,
            ours.pose / pose.pose,
            "x the pose error",
            "<=",
            1.25,
            settings.seeds,
            remark=""
            if ours.pose <= 1.25 * pose.pose
            else "the fit of a pose weighs all four "
            "pixel coordinates by "
            "what they say of p₁, while the three features keep less of them",
            detail=f"median {ours.pose:.2f} mm against {pose.pose:.2f} mm",
            figure="baselines-final",
        ),
        Claim(
            "our default ends nearer the target's pose than pose-based control with a wrong "
            "calibration",
            POSE,
            ours.pose / lost.pose,
            "x the pose error",
            "<=",
            1.0,
            settings.seeds,
            remark=""
            if ours.pose <= lost.pose
            else "what is wrong in the target's pose is "
            "wrong in the same way in "
            f"the present one; but {lost.settled:.0f} % of the scenes settled, ours "
            f"{ours.settled:.0f} %",
            detail=f"median {ours.pose:.2f} mm against {lost.pose:.2f} mm; "
            f"{_error(settings.miscalibration)}",
            figure="baselines-final",
        ),
        Claim(
            "our default, which explores first, settles at most 3 s later than pose-based "
            "control with an exact "
            "calibration",
            "ours",
            ours.time - pose.time,
            "s",
            "<=",
            3.0,
            settings.seeds,
            detail=f"after {ours.time:.1f} s, of which {ours.explored:.1f} s explored, against "
            f"{pose.time:.1f} s; "
            f"with the paper's gains Γ and γ the exploration takes "
            f"{found['printed'].explored:.1f} s and "
            f"{flow.explored:.1f} s",
            figure="baselines-costs",
        ),
        Claim(
            "with the paper's flow rule the pose error stays below 4 mm in every scene",
            "IV-C",
            flow.worst,
            "mm",
            "<=",
            4.0,
            settings.seeds,
            detail=f"worst scene of our default {ours.worst:.2f} mm",
            figure="baselines-final",
        ),
    ]


def _on_broyden(found: Mapping[str, Summary], settings: Settings) -> list[Claim]:
    """The flow rule resembles Broyden's method, III-C; and T7 says that this one is better."""
    flow, broyden, short = found["flow"], found["broyden"], found["broyden-1mm"]
    return [
        Claim(
            "Broyden's update on displacements of 1 mm settles in no fewer scenes than the "
            "paper's flow rule",
            "III-C",
            short.settled - flow.settled,
            "% points",
            ">=",
            0.0,
            settings.seeds,
            remark=""
            if short.settled >= flow.settled
            else f"{settings.noise:g} px of noise over 1 mm leave Ĵ {100 * short.jacobian:.0f} % "
            f"wrong, and on the "
            "way it turns singular; the flow rule averages over its long exploration",
            detail=f"{short.settled:.0f} % against {flow.settled:.0f} %",
            figure="baselines-final",
        ),
        Claim(
            f"Broyden's update on displacements of {STEP:g} mm settles in no fewer scenes than "
            f"the paper's flow rule",
            "III-C",
            broyden.settled - flow.settled,
            "% points",
            ">=",
            0.0,
            settings.seeds,
            remark=broyden.failures,
            detail=f"{broyden.settled:.0f} % against {flow.settled:.0f} %; Ĵ "
            f"{100 * broyden.jacobian:.0f} % wrong "
            f"against {100 * flow.jacobian:.0f} %",
            figure="baselines-final",
        ),
        Claim(
            f"where it settles, Broyden's update on displacements of {STEP:g} mm needs less than "
            f"half of the flow "
            "rule's time",
            "III-C",
            broyden.time / flow.time,
            "x the time",
            "<=",
            0.5,
            settings.seeds,
            detail=f"{broyden.time:.1f} s against {flow.time:.1f} s, of which "
            f"{flow.explored:.1f} s are the "
            "exploration from which γ = 0.001 can learn",
            figure="baselines-costs",
            trap="T7",
            confirmed=broyden.time <= 0.5 * flow.time,
        ),
    ]


def _over_time(trials: Trials, settings: Settings) -> Shown:
    learners = [method for method, one in METHODS.items() if isinstance(one, Learner)]
    handed_over = [method for method in METHODS if method not in learners]

    def panel(methods: Sequence[str]) -> Panel:
        curves = [
            _median_over_time(method, trials[method], settings, i)
            for i, method in enumerate(methods)
        ]
        return Panel("time, exploration included [s]", "$\\|p_2 - p_d\\|$ [mm]", curves, log_y=True)

    figure = Figure(
        "Pose error, median over the scenes", [panel(learners), panel(["ours", *handed_over])]
    )
    caption = (
        "Median pose error by the truth, over all scenes, those that failed included. Above, "
        "methods without a "
        "calibration; below, those with one beside our default. C is the calibration matrix."
    )
    return Shown("baselines-time", "[12], [15]-[17], [20]", caption, settings.seeds, figure)


def _median_over_time(
    method: str, trials: list[dict[str, Any]], settings: Settings, style: int
) -> Curve:
    """The median over runs; one that ended earlier stays where it ended."""
    step = trials[0]["step"]
    longest = max(round(settings.duration / step), *(len(trial["poses"]) for trial in trials))
    rows = [
        trial["poses"] + [trial["poses"][-1]] * (longest - len(trial["poses"])) for trial in trials
    ]
    return curve(METHODS[method].short, step * np.arange(longest), np.median(rows, axis=0), style)


def _final(trials: Trials, found: Mapping[str, Summary], settings: Settings) -> Shown:
    share = [one.settled for one in found.values()]
    panels = [
        Panel(
            "method",
            "$\\|p_2 - p_d\\|$ [mm]",
            _by_method(trials, "pose"),
            levels=[("4 mm", 4.0)],
            log_y=True,
            categories=SHORT,
        ),
        Panel(
            "method",
            "settled [% of scenes]",
            [curve("", range(len(share)), share, 0, marks=True)],
            y_limits=(-5.0, 105.0),
            categories=SHORT,
        ),
    ]
    caption = (
        "Root mean square pose error at the end, a point per scene, and how many scenes "
        "settled. C: calibration matrix."
    )
    figure = Figure("Where the methods end", panels)
    return Shown("baselines-final", "[12], [15]-[17], [20]", caption, settings.seeds, figure)


def _costs(trials: Trials, settings: Settings) -> Shown:
    labels = {
        "settle_time": "settled after [s]",
        "explored_at": "explored for [s]",
        "jacobian": "$\\|\\hat{J} - J\\| / \\|J\\|$ [1]",
    }
    panels = [
        Panel(
            "method",
            label,
            _by_method(trials, key, legend=i == 0),
            log_y=key == "jacobian",
            categories=SHORT,
        )
        for i, (key, label) in enumerate(labels.items())
    ]
    caption = (
        "Time until settled, the exploration included, the exploration alone, and the scaled "
        "error of Ĵ (median over "
        "the time after the exploration). Pose-based control neither explores nor has an image "
        "Jacobian; the "
        "image-based law with a given C explores for the imaged RCM alone."
    )
    figure = Figure("What the methods cost", panels)
    return Shown("baselines-costs", "[12], [15]-[17], [20]", caption, settings.seeds, figure)


def _by_method(trials: Trials, key: str, legend: bool = True) -> list[Curve]:
    """One number of every run as a point over its method: settled and not, and the medians."""
    settled: list[tuple[float, float]] = []
    failed: list[tuple[float, float]] = []
    middle: list[tuple[float, float]] = []
    for i, some in enumerate(trials.values()):
        known = [
            (i + 0.5 * (k + 0.5) / len(some) - 0.25, one)
            for k, one in enumerate(some)
            if one[key] is not None
        ]
        settled += [(x, one[key]) for x, one in known if not one["why_not"]]
        failed += [(x, one[key]) for x, one in known if one["why_not"]]
        middle += [(i + 0.36, median([one[key] for _, one in known]))] if known else []
    return [
        curve(
            label if legend else "",
            [x for x, _ in points],
            [y for _, y in points],
            style,
            marks=True,
        )
        for label, points, style in (
            ("settled", settled, 0),
            ("not settled", failed, 1),
            ("median", middle, 3),
        )
    ]


EXPERIMENT = Experiment(
    name="baselines",
    title="Beside other methods",
    about="The paper's methods and our default beside Broyden's update [15]-[17], the "
    "traditional image-based law with "
    "a calibration [12] and pose-based control [20], in the same scenes with the same gains and "
    "noise. Settled is "
    "judged on the true features, without noise.",
    whole=Settings(),
    quick=Settings(seeds=(0, 1), duration=8.0),
    tasks=tasks,
    chapter=chapter,
)
