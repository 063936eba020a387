"""Which estimator has the more accurate Jacobian, and which knows the camera: IV-B's comparison,
made fair.

One stream of samples, as a servo saw them, is fed to every estimator, so that all learn from the
same motion and the same noise. Two kinds of stream: a servo run with the printed law, which moves
at about 1 px/s, and a tour that keeps moving at exploration's speed. The truth judges Ĵ at every
frame twice: as a matrix, ‖Ĵ − J‖/‖J‖, and only along the present motion v, ‖(Ĵ − J)v‖/‖Jv‖, which
is all that the flow rule (28) sees. The printed Γ is judged twice: in real time, and given 10⁴ s of
its own time at every frame. Its ten observations are random ones of those seen, as the paper has
it, or chosen by leverage, as our estimators do.

What an estimate knows of the camera shows at poses that it never saw: how far from the true pixels
it expects the markers there. The flow rule has no parameters a, so it can only go on linearly from
where it is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rcmservo.experiments.harness.cameras import true_parameters
from rcmservo.experiments.harness.claims import Chapter, Claim, Experiment, Results, Shown, Task
from rcmservo.experiments.harness.closed_loop import (
    FLOW,
    LONG,
    NOISE,
    PAPER_SCENES,
    PRINTED_FIT,
    PRINTED_LAW,
    servo_for,
)
from rcmservo.figures.charts import Curve, Figure, Panel, curve
from rcmservo.interfaces import Floats
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import Tick, run
from rcmservo.loop.teach import teach
from rcmservo.method.controller import scaled
from rcmservo.method.estimators.base import Estimator, Sample
from rcmservo.method.estimators.projection import (
    GAMMA_0,
    ProjectionEstimator,
    decay,
    jacobian_at,
    keep_in_front,
    normal_equations,
    predict,
)
from rcmservo.method.exploration import Exploration
from rcmservo.method.features import about, features
from rcmservo.method.projection import PARAMETERS
from rcmservo.method.tool import Tool
from rcmservo.sim import Rig, RigSettings, SceneSettings
from rcmservo.tracking import PointMarkers


class Drawn(NamedTuple):
    """``observations`` (P, 7) rows [p₁ mm, raw m₁ m₂ px] of the ``seen`` samples, and ``a_hat``
    (9,)."""

    observations: Floats
    seen: int
    a_hat: Floats


@dataclass(frozen=True)
class RandomFit(Estimator):
    """Rule (21) with the printed Γ as the paper words it, on P random observations: of all samples
    seen so far each is as likely to be among them. ``estimator_time`` s is given at every frame."""

    observations: int = 10
    estimator_time: float = 1e4

    name = "random"
    models = True

    def init(self) -> Drawn:
        return Drawn(np.zeros((self.observations, 7)), 0, np.zeros(PARAMETERS))

    def update(self, memory: Drawn, tool: Tool, sample: Sample) -> Drawn:
        kept, a = memory.observations.copy(), memory.a_hat
        drawn = int(np.random.default_rng(memory.seen).integers(memory.seen + 1))
        row = memory.seen if memory.seen < len(kept) else drawn
        if row < len(kept):
            kept[row] = np.concatenate([sample.p1, sample.points.ravel()])
        count = min(memory.seen + 1, len(kept))
        A, b = normal_equations(kept, count, sample.o_c, False, tool.shaft)
        a_next = decay(A, b, a, np.diag(np.sqrt(GAMMA_0)), self.estimator_time)
        return Drawn(kept, memory.seen + 1, keep_in_front(a, a_next, kept, count, tool.shaft))

    def jacobian(self, memory: Drawn, tool: Tool, sample: Sample) -> Floats:
        return jacobian_at(memory.a_hat, sample.p1, sample.points, sample.o_c, tool.shaft)

    def predict(self, memory: Drawn, tool: Tool, p1: Floats) -> Floats:
        return predict(memory.a_hat, p1, tool.shaft)


ESTIMATORS: Mapping[str, Estimator] = {
    "flow": FLOW,
    "random": RandomFit(),
    "given time": PRINTED_FIT,
    "real time": ProjectionEstimator(gamma="printed", observations=10, both_markers=False),
    "fast": ProjectionEstimator(),
}
LABELS = {
    "flow": "flow, γ = 0.001",
    "random": "projection, printed Γ, 10⁴ s a fit, random",
    "given time": "projection, printed Γ, 10⁴ s a fit, chosen",
    "real time": "projection, printed Γ, real time",
    "fast": "projection, fast Γ, both markers",
}
SHORT = {
    "flow": "flow",
    "random": "random",
    "given time": "chosen",
    "real time": "real time",
    "fast": "fast Γ",
}
NAMES = (
    "Random and chosen: the printed Γ, 10⁴ s a fit, on random observations and on those chosen "
    "by leverage; real time: "
    "the printed Γ in real time; fast Γ: our default, both markers."
)
"""What the short names in the figures mean."""

PHASES = {"servo": ("exploring", "saturated way", "end"), "tour": ("learning", "touring")}
JUDGED = {"servo": 1, "tour": 1}
"""The phase of each kind of stream that the claims are about."""

AGAINST = {
    "random": "printed Γ, 10⁴ s a fit, random observations",
    "given time": "printed Γ, 10⁴ s a fit, observations chosen by leverage",
    "real time": "printed Γ, real time",
}
STREAMS = {"servo": "a servo run with the printed law", "tour": "a fast tour"}
MEASURES = {
    "full": "$\\|\\hat{J} - J\\| / \\|J\\|$ [1]",
    "along": "$\\|(\\hat{J} - J)v\\| / \\|Jv\\|$ [1]",
}
LIMITS = (1e-5, 20.0)
"""Of the errors' axes, with room for the legend below the curves."""

