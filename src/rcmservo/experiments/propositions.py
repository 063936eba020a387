"""Lemma 1, Propositions 1 and 2, and (33), as measurements: what each assumes, and what is left where that fails.

Lemma 1 and Proposition 1 are tried on noiseless pinhole cameras, Proposition 2 on the exact flow along a path before
a true camera, and (33) in closed loops with the printed gains, where the truth judges every frame.
"""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.charts import Figure, Panel, curve
from rcmservo.controller import potential_gradient, scaled
from rcmservo.estimators.flow import FlowEstimator, learn
from rcmservo.estimators.projection import (
    GAMMA_0,
    MAX_DECAY,
    ProjectionEstimator,
    decay,
    feature_jacobian,
    inverse_root,
    normal_equations,
)
from rcmservo.estimators.projection import predict as predict_markers
from rcmservo.experiments.claims import Chapter, Claim, Experiment, Results, Shown, Task
from rcmservo.experiments.closed_loop import LONG, NOISE, PRINTED_FIT, PRINTED_LAW, WIDE, servo_for
from rcmservo.features import SCALE, difference, features
from rcmservo.loop import Plant, Tick, run, teach
from rcmservo.mechanism import axis
from rcmservo.plant import Floats
from rcmservo.projection import PARAMETERS, parameters, project, regressor
from rcmservo.servo import Phase, State
from rcmservo.sim import Rig, RigSettings, SceneSettings
from rcmservo.tracking import PointMarkers

ERRORS = (float(np.radians(40.0)), -80.0, -60.0)
REGULATION = SceneSettings(errors=ERRORS, insertion=(40.0, 70.0), distance=(150.0, 400.0), room=17.0)
"""Scenes of the paper's regulation experiments."""

PINHOLE = SceneSettings(distortion=(0.0, 0.0))
RANK_TOLERANCE = 1e-9
"""Singular value over the largest, of M with columns of length 1, below which a direction is not observed."""

SETS = {
    "generic": "generic points",
    "coplanar": "points of a plane",
    "through": "points of a plane that holds the RCM",
}
NEAR = 0.1
"""Scaled ‖Ĵ − J‖/‖J‖ up to which a fitted Ĵ counts as near J."""

NEAR_UNITY = 0.3
"""‖J Ĵ⁻¹ − I‖₂ up to which J Ĵ⁻¹ counts as about I; 1 would be enough for a positive definite symmetric part."""

LONG_ENOUGH = 30.0
"""Time in units of the slowest mode's after which rule (21) is taken to have come to its end."""

GAINS = {"printed": "printed Γ", "fast": "our fast Γ"}
ESTIMATORS = {
    "projection": (PRINTED_FIT, WIDE),
    "flow": (FlowEstimator(gamma=0.001), LONG),
}


@dataclass(frozen=True)
class Settings:
    """``cameras`` are the seeds of Lemma 1 and Proposition 1, ``spread`` mm that of the P = ``observations`` points.

    Proposition 2: loops of these ``radii`` mm, at ``speeds`` mm/s, in steps of ``step`` mm over ``path`` mm, with γ =
    ``gamma``. (33): ``loop_seeds``, and a run's ``duration`` s.
    """

    cameras: tuple[int, ...] = tuple(range(20))
    points: int = 100
    spread: float = 20.0
    observations: int = 10
    printed_time: float = 1e4
    fast_time: float = 10.0
    longest: float = 1e5
    flow_seeds: tuple[int, ...] = (0, 1, 2, 3)
    radii: tuple[float, ...] = (3.0, 30.0)
    speeds: tuple[float, ...] = (1.0, 3.0, 10.0, 30.0, 100.0)
    gamma: float = 0.001
    step: float = 0.1
    path: float = 1000.0
    loop_seeds: tuple[int, ...] = (0, 1, 2, 3)
    duration: float = 150.0


