"""Comparison with other methods: same scene, target and noise, and intervals of the statistics."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from conftest import mark_others_slow
from rcmservo.control.exploration import Exploration
from rcmservo.estimation.projection_rule import ProjectionEstimator
from rcmservo.figures import charts
from rcmservo.paper import baselines_claims
from rcmservo.paper.baselines_claims import SCENE, SCENE_KINDS, SCENES
from rcmservo.paper.claims import ClaimRow, judge
from rcmservo.paper.lab.method_statistics import MethodStatistics, summarise_runs
from rcmservo.paper.lab.methods import COMPARED_METHODS, FAST, EstimatingMethod, UserEstimatorMethod
from rcmservo.paper.lab.scene_run import Attempt
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, TaskResult
from rcmservo.paper.store import from_json, to_json
from rcmservo.safety.causes import Cause
from rcmservo.study.plan.conditions import COMPILED, MUJOCO
from rcmservo.study.report import statistics
from rcmservo.study.row import compute_worst_condition
from rcmservo.study.run_outcome import StudyRun
from rcmservo.study.simulation_engine import SimulationEngine, SimulationLoop
from rcmservo.study.trial import draw_trial

DURATION = 4.0
LABORATORY = baselines_claims.laboratory(SCENE)
SEED = 3
FAILING_METHOD = "image-rolled"
"""Method with an outdated calibration, which must fail."""


def attempt(seed: int = SEED, duration: float = DURATION, noise: float = 0.3) -> Attempt:
    return Attempt(seed, replace(LABORATORY, point_noise=noise), duration)


class Renamed(ProjectionEstimator):
    """Estimator without a compiled function, which runs on the live path."""


@pytest.mark.parametrize(
    "name", mark_others_slow(sorted(COMPARED_METHODS, key=lambda name: name != "default"))
)
def test_every_method_moves_and_arrives_in_most_accepted_scenes(name: str) -> None:
    runs = [COMPARED_METHODS[name].run(attempt(seed, noise=0.1)) for seed in range(3)]
    moved = [float(np.ptp(run.error)) for run in runs]
    assert min(moved) > 5.0
    arrived = sum(run.pose_error < 1.0 for run in runs)
    assert arrived == 0 if name == FAILING_METHOD else arrived >= 2


@pytest.mark.slow
@pytest.mark.parametrize(("reach", "seeds"), [(8.0, range(5)), (16.0, range(5, 10))])
@pytest.mark.parametrize("name", ["nflow", "rls", "kalman", "correntropy"])
def test_every_estimator_from_displacements_works(name: str, reach: float, seeds: range) -> None:
    """The comparison is fair only if the other methods work with its noise."""
    method = COMPARED_METHODS[name]
    assert isinstance(method, EstimatingMethod) and method.exploration == Exploration()
    adapted = replace(
        method, exploration=Exploration(leg_time=0.15 * reach / 8.0, max_leg_length=reach)
    )
    runs = [adapted.run(attempt(seed, 4.0)) for seed in seeds]
    assert sum(run.pose_error <= 1.0 for run in runs) >= 4
    assert np.median([run.pose_error for run in runs]) < 0.5


@pytest.mark.slow
def test_methods_with_the_same_settings_give_identical_runs() -> None:
    same = EstimatingMethod("by another name", "another", ProjectionEstimator(), Exploration())
    one, other, live = (
        method.run(attempt()) for method in (FAST, same, replace(same, estimator=Renamed()))
    )
    assert (one.engine, other.engine, live.engine) == (COMPILED, COMPILED, MUJOCO)
    np.testing.assert_array_equal(one.error, other.error)
    assert len(live.error) == len(one.error)
    np.testing.assert_allclose(live.error, one.error, atol=1e-3)


@pytest.mark.slow
def test_the_noise_and_the_target_of_a_seed_reach_every_engine_and_law(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A run depends on the trial of its seed; another trial gives another run."""
    given = draw_trial(SEED, 0, LABORATORY, 30.0, 30)
    other = draw_trial(SEED, 1, LABORATORY, 30.0, 30)
    assert given.scene.start == pytest.approx(other.scene.start)
    for name in ("default", "constant", "points-exact", "pose-exact"):
        before = COMPARED_METHODS[name].run(attempt()).error
        path = "rcmservo.study.trial.draw_trial"
        monkeypatch.setattr(path, lambda seed, _, *rest: draw_trial(seed, 1, *rest))
        assert not np.array_equal(before, COMPARED_METHODS[name].run(attempt()).error), name
        monkeypatch.undo()
        np.testing.assert_array_equal(before, COMPARED_METHODS[name].run(attempt()).error)