WORDS = {"full": "the whole matrix", "along": "the flow Ĵv along the motion"}
NOTHING = 0.9
"""Error of Ĵ from which on it is no better than none."""

WINDOW = 20_000_000
"""ns before and after an exposure over which the true velocity is taken."""

POINTS = 300
"""Medians over time that a series keeps for its figure."""

DRAWS = 2000
"""Configurations drawn of the whole workspace; the camera sees a few of them."""


@dataclass(frozen=True)
class Settings:
    """``noises`` px, the first one judged; ``duration`` s of a servo run and ``touring`` s of a
    tour, whose first ``learning`` s are not judged; ``least_speed`` mm/s from which on there is a
    direction of motion; ``held_out`` poses within ``around`` mm of the way, ``known`` px within
    which a predicted marker counts as known."""

    seeds: tuple[int, ...] = (0, 1, 2, 3, 4, 5, 6, 7)
    noises: tuple[float, ...] = (NOISE, 0.3)
    duration: float = 120.0
    touring: float = 40.0
    learning: float = 20.0
    least_speed: float = 0.3
    held_out: int = 100
    around: float = 15.0
    known: float = 2.0
    scene: SceneSettings = PAPER_SCENES
    exploration: Exploration = LONG


@dataclass(frozen=True, eq=False)
class Stream:
    """What a servo saw, frame by frame, and the truth: ``time`` (n,) s, ``phase`` (n,), scaled
    ``J`` (n, 3, 3), ``v`` (n, 3) mm/s of marker 1."""

    samples: list[Sample]
    time: Floats
    phase: Floats
    J: Floats
    v: Floats


def tasks(settings: Settings) -> list[Task]:
    return [
        Task(
            f"{kind}-{seed}-{noise:g}",
            compare,
            {"settings": settings, "kind": kind, "seed": seed, "noise": noise},
            cost=cost,
        )
        for kind, cost in (("servo", 4.0), ("tour", 2.0))
        for seed in settings.seeds
        for noise in settings.noises
    ]


def compare(folder: Path, settings: Settings, kind: str, seed: int, noise: float) -> dict[str, Any]:
    """One stream through every estimator: medians of both errors by phase, both over time, and
    poses held out."""
    del folder
    rig = Rig(seed, RigSettings(point_noise=noise, scene=settings.scene), pictures=False)
    seen = stream(rig, settings, kind)
    near, far = near_way(rig, settings, seed), workspace(rig, settings, seed)
    values: dict[str, Any] = {"length": float(seen.time[-1]), "time": over_time(seen.time)}
    for name, estimator in ESTIMATORS.items():
        J_hat, memory = learnt(estimator, seen.samples, rig.settings.tool)
        errors = judged(J_hat, seen, settings.least_speed)
        last = seen.samples[-1]
        values[name] = {
            "phases": {
                key: by_phase(error, seen.phase, len(PHASES[kind])) for key, error in errors.items()
            },
            "series": {key: over_time(error) for key, error in errors.items()},
            "near": missed(rig, estimator, memory, J_hat[-1], last, near),
            "workspace": missed(rig, estimator, memory, J_hat[-1], last, far),
            "parameters": parameter_error(rig, memory.a_hat) if estimator.models else None,
        }
    return values