def tasks(settings: Settings) -> list[Task]:
    cameras = [
        Task("lemma-1", lemma_1, {"settings": settings}),
        Task("proposition-1", proposition_1, {"settings": settings}, cost=3.0),
    ]
    flows = [Task(f"proposition-2-{seed}", proposition_2, {"settings": settings, "seed": seed}, cost=5.0)
             for seed in settings.flow_seeds]  # fmt: skip
    loops = [
        Task(f"{name}-{seed}", closed_loop, {"settings": settings, "estimator": name, "seed": seed}, cost=cost)
        for name, cost in (("projection", 6.0), ("flow", 10.0))
        for seed in settings.loop_seeds
    ]
    return cameras + flows + loops


# Lemma 1: the projection has nine degrees of freedom.


def camera(seed: int) -> tuple[Floats, Floats]:
    """The calibration matrix C (3, 4) of a drawn pinhole camera, at an arbitrary scale, and p₁ (3,) mm of its scene."""
    rig = Rig(seed, RigSettings(scene=PINHOLE), pictures=False)
    optics = rig.scene.optics
    K = np.array([[optics.focal, 0.0, optics.centre[0]], [0.0, optics.focal, optics.centre[1]], [0.0, 0.0, 1.0]])
    C = K @ np.column_stack([optics.rotation, -optics.rotation @ optics.position])
    return C * np.random.default_rng(seed).uniform(-2.0, 2.0), rig.body.points(rig.scene.start)[0]


def seen_by(C: Floats, p: Floats) -> Floats:
    """Raw pixels (2,) of the point p (3,) mm, eq. (4)."""
    m = C @ np.append(p, 1.0)
    return m[:2] / m[2]


def lemma_1(folder: Path, settings: Settings) -> dict[str, Any]:
    """What `nine_parameters` finds of every camera."""
    del folder
    return {str(seed): nine_parameters(settings, seed) for seed in settings.cameras}


def nine_parameters(settings: Settings, seed: int) -> dict[str, Any]:
    """How well a and o_c stand for C, and the scaled singular values of M for points that lie as `SETS` say."""
    C, p0 = camera(seed)
    a, o_c = parameters(C)
    random = np.random.default_rng([seed, 1])
    points = p0 + settings.spread * random.uniform(-1.0, 1.0, (settings.points, 3))
    errors = [np.linalg.norm(project(a, p) + o_c - seen_by(C, p)) for p in points]
    normal = random.standard_normal(3)
    normal /= np.linalg.norm(normal)
    flat = points - np.outer((points - p0) @ normal, normal)
    aside = normal - p0 * (normal @ p0) / (p0 @ p0)
    aside /= np.linalg.norm(aside)
    through = points - np.outer(points @ aside, aside)
    sets = {"generic": points, "coplanar": flat, "through": through}
    return {
        "reprojection": float(max(errors)),
        "five": singular_values(C, o_c, points[:5]),
        "six": {name: singular_values(C, o_c, some[:6]) for name, some in sets.items()},
        "all": {name: singular_values(C, o_c, some) for name, some in sets.items()},
    }


def singular_values(C: Floats, o_c: Floats, points: Floats) -> list[float]:
    """Singular values over the largest of M (24), its columns scaled to length 1, for the points (n, 3)."""
    M = np.concatenate([regressor(seen_by(C, p) - o_c, p) for p in points])
    sigma = np.linalg.svd(M / np.linalg.norm(M, axis=0), compute_uv=False)
    return (sigma / sigma[0]).tolist()


def rank(sigma: list[float]) -> int:
    return int(np.sum(np.array(sigma) > RANK_TOLERANCE))


# Proposition 1: U never rises along rule (21).


def proposition_1(folder: Path, settings: Settings) -> dict[str, Any]:
    """What `fall_of_U` finds of every camera."""
    del folder
    return {str(seed): fall_of_U(settings, seed) for seed in settings.cameras}