@pytest.mark.parametrize("name", mark_others_slow(["default", "fast", "printed"]))
def test_the_compiled_and_the_live_path_agree_on_a_method(name: str) -> None:
    method, one_attempt = COMPARED_METHODS[name], attempt()
    assert isinstance(method, EstimatingMethod)
    servo = one_attempt.servo(method.estimator, method.exploration, method.controller)
    one, other = one_attempt.run(servo), one_attempt.run_live(servo)
    assert (one.engine, other.engine) == (COMPILED, MUJOCO)
    assert len(one.error) == len(other.error)
    assert one.explored == other.explored
    np.testing.assert_allclose(one.error, other.error, atol=1e-3)
    np.testing.assert_array_equal(one.phases, other.phases)
    assert np.isnan(one.jacobian_error) and 0.0 < other.jacobian_error < 0.5


def test_every_method_has_the_same_time_after_its_exploration() -> None:
    for name in ("default", "printed", "constant", "pose-exact"):
        run = COMPARED_METHODS[name].run(attempt())
        after = len(run.error) / run.rate - run.explored
        assert after == pytest.approx(DURATION), name
    assert COMPARED_METHODS["pose-exact"].run(attempt()).explored == 0.0


def test_a_run_that_only_an_operator_can_resume_ends_early_at_rest() -> None:
    run = COMPARED_METHODS[FAILING_METHOD].run(attempt(duration=8.0))
    assert run.held.stop_sentence
    assert len(run.error) < 100 * 8.0
    assert np.ptp(run.error[-100:]) < 1e-3


def test_the_run_of_an_unfinished_loop_is_the_beginning_of_the_whole_run() -> None:
    one_attempt = attempt()
    servo = one_attempt.servo(FAST.estimator, FAST.exploration)
    laboratory = SimulationEngine(servo, one_attempt.settings, 2.0)
    loop, whole = SimulationLoop(laboratory, SEED, 0), laboratory.run(SEED)
    for _, _tick in zip(range(50), loop.ticks(), strict=False):
        pass
    np.testing.assert_array_equal(loop.outcome.error, whole.error[: len(loop.outcome.error)])
    assert len(loop.outcome.error) in (50, 51)
    cut = whole.until(0.5)
    assert len(cut.error) == len(cut.phases) == len(cut.causes) == 50
    assert len(whole.until(np.inf).error) == 200


def test_the_rejected_scenes_exceed_the_built_in_condition() -> None:
    for scenes in SCENE_KINDS:
        laboratory = baselines_claims.laboratory(SCENES[scenes])
        found = [
            compute_worst_condition(draw_trial(s, 0, laboratory, 1.0, 30).scene) for s in range(10)
        ]
        hard = [condition > SCENE.max_condition for condition in found]
        assert all(hard) if scenes == "rejected" else not any(hard)


def made(pose: list[float], within: list[float], held: list[str] | None = None) -> TaskResult:
    """Return the results of runs with certain pose errors and times."""
    n, known = len(pose), np.array(within, float)
    return dict(
        seeds=list(range(n)),
        engine=MUJOCO,
        pose=np.array(pose),
        within=known,
        explored=np.zeros(n),
        jacobian=np.full(n, np.nan),
        held=held or [""] * n,
        length=9.0,
        step=0.1,
        middle=np.ones(5),
    )


def test_intervals_are_those_of_the_statistics_of_studies() -> None:
    random = np.random.default_rng(0)
    poses, times = random.lognormal(-1.0, 1.0, (2, 40)), random.uniform(1.0, 5.0, (2, 40))
    times[0, :4] = np.nan
    one, other = (
        MethodStatistics("a", "a", made(p.tolist(), t.tolist()), 9.0)
        for p, t in zip(poses, times, strict=True)
    )
    arrived = poses <= 1.0
    never = np.where(np.isnan(times), 9.0, times)
    endless = np.where(np.isnan(times), np.inf, times)
    percent = 100.0 * np.array(statistics.estimate_fraction(int(arrived[0].sum()), 40))
    assert one.success == pytest.approx(percent)
    assert one.pose == statistics.estimate_quantile(poses[0], 0.5)
    assert one.time == statistics.estimate_quantile(endless[0], 0.5)
    assert one.later(other) == statistics.estimate_median_difference(never[0], never[1])
    expected = 100.0 * np.array(statistics.estimate_fraction_difference(arrived[0], arrived[1]))
    assert one.more_often(other) == pytest.approx(expected)
    ratio = np.exp(statistics.estimate_median_difference(np.log(poses[0]), np.log(poses[1])))
    assert one.times_as_far(other) == pytest.approx(ratio)
    assert ratio[0] == pytest.approx(np.exp(np.median(np.log(poses[0] / poses[1]))))