def stream(rig: Rig, settings: Settings, kind: str) -> Stream:
    """The samples that a servo with the default estimator learnt from, and the truth at each."""
    tour = Exploration(
        settings.exploration.radius, settings.exploration.speed, rounds=10**6, max_time=1e6
    )
    exploration, duration = (
        (settings.exploration, settings.duration) if kind == "servo" else (tour, settings.touring)
    )
    servo = servo_for(rig, ProjectionEstimator(), exploration, PRINTED_LAW)
    plant = Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    rig.show_target()
    target = teach(plant)
    rig.go_home()
    samples: list[Sample] = []
    rows: list[tuple[float, int, Floats, Floats]] = []
    last = -1
    for tick in run(plant, servo, target, duration):
        state = tick.state
        exposure = state.learnt.estimate.exposure
        if exposure == last:
            continue
        dt = (exposure - last) * 1e-9 if last >= 0 else 0.0
        last = exposure
        samples.append(Sample(state.p1, tick.seen.points, state.o_c, dt))
        J = rig.truth.jacobian(rig.truth.joints_at(last), state.o_c)
        phase = servo_phase(tick) if kind == "servo" else int(tick.time > settings.learning * 1e9)
        rows.append((tick.time / 1e9, phase, scaled(J), velocity(rig, last)))
    time, phases, Js, vs = (np.array(column) for column in zip(*rows, strict=True))
    return Stream(samples, time, phases, Js, vs)


def servo_phase(tick: Tick) -> int:
    """Where a servo run stands: exploring, with an error beyond b, or with none."""
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
    """Ĵ (n, 3, 3) scaled after every sample, and the memory at the end."""
    memory = estimator.init()
    J_hat = np.empty((len(samples), 3, 3))
    for i, sample in enumerate(samples):
        memory = estimator.update(memory, tool, sample)
        J_hat[i] = scaled(estimator.jacobian(memory, tool, sample))
    return J_hat, memory


def judged(J_hat: Floats, seen: Stream, least_speed: float) -> dict[str, Floats]:
    """Both errors (n,) of Ĵ (n, 3, 3); along the motion NaN where the arm stands."""
    wrong = J_hat - seen.J
    full = np.linalg.norm(wrong, axis=(1, 2)) / np.linalg.norm(seen.J, axis=(1, 2))
    flow, missing = (
        np.linalg.norm((matrix @ seen.v[:, :, None])[:, :, 0], axis=1) for matrix in (seen.J, wrong)
    )
    moves = np.linalg.norm(seen.v, axis=1) > least_speed
    return {"full": full, "along": np.where(moves, missing / np.maximum(flow, 1e-12), np.nan)}


def by_phase(error: Floats, phase: Floats, phases: int) -> list[float | None]:
    """Median of an error (n,) in every phase; None where a phase has no number."""
    return [median(error[phase == i]) for i in range(phases)]


def median(numbers: Floats) -> float | None:
    """Median of those that are finite, or None."""
    finite = numbers[np.isfinite(numbers)]
    return float(np.median(finite)) if len(finite) else None


def middle(numbers: Floats) -> float:
    """Median of those that are finite, or NaN."""
    found = median(numbers)
    return np.nan if found is None else found


def over_time(numbers: Floats) -> list[float | None]:
    """POINTS medians of successive numbers."""
    return [median(piece) for piece in np.array_split(numbers, min(POINTS, len(numbers)))]


def near_way(rig: Rig, settings: Settings, seed: int) -> list[Floats]:
    """Joints of poses that the camera sees, with marker 1 within `around` mm of the way from start
    to target."""
    random = np.random.default_rng(seed)
    poses: list[Floats] = []
    while len(poses) < settings.held_out:
        aside = random.standard_normal(3)
        aside *= settings.around * random.uniform() ** (1.0 / 3.0) / np.linalg.norm(aside)
        q = rig.body.mechanism.joints(rig.body.points(random.choice(rig.scene.way))[0] + aside)
        if in_picture(rig, q):
            poses.append(q)
    return poses