def fall_of_U(settings: Settings, seed: int) -> dict[str, Any]:
    """U/U(0) along rule (21) from â = 0, without noise, and what is reached after some estimator time."""
    C, p0 = camera(seed)
    a, o_c = parameters(C)
    random = np.random.default_rng([seed, 2])
    points = p0 + settings.spread * random.uniform(-1.0, 1.0, (settings.observations, 3))
    rows = np.array([[*p, *seen_by(C, p), np.nan, np.nan] for p in points])
    tool = RigSettings().tool
    A, b = normal_equations(rows, len(rows), o_c, False, tool.kind, tool.value)
    fast = ProjectionEstimator()
    roots = {"printed": np.diag(np.sqrt(GAMMA_0)), "fast": np.sqrt(fast.rate) * inverse_root(A, fast.epsilon)}
    longest = {"printed": settings.longest, "fast": MAX_DECAY / fast.rate}
    late = {"printed": settings.printed_time, "fast": settings.fast_time}
    values: dict[str, Any] = {}
    for name, root in roots.items():
        rates = np.linalg.eigvalsh(root.T @ A @ root)
        time = np.concatenate([[0.0], np.geomspace(1e-4, longest[name], 200)])
        moments = [*time, late[name], LONG_ENOUGH / rates[0]]
        *a_hats, a_late, a_end = [decay(A, b, np.zeros(PARAMETERS), root, t) for t in moments]
        U = np.array([0.5 * np.sum(np.linalg.solve(root, a_hat - a) ** 2) for a_hat in a_hats])
        values[name] = {
            "time": time.tolist(),
            "U": (U / U[0]).tolist(),
            "rise": float(max(np.max(np.diff(U)) / U[0], 0.0)),
            "reprojection": float(max(np.linalg.norm(project(a_late, p) - project(a, p)) for p in points)),
            "jacobian": jacobian_error(a_late, a, p0),
            "end": jacobian_error(a_end, a, p0),
            "slowest": float(rates[0]),
        }
    return values


def jacobian_error(a_hat: Floats, a: Floats, p1: Floats) -> float:
    """‖Ĵ − J‖/‖J‖ (Frobenius) of the scaled Jacobians at p1, from â and from the true a."""
    tool = RigSettings().tool
    m = predict_markers(a, p1, tool.kind, tool.value)
    J_hat, J = (scaled(feature_jacobian(some, p1, m, tool.kind, tool.value)) for some in (a_hat, a))
    return float(np.linalg.norm(J_hat - J) / np.linalg.norm(J))


# Proposition 2: R along the flow rule (28).


@dataclass(frozen=True)
class Way:
    """One round of a closed path: steps ``dp`` (n, 3) mm, their ``dy`` (n, 3), and ``J`` (n, 3, 3) at their ends."""

    dp: Floats
    dy: Floats
    J: Floats
    J_start: Floats


def loop_way(rig: Rig, radius: float, step: float) -> Way:
    """A closed curve in all three directions about the scene's start, through the true camera."""
    p0, n = rig.body.points(rig.scene.start)[0], axis(rig.settings.mechanism.kind, rig.scene.start)
    t1 = np.linalg.svd(n[None])[2][1]
    t2 = np.cross(n, t1)
    turn = np.linspace(0.0, 2.0 * np.pi, round(11.0 * radius / step) + 1)
    directions = np.outer(np.cos(turn), t1) + np.outer(np.sin(turn), t2) + np.outer(np.cos(2.0 * turn), n)
    p = p0 + radius * directions
    joints = [rig.body.kinematics.joints(one) for one in p]
    o_c = rig.truth.imaged_rcm()
    y = [features((rig.truth.pixels(q) - o_c).ravel()) for q in joints]
    J = np.array([rig.truth.jacobian(q, o_c) for q in joints])
    dy = np.array([difference(after, before) for before, after in pairwise(y)])
    return Way(np.diff(p, axis=0), dy, J[1:], J[0])


def proposition_2(folder: Path, settings: Settings, seed: int) -> dict[str, Any]:
    """R/R(0) over the path, its rises, at every speed; for both loops, and with a Jacobian that does not change."""
    del folder
    values: dict[str, Any] = {}
    for radius in settings.radii:
        rig = Rig(seed, RigSettings(), pictures=False)
        way = loop_way(rig, radius, settings.step)
        change = (way.J - way.J_start) / SCALE[:, None]
        values[f"{radius:g}"] = {
            "change": float(np.max(np.linalg.norm(change, axis=(1, 2))) / np.linalg.norm(scaled(way.J_start))),
            "speeds": {f"{speed:g}": fall_of_R(way, settings, speed) for speed in settings.speeds},
        }
        constant = Way(way.dp, way.dp @ way.J_start.T, np.broadcast_to(way.J_start, way.J.shape), way.J_start)
        values[f"{radius:g}"]["constant"] = max(
            fall_of_R(constant, settings, speed)["rise"] for speed in settings.speeds
        )
    return values