def test_the_results_of_a_run_are_those_of_the_study() -> None:
    study_runs = [FAST.run(attempt(seed)) for seed in range(3)]
    runs = summarise_runs(study_runs)
    assert runs["pose"].tolist() == [one.pose_error for one in study_runs]
    assert runs["within"].tolist() == [one.first_within(1.0) for one in study_runs]
    assert runs["explored"].tolist() == [one.explored for one in study_runs]
    assert runs["middle"][-1] < runs["middle"][0]
    stored = from_json(to_json(runs))
    assert stored["pose"].tolist() == runs["pose"].tolist() and np.isnan(stored["jacobian"]).all()


def test_the_cause_of_a_run_that_did_not_arrive_is_reported() -> None:
    n, stopped = 300, Cause.CAMERA_MOVED
    run = FAST.run(attempt())
    phases = np.full(n, 4, np.int8)
    causes = np.full(n, stopped.code, np.int8)
    held = StudyRun(0, 100.0, np.full(n, 5.0), phases, causes, 0.1, run.scene)
    tally = MethodStatistics("a", "a", summarise_runs([run, held]), 9.0)
    assert tally.failures == f"1 of 2 did not arrive: {stopped.stop_sentence}"
    assert "never" in f"{MethodStatistics('a', 'a', made([5.0] * 9, [np.nan] * 9), 9.0).summary}"


@cache
def chapter() -> tuple[list[Measurement], list[ClaimRow], list[PaperFigure]]:
    """Return measurements, claims and figures of two scenes, with a user-defined estimator."""
    own = UserEstimatorMethod("mylab:Own", "own", Renamed(), source="a hash")
    settings = Settings(accepted=2, rejected=2, draws=5, duration=1.0, own=own)
    names = [task.name for task in baselines_claims.tasks(settings)]
    found = {name: made([0.25, 1.5], [1.0, np.nan], ["", "held"]) for name in names}
    found["draws"] = {"conditions": np.array([1.0, 2.0, 50.0, 3.0, 4.0])}
    results = Results(found, {})
    measured = list(baselines_claims.measure(settings, results))
    rows = [judge("baselines", i, one, settings) for i, one in enumerate(measured)]
    return measured, rows, list(baselines_claims.draw(settings, results))


def test_every_number_over_scenes_lies_in_its_interval() -> None:
    measured, rows, _ = chapter()
    without = {one.claim for one in measured if not one.ends}
    assert without == {"flow-4-mm"}
    for one in measured:
        if one.ends:
            low, high = one.ends
            assert low - 1e-9 <= one.value <= high + 1e-9, one.claim
    pairs = [row for row in rows if "x the pose error" in row.unit]
    assert len(pairs) > 8
    assert all(re.search(r"\d\.\d\d \(\d\.\d\d to ∞\) mm", row.detail) for row in pairs)


def test_an_interval_formats_as_text() -> None:
    assert f"{statistics.Interval(0.123, 0.1, 0.2):.2f}" == "0.12 (0.10 to 0.20)"
    assert f"{statistics.Interval(2.0, 1.0, np.inf):.1f}" == "2.0 (1.0 to ∞)"
    assert f"{statistics.Interval(np.inf, 1.0, np.inf):.1f}" == "never (1.0 to ∞)"
    assert f"{statistics.Interval(-2.0, np.nan, 4.0):+.0f}" == "-2 (– to +4)"


def test_claims_and_figures_include_a_user_defined_estimator() -> None:
    _, rows, figures = chapter()
    assert sum("mylab:Own" in row.case for row in rows) == 4
    chart_of = {drawn.name: drawn.chart for drawn in figures}
    final = chart_of["baselines-final"]
    assert final is not None and "<svg" in charts.render_svg(final)
    for chart in chart_of.values():
        assert chart is not None
        panels = chart.panels
        assert all(not panel.categories or "own" in panel.categories for panel in panels)