def workspace(rig: Rig, settings: Settings, seed: int) -> list[Floats]:
    """Joints of poses that the camera sees, anywhere within the joint limits."""
    random = np.random.default_rng(seed)
    drawn = random.uniform(*rig.body.mechanism.limits.arrays, (DRAWS, 3))
    return [q for q in drawn if in_picture(rig, q)][: settings.held_out]


def in_picture(rig: Rig, q: Floats) -> bool:
    """Whether the true camera sees both markers at the joints q (3,)."""
    pixels, optics = rig.truth.pixels(q), rig.scene.optics
    return bool(((pixels >= 0.0) & (pixels <= np.array([optics.width, optics.height]) - 1.0)).all())


def missed(
    rig: Rig,
    estimator: Estimator,
    memory: Any,
    J_hat: Floats,
    last: Sample,
    poses: Sequence[Floats],
) -> float | None:
    """Median distance px of the predicted from the true markers at `poses`."""
    tool = rig.settings.tool
    errors: list[Floats] = []
    for q in poses:
        p1 = rig.body.points(q)[0]
        m = estimator.predict(memory, tool, p1)
        m = extrapolated(J_hat, last, p1) if m is None else m
        errors.append(np.linalg.norm(m.reshape(2, 2) + last.o_c - rig.truth.pixels(q), axis=1))
    return median(np.array(errors))


def extrapolated(J_hat: Floats, last: Sample, p1: Floats) -> Floats:
    """m (4,) px from o_c at p1 by a scaled Ĵ alone: y goes on linearly from the `last` sample."""
    unscale = 1.0 / scaled(np.ones((3, 1)))[:, 0]
    s, r, d = features(about(last.points, last.o_c)) + unscale * (J_hat @ (p1 - last.p1))
    along = np.array([np.cos(s), np.sin(s)])
    return np.concatenate([r * along, (r + d) * along])


def parameter_error(rig: Rig, a_hat: Floats) -> float:
    """Relative error of â in the measure of (22) with the printed Γ₀, against the camera without
    its distortion."""
    a, _ = true_parameters(rig)
    weight = 1.0 / np.sqrt(GAMMA_0)
    return float(np.linalg.norm(weight * (a_hat - a)) / np.linalg.norm(weight * a))


@dataclass(frozen=True)
class Table:
    """All results, and how to ask them."""

    settings: Settings
    results: Results

    def of(self, kind: str, seed: int, noise: float) -> dict[str, Any]:
        return self.results[f"{kind}-{seed}-{noise:g}"].values

    def error(self, kind: str, noise: float, name: str, measure: str, phase: int) -> Floats:
        """The median error in a phase, for every seed."""
        rows = [
            self.of(kind, seed, noise)[name]["phases"][measure][phase]
            for seed in self.settings.seeds
        ]
        return np.array(rows, dtype=float)

    def known(self, kind: str, noise: float, name: str, key: str) -> Floats:
        """What was `missed` (or the parameter error) for every seed."""
        return np.array(
            [self.of(kind, seed, noise)[name][key] for seed in self.settings.seeds], dtype=float
        )

    def ratio(self, kind: str, noise: float, measure: str, against: str) -> float:
        """Median over seeds of flow's error over another's."""
        phase = JUDGED[kind]
        flow, other = (self.error(kind, noise, name, measure, phase) for name in ("flow", against))
        return middle(flow / other)


def chapter(settings: Settings, results: Results) -> Chapter:
    table = Table(settings, results)
    claims = [
        more_accurate(table, kind, measure, against)
        for kind in STREAMS
        for against in ("random", "given time", "real time")
        for measure in MEASURES
    ]
    claims += [
        knows_camera(table, "random"),
        knows_camera(table, "given time"),
        knows_camera(table, "real time"),
        knows_camera(table, "fast"),
    ]
    claims.append(flow_does_not(table))
    figures = [
        _over_time(table, "servo"),
        _over_time(table, "tour"),
        _per_seed(table),
        _phases(table),
        _poses(table),
    ]
    return Chapter(claims, figures)