def fall_of_R(way: Way, settings: Settings, speed: float) -> dict[str, Any]:
    """R_i (29) over `path` mm of rounds at a constant speed (mm/s), from Ĵ = 0.

    ``R`` is the mean over i of R_i/R_i(0); ``share`` the share of steps in which R_i rises; ``rise`` how far it gets
    above its running minimum, in R_i(0), at most.
    """
    lengths: Floats = np.linalg.norm(way.dp, axis=1)
    count = round(settings.path / float(np.mean(lengths)))
    J_hat, along = np.zeros((3, 3)), [0.0]
    R: list[Floats] = [np.sum(way.J_start**2, axis=1)]
    for k in range(count):
        i = k % len(lengths)
        J_hat = learn(J_hat, way.dp[i], way.dy[i], lengths[i] / speed, settings.gamma)
        R.append(np.sum((J_hat - way.J[i]) ** 2, axis=1))
        along.append(along[-1] + float(lengths[i]))
    ratio: Floats = np.array(R) / R[0]
    rises: Floats = np.diff(ratio, axis=0)
    thin = slice(None, None, max(1, count // 400))
    return {
        "path": along[thin],
        "R": ratio.mean(axis=1)[thin].tolist(),
        "share": float(np.mean(rises > 0.0)),
        "rise": float(np.max(ratio - np.minimum.accumulate(ratio, axis=0))),
        "end": float(ratio[-1].mean()),
    }


# (33): V falls if the symmetric part of J Ĵ⁻¹ is positive definite.


def closed_loop(folder: Path, settings: Settings, estimator: str, seed: int) -> dict[str, Any]:
    """A regulation with the printed gains, judged in every frame while it servoes to the target.

    The flow rule explores half-way, is then servoed to the start, and from there to the target.
    """
    del folder
    rig = Rig(seed, RigSettings(scene=REGULATION, point_noise=NOISE), pictures=False)
    plant = Plant(rig.mechanism, rig.camera, PointMarkers(), rig.clock)
    servo = servo_for(rig, *ESTIMATORS[estimator])
    servo.warm_up()
    home = teach(plant)
    rig.show_target()
    target = teach(plant)
    state = None
    if estimator == "flow":
        rig.place(rig.scene.half_way)
        for tick in run(plant, servo, home, 2.0 * settings.duration, done=arrived):
            state = tick.state
    else:
        rig.go_home()
    frames: list[list[float]] = []
    seen, cause = -1, ""
    for tick in run(plant, servo, target, settings.duration, done=arrived, state=state):
        cause = tick.state.cause.value
        if tick.state.phase is Phase.SERVO and tick.state.frame > seen:
            seen = tick.state.frame
            frames.append([tick.time / 1e9, *judge(rig, tick.state, tick.seen.q_exposure)])
    return {"frames": frames, "cause": cause, "arrived": bool(frames) and frames[-1][3] < 1.0}


def arrived(tick: Tick) -> bool:
    """Whether the newest frame shows the target within three times the noise; asked from the second second on, when
    the error is no more that of a stage before."""
    return tick.time > 1e9 and tick.state.explored and in_noise(tick.state) < 1.0


def in_noise(state: State) -> float:
    """The largest component of Δy over three times the noise that one frame has in it."""
    d = state.y[2]
    noise = NOISE * np.array([np.sqrt(2.0) / d, 1.0, np.sqrt(2.0)])
    return float(np.max(np.abs(state.delta) / (3.0 * noise)))


def judge(rig: Rig, state: State, q: Floats) -> list[float]:
    """λ_min of the symmetric part of J Ĵ⁻¹, V̇ of the velocity commanded, |Δy| over 3 x its noise, and ‖J Ĵ⁻¹ − I‖₂.

    All scaled: V in units of (10°, 10 px, 10 px)². J is the true one where the frame was exposed.
    """
    J, J_hat = scaled(rig.truth.jacobian(q, state.o_c)), scaled(state.J_hat)
    closed = J @ np.linalg.inv(J_hat)
    least = np.linalg.eigvalsh(0.5 * (closed + closed.T))[0]
    gradient = potential_gradient(state.delta / SCALE, PRINTED_LAW.b / SCALE, False)
    return [float(least), float(gradient @ J @ state.v), in_noise(state), float(np.linalg.norm(closed - np.eye(3), 2))]


def chapter(settings: Settings, results: Results) -> Chapter:
    claims = [
        *_lemma_1_claims(settings, results["lemma-1"].values),
        *_proposition_1_claims(settings, results["proposition-1"].values),
        *_proposition_2_claims(settings, results),
        *_stability_claims(settings, results),
    ]
    figures = [
        _rank_figure(settings, results["lemma-1"].values),
        _U_figure(settings, results["proposition-1"].values),
        _R_figure(settings, results),
        _stability_figure(settings, results),
    ]
    return Chapter(claims, figures)


def _lemma_1_claims(settings: Settings, values: dict[str, Any]) -> list[Claim]:
    seeds = settings.cameras
    six, whole = ({name: [rank(one[key][name]) for one in values.values()] for name in SETS} for key in ("six", "all"))
    five = [rank(one["five"]) for one in values.values()]
    return [
        Claim(
            "a camera that sees an RCM mechanism is known by nine parameters a and o_c: they give the pixels of C",
            "Lemma 1", max(one["reprojection"] for one in values.values()), "px", "<=", 1e-6, seeds,
            detail=f"largest of {settings.points} points each before {len(seeds)} drawn cameras without distortion",
        ),
        Claim(
            "the nine parameters are independent: M has rank 9 for six points in general position",
            "Lemma 1, (24)", min(six["generic"]), "rank", ">=", PARAMETERS, seeds,
            detail=f"least over {len(seeds)} cameras, with columns scaled to length 1", figure="rank",
        ),
        Claim(
            "P ≥ 6 observations are needed: five leave the rank of M below 9",
            "III-B", max(five), "rank", "<=", PARAMETERS - 1, seeds,
            remark=f"five points in general position give rank {min(five)} in every camera: ten equations for nine "
            "unknowns",
            figure="rank", trap="T9", confirmed=min(five) == PARAMETERS,
        ),
        Claim(
            "six non-collinear observations give M full column rank",
            "Proposition 1, (25)", min(six["coplanar"]), "rank", ">=", PARAMETERS, seeds,
            remark=f"points of one plane are not collinear and leave rank {max(six['coplanar'])}, and rank "
            f"{max(six['through'])} if the plane holds the RCM; {settings.points} of them do no better "
            f"(rank {max(whole['coplanar'])} and {max(whole['through'])})",
            figure="rank", trap="T9", confirmed=max(six["coplanar"]) < PARAMETERS,
        ),
    ]  # fmt: skip


def _proposition_1_claims(settings: Settings, values: dict[str, Any]) -> list[Claim]:
    seeds = settings.cameras
    printed, fast = ([one[name] for one in values.values()] for name in GAINS)
    late = [one["jacobian"] for one in printed]
    slowest = [1.0 / one["slowest"] for one in printed]
    bad = sum(error > NEAR for error in late)
    about = (
        f"P = {settings.observations} noiseless observations of marker 1 within ±{settings.spread:g} mm before each of "
        f"{len(seeds)} cameras"
    )
    return [
        Claim(
            "U of (22) never rises along rule (21), with the printed Γ",
            "Proposition 1, (23)", max(one["rise"] for one in printed), "of U(0)", "<=", 1e-9, seeds,
            detail=f"largest rise between 200 moments up to {settings.longest:g} s; {about}", figure="U",
        ),
        Claim(
            "U never rises with our fast Γ either",
            "ours", max(one["rise"] for one in fast), "of U(0)", "<=", 1e-9, seeds, figure="U",
        ),
        Claim(
            "rule (21) asymptotically estimates a, so that Ĵ tends to J, with the printed Γ",
            "Proposition 1", max(one["end"] for one in printed), "‖Ĵ − J‖/‖J‖", "<=", 1e-6, seeds,
            remark=f"very slowly: the slowest mode's time constant is {np.median(slowest) / 3600.0:.1f} h in the "
            f"median camera and {max(slowest) / 3600.0:.0f} h in the worst; judged after {LONG_ENOUGH:g} of them",
            figure="U", trap="T6", confirmed=float(np.median(slowest)) > 600.0,
        ),
        Claim(
            f"{settings.printed_time:g} s of estimator time, which we give the printed Γ for a fit, bring Ĵ within "
            f"{100.0 * NEAR:g} % of J",
            "ours", max(late), "‖Ĵ − J‖/‖J‖", "<=", NEAR, seeds,
            remark=f"worse in {bad} of {len(late)} cameras" if bad else "",
            detail=f"{np.median(late):.3f} in the median, where the projection of the observations is off by "
            f"{np.median([one['reprojection'] for one in printed]):.1f} px at most",
            figure="U", trap="T6", confirmed=max(late) > 10.0 * max(one["jacobian"] for one in fast),
        ),
        Claim(
            f"with our fast Γ {settings.fast_time:g} s bring Ĵ within {100.0 * NEAR:g} % of J",
            "ours", max(one["jacobian"] for one in fast), "‖Ĵ − J‖/‖J‖", "<=", NEAR, seeds, figure="U",
        ),
    ]  # fmt: skip


def _proposition_2_claims(settings: Settings, results: Results) -> list[Claim]:
    seeds = settings.flow_seeds
    small, large = (f"{radius:g}" for radius in (settings.radii[0], settings.radii[-1]))
    slow, fast = (f"{speed:g}" for speed in (settings.speeds[0], settings.speeds[-1]))
    runs = [results[f"proposition-2-{seed}"].values for seed in seeds]

    def over_seeds(loop: str, speed: str, key: str) -> list[float]:
        return [one[loop]["speeds"][speed][key] for one in runs]

    def worst(loop: str, key: str) -> dict[str, float]:
        return {f"{speed:g}": max(over_seeds(loop, f"{speed:g}", key)) for speed in settings.speeds}

    shares = {f"{speed:g}": float(np.mean(over_seeds(small, f"{speed:g}", "share"))) for speed in settings.speeds}
    rises, wide = worst(small, "rise"), worst(large, "rise")
    change = {loop: max(one[loop]["change"] for one in runs) for loop in (small, large)}
    left = {speed: float(np.median(over_seeds(small, speed, "end"))) for speed in shares}
    ratio = float(np.median([one[large]["speeds"][slow]["rise"] / one[small]["speeds"][slow]["rise"] for one in runs]))
    return [
        Claim(
            "where J is constant, R_i of (29) never rises along the flow rule (28)",
            "Proposition 2, (30)", max(one[loop]["constant"] for one in runs for loop in (small, large)),
            "of R_i(0)", "<=", 1e-12, seeds,
            detail=f"at {slow} to {fast} mm/s along loops of {small} and {large} mm radius",
        ),
        Claim(
            f"for slow and continuous motion R_i never rises: at {slow} mm/s on a loop of {small} mm radius",
            "Proposition 2, (30)", shares[slow], "share of steps", "<=", 0.01, seeds,
            remark=f"J changes by up to {100.0 * change[small]:.0f} % along that loop, and R_i follows it up and down, "
            f"by up to {rises[slow]:.2f} R_i(0) above its running minimum",
            detail="share of the steps in which an R_i rises, by speed in mm/s: " + listed(shares, ".2f"),
            figure="R", trap="T7",
        ),
        Claim(
            f"the slower the motion, the less R_i rises: {slow} mm/s against {fast} mm/s",
            "Proposition 2, \"slow\"", rises[slow] / rises[fast], "ratio of the largest rises", "<=", 1.0, seeds,
            remark="over a length of path J changes by the same at any speed, while what is learnt grows with γ v: "
            "slow motion makes it worse",
            detail=f"largest rise in R_i(0), by speed in mm/s: {listed(rises, '.2f')}; on the large loop "
            f"{listed(wide, '.2f')}",
            figure="R", trap="T7", confirmed=rises[slow] > rises[fast],
        ),
        Claim(
            "what makes R_i rise is how much J changes along the path: it rises at least three times as far on the "
            f"loop of {large} mm as on that of {small} mm",
            "ours", ratio, "ratio", ">=", 3.0, seeds,
            detail=f"median over seeds at {slow} mm/s; J changes by up to {100.0 * change[large]:.0f} % and "
            f"{100.0 * change[small]:.0f} %",
            figure="R",
        ),
        Claim(
            f"the flow rule with γ = {settings.gamma:g} computes J in real time at {slow} mm/s: after "
            f"{settings.path / 1000.0:g} m of path a tenth of R is left",
            "IV-B", left[slow], "R/R(0)", "<=", 0.1, seeds,
            remark="it learns by 1 − exp(−γ v L), so that slow motion hardly teaches",
            detail=f"median on the loop of {small} mm, by speed in mm/s: {listed(left, '.2g')}",
            figure="R", trap="T7", confirmed=left[slow] > 0.1,
        ),
    ]  # fmt: skip


def listed(values: dict[str, float], form: str) -> str:
    """ "1: 0.5, 3: 0.4" of numbers by name."""
    return ", ".join(f"{name}: {value:{form}}" for name, value in values.items())


def _stability_claims(settings: Settings, results: Results) -> list[Claim]:
    return [claim for name in ESTIMATORS for claim in _stability_of(settings, results, name)]


def judged_frames(settings: Settings, results: Results, estimator: str) -> list[Floats]:
    """Per seed the rows [time, λ_min, V̇, |Δy| over 3 x noise, ‖J Ĵ⁻¹ − I‖₂] of frames that show an error."""
    runs = [results[f"{estimator}-{seed}"].values["frames"] for seed in settings.loop_seeds]
    frames = [np.array(run, dtype=float).reshape(-1, 5) for run in runs]
    return [rows[rows[:, 3] > 1.0] for rows in frames]


def _stability_of(settings: Settings, results: Results, name: str) -> list[Claim]:
    seeds = settings.loop_seeds
    runs = judged_frames(settings, results, name)
    share = min(float(np.mean(rows[:, 2] <= 0.0)) for rows in runs)
    least = min(float(rows[:, 1].min()) for rows in runs)
    off = [float(np.median(rows[:, 4])) for rows in runs]
    values = [results[f"{name}-{seed}"].values for seed in seeds]
    there = sum(one["arrived"] for one in values)
    causes = [f"seed {seed}: {one['cause']}" for seed, one in zip(seeds, values, strict=True) if one["cause"]]
    about = f"{name}-based estimator with the printed gains"
    detail = (
        f"least over {len(runs)} runs, of which {there} arrived; {sum(map(len, runs))} frames with an error above "
        "three times the noise"
    )
    positive = least > 0.0
    return [
        Claim(
            f"V falls: V̇ ≤ 0 in every frame of a regulation ({about})",
            "(33)", share, "share of frames", ">=", 0.99, seeds,
            detail="; ".join([detail, *causes]), figure="stability",
        ),
        Claim(
            f"J Ĵ⁻¹ ≈ I, as (33) assumes ({about})",
            "III-D", max(off), "‖J Ĵ⁻¹ − I‖₂", "<=", NEAR_UNITY, seeds,
            remark="" if max(off) <= NEAR_UNITY else f"{there} of {len(runs)} runs arrived all the same: "
            "positive definite is enough",
            detail="medians of the runs: " + ", ".join(f"{one:.2f}" for one in off),
            figure="stability", trap="T15", confirmed=positive and share >= 0.99,
        ),
        Claim(
            f"the symmetric part of J Ĵ⁻¹ is positive definite in every frame ({about})",
            "ours", least, "λ_min", ">=", 0.0, seeds, detail=detail, figure="stability", trap="T15", confirmed=positive,
        ),
    ]  # fmt: skip


def _rank_figure(settings: Settings, values: dict[str, Any]) -> Shown:
    seed = settings.cameras[0]
    number = np.arange(1, PARAMETERS + 1)
    rows = {"five generic points": values[str(seed)]["five"]}
    rows |= {f"six {label}": values[str(seed)]["six"][name] for name, label in SETS.items()}
    curves = [curve(label, number + 0.12 * (style - 1.5), np.maximum(sigma, 1e-18), style, marks=True)
              for style, (label, sigma) in enumerate(rows.items())]  # fmt: skip
    panel = Panel("number of the singular value", "$\\sigma_i / \\sigma_1$ of M", curves, log_y=True,
                  levels=[("not observed below this", RANK_TOLERANCE)])  # fmt: skip
    caption = (
        "Singular values of M (24), its columns scaled to length 1, for points that lie in general position, in a "
        "plane, and in a plane that holds the RCM. Each that is zero is a direction of a that was not observed."
    )
    return Shown("rank", "Proposition 1, (25)", caption, [seed], Figure("What observations tell of a", [panel]))


def _U_figure(settings: Settings, values: dict[str, Any]) -> Shown:
    shown = settings.cameras[:5]
    curves = [
        curve(label if seed == shown[0] else "", values[str(seed)][name]["time"][1:],
              np.maximum(values[str(seed)][name]["U"][1:], 1e-12), style)
        for style, (name, label) in enumerate(GAINS.items())
        for seed in shown
    ]  # fmt: skip
    panel = Panel("estimator time [s]", "U(t) / U(0)", curves, log_x=True, log_y=True, y_limits=(1e-9, 3.0))
    caption = (
        f"U of (22) along rule (21) from â = 0, P = {settings.observations} noiseless observations of marker 1 before "
        f"{len(shown)} cameras. Each U is measured by its own Γ, so that only the falls compare."
    )
    return Shown("U", "Proposition 1, (22)-(23)", caption, list(shown), Figure("Proposition 1", [panel]))


def _R_figure(settings: Settings, results: Results) -> Shown:
    seed = settings.flow_seeds[0]
    values = results[f"proposition-2-{seed}"].values
    panels: list[Panel] = []
    for i, radius in enumerate(settings.radii):
        loops = values[f"{radius:g}"]["speeds"]
        curves = [
            curve(f"{speed:g} mm/s" if i else "", loops[f"{speed:g}"]["path"], loops[f"{speed:g}"]["R"], style)
            for style, speed in enumerate(settings.speeds)
        ]
        panels.append(Panel(f"path [mm], loop of {radius:g} mm radius", "R / R(0)", curves, log_y=True))
    caption = (
        f"Mean over i of R_i/R_i(0), R_i of (29), along the flow rule (28) from Ĵ = 0 with γ = {settings.gamma:g}, "
        "without noise, round and round two loops at five speeds."
    )
    return Shown("R", "Proposition 2, (29)-(30)", caption, [seed], Figure("Proposition 2", panels, columns=2))


def _stability_figure(settings: Settings, results: Results) -> Shown:
    rows = {name: judged_frames(settings, results, name)[0] for name in ESTIMATORS}
    parts = {1: "$\\lambda_{min}$, sym. J Ĵ⁻¹", 2: "V̇ [1/s]", 4: "‖J Ĵ⁻¹ − I‖"}
    panels = [
        Panel("time [s]", label, [curve(f"{name}-based" if column == 1 else "", some[:, 0], some[:, column], style)
                                  for style, (name, some) in enumerate(rows.items())],
              levels=[] if column == 4 else [("", 0.0)])
        for column, label in parts.items()
    ]  # fmt: skip
    caption = (
        "The loop on its way to the target, judged with the true J: the smallest eigenvalue of the symmetric part of "
        "J Ĵ⁻¹ (stable if positive), the slope of V under the velocity commanded, and how far J Ĵ⁻¹ is from I. "
        "All scaled to 10°, 10 px, 10 px."
    )
    seeds = [settings.loop_seeds[0]]
    return Shown("stability", "(33)", caption, seeds, Figure("Stability along a regulation", panels))


EXPERIMENT = Experiment(
    name="propositions",
    title="Lemma 1, Propositions 1 and 2, stability",
    about="The paper's proofs, with what they assume, as measurements.",
    whole=Settings(),
    quick=Settings(cameras=(0, 1, 2), flow_seeds=(0,), step=0.5, loop_seeds=(0,)),
    tasks=tasks,
    chapter=chapter,
)