def more_accurate(table: Table, kind: str, measure: str, against: str) -> Claim:
    """Flow's claim of the more accurate instantaneous Jacobian, on one kind of stream and by one
    measure."""
    noise, phase = table.settings.noises[0], JUDGED[kind]
    ratio = table.ratio(kind, noise, measure, against)
    medians = [
        f"{LABELS[name]} {middle(table.error(kind, noise, name, measure, phase)):.3f}"
        for name in ESTIMATORS
    ]
    others = [
        f"{table.ratio(kind, other, measure, against):.2g} with {other:g} px"
        for other in table.settings.noises
    ]
    return Claim(
        f"the flow-based method gives the more accurate (instantaneous) Jacobian: error of "
        f"{WORDS[measure]} in "
        f"{STREAMS[kind]}, flow's over that of the projection-based method ({AGAINST[against]})",
        "IV-B",
        ratio,
        "",
        "<=",
        1.0,
        table.settings.seeds,
        remark=_why(table, kind, measure, against),
        detail=f"median errors, {PHASES[kind][phase]}: {'; '.join(medians)}; ratio "
        f"{', '.join(others)}",
        figure="accuracy-seeds",
    )


def _why(table: Table, kind: str, measure: str, against: str) -> str:
    """What a reader must know beside a ratio: against what it holds, and how good it is then."""
    noise, phase = table.settings.noises[0], JUDGED[kind]
    ratios = {n: table.ratio(kind, n, measure, against) for n in table.settings.noises}
    flow, other = (
        middle(table.error(kind, noise, name, measure, phase)) for name in ("flow", against)
    )
    words = f"flow's error is {flow:.2g}, the projection-based one {other:.2g}"
    if other > NOTHING:
        words += ", about that of Ĵ = 0, which is 1"
    turned = [n for n, ratio in ratios.items() if (ratio <= 1.0) != (ratios[noise] <= 1.0)]
    if turned:
        words += "; it is the other way round with " + ", ".join(
            f"{n:g} px of noise ({ratios[n]:.2g})" for n in turned
        )
    return words


def knows_camera(table: Table, name: str) -> Claim:
    """The projection-based method's claim to estimate a: what it predicts at poses held out."""
    settings, noise = table.settings, table.settings.noises[0]
    far = middle(table.known("servo", noise, name, "workspace"))
    by_noise = {n: middle(table.known("servo", n, name, "near")) for n in settings.noises}
    wrong = middle(table.known("servo", noise, name, "parameters"))
    beyond = [
        f"with {n:g} px of noise it is {short(px)} px"
        for n, px in by_noise.items()
        if px > settings.known
    ]
    near, listed = (
        by_noise[noise],
        ", ".join(f"{short(px)} px with {n:g} px" for n, px in by_noise.items()),
    )
    return Claim(
        f"the projection-based method ({LABELS[name].removeprefix('projection, ')}) estimates "
        f"the parameters a: after "
        f"a servo run it predicts the markers at held-out poses within {settings.around:g} mm of "
        f"the way",
        "IV-B, Proposition 1",
        near,
        "px",
        "<=",
        settings.known,
        settings.seeds,
        remark="; ".join(beyond),
        detail=f"{listed} of noise; anywhere in the picture {short(far)} px; relative error of â "
        f"{wrong:.2g} in the "
        "measure of (22)",
        figure="accuracy-poses",
        trap="T6" if name == "real time" else "",
        confirmed=bool(near > settings.known),
    )


def short(number: Any) -> str:
    """Two digits, or all of those before the point."""
    return f"{number:.0f}" if number >= 10.0 else f"{number:.2g}"


def flow_does_not(table: Table) -> Claim:
    """The limit that the paper itself names: flow has no parameters."""
    settings, noise = table.settings, table.settings.noises[0]
    flow, other = (table.known("servo", noise, name, "near") for name in ("flow", "random"))
    far = middle(table.known("servo", noise, "flow", "workspace"))
    return Claim(
        "the flow-based method cannot estimate the parameters a: going on linearly it misses the "
        "markers at held-out "
        "poses by more than the projection-based method (10⁴ s a fit, random), by the factor",
        "IV-B",
        middle(flow / other),
        "",
        ">=",
        1.0,
        settings.seeds,
        detail=f"{short(middle(flow))} px near the way and {short(far)} px anywhere in the picture",
        figure="accuracy-poses",
    )


def _over_time(table: Table, kind: str) -> Shown:
    seed, noise = table.settings.seeds[0], table.settings.noises[0]
    values = table.of(kind, seed, noise)
    panels = [
        Panel(
            "time [s]",
            label,
            [
                curve(
                    SHORT[name] if measure == "full" else "",
                    values["time"],
                    np.array(values[name]["series"][measure], dtype=float),
                    style,
                )
                for style, name in enumerate(ESTIMATORS)
            ],
            log_y=True,
            y_limits=LIMITS,
        )
        for measure, label in MEASURES.items()
    ]
    caption = (
        "Error of Ĵ against the truth, scaled, every estimator on the same samples: of the whole "
        "matrix on the left, "
        f"along the present motion on the right (only where marker 1 moves by more than "
        f"{table.settings.least_speed:g} "
        f"mm/s). Medians over pieces of {values['length'] / POINTS:.1g} s. {NAMES}"
    )
    figure = Figure(
        f"Every estimator in {STREAMS[kind]}, seed {seed}, {noise:g} px of noise", panels, columns=2
    )
    return Shown(f"accuracy-{kind}", "IV-B", caption, [seed], figure)


def _per_seed(table: Table) -> Shown:
    settings = table.settings
    panels = [
        Panel(
            "",
            f"{label}\n{PHASES[kind][JUDGED[kind]]}",
            [
                _marks(
                    f"{noise:g} px of noise",
                    [table.error(kind, noise, name, measure, JUDGED[kind]) for name in ESTIMATORS],
                    style,
                )
                for style, noise in enumerate(settings.noises)
            ],
            log_y=True,
            categories=[SHORT[name] for name in ESTIMATORS],
        )
        for kind in STREAMS
        for measure, label in MEASURES.items()
    ]
    caption = (
        "Median error of Ĵ of every seed: while a servo run is saturated (above), and while "
        "touring after the first "
        f"{settings.learning:g} s (below). {NAMES}"
    )
    return Shown(
        "accuracy-seeds",
        "IV-B",
        caption,
        settings.seeds,
        Figure("Accuracy by seed", panels, columns=2),
    )


def _marks(label: str, groups: Sequence[Floats], style: int) -> Curve:
    """One mark for each seed, beside the place of its group."""
    x = [
        place + 0.22 * style + 0.02 * i - 0.18
        for place, group in enumerate(groups)
        for i in range(len(group))
    ]
    return curve(label, x, np.concatenate(groups), style, marks=True)


def _phases(table: Table) -> Shown:
    noise, phases = table.settings.noises[0], PHASES["servo"]
    panels = [
        Panel(
            "",
            label,
            [
                curve(
                    SHORT[name] if measure == "full" else "",
                    range(len(phases)),
                    [
                        middle(table.error("servo", noise, name, measure, i))
                        for i in range(len(phases))
                    ],
                    style,
                    marks=True,
                )
                for style, name in enumerate(ESTIMATORS)
            ],
            log_y=True,
            y_limits=LIMITS,
            categories=list(phases),
        )
        for measure, label in MEASURES.items()
    ]
    caption = f"Medians over the seeds in every phase of the servo runs. {NAMES}"
    return Shown(
        "accuracy-phases",
        "IV-B",
        caption,
        table.settings.seeds,
        Figure("Accuracy by phase", panels, columns=2),
    )


def _poses(table: Table) -> Shown:
    places = {
        "near": f"within {table.settings.around:g} mm of the way",
        "workspace": "anywhere in the picture",
    }
    panels = [
        Panel(
            "",
            f"error of the predicted markers [px]\n{words}",
            [
                _marks(
                    f"{noise:g} px of noise",
                    [table.known("servo", noise, name, key) for name in ESTIMATORS],
                    style,
                )
                for style, noise in enumerate(table.settings.noises)
            ],
            log_y=True,
            categories=[SHORT[name] for name in ESTIMATORS],
        )
        for key, words in places.items()
    ]
    caption = (
        "What every estimate knows of the camera after a servo run: the median distance of the "
        "predicted from the true "
        "markers at poses held out, for every seed. Flow goes on linearly from where it is. "
        f"{NAMES}"
    )
    figure = Figure("Poses never seen", panels, columns=2)
    return Shown("accuracy-poses", "IV-B, Proposition 1", caption, table.settings.seeds, figure)


EXPERIMENT = Experiment(
    name="jacobian-accuracy",
    title="Accuracy of the estimated Jacobian",
    about="The comparison of both estimators in IV-B: the same samples through every estimator, "
    "judged by the truth.",
    whole=Settings(),
    quick=Settings(
        seeds=(0,), noises=(NOISE,), duration=40.0, touring=25.0, learning=15.0, held_out=30
    ),
    tasks=tasks,
    chapter=chapter,
)
