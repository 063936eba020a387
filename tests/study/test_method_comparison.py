"""`rs.compare`: any estimator or servo takes part, on the same plant, in the same scenes."""

import importlib
import re
import sys
from collections.abc import Generator, Iterable
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from studies import InProcessPool

import rcmservo as rs
from conftest import ROOT
from rcmservo.config.class_registry import ESTIMATORS, PRESETS
from rcmservo.errors import NotInstalled, RcmServoError
from rcmservo.study import MethodComparison, method_comparison
from rcmservo.study.execution.run_study import StudyExecution
from rcmservo.study.plan.file import StudyFile, make_plan

OWN = "02_own_estimator:RLS"
"""Estimator of a user: a plain Python class in a file outside the package."""

PROGRAM = """
study = rs.compare({"dlt": rs.DltEstimator(), "mine": MyEstimator()}, scenes=200)
print(study); study.to_pandas(); study.worst("mine").show()
"""
"""Program of a user who compares an estimator of their own with the default one."""


@pytest.fixture
def own_estimator(monkeypatch: pytest.MonkeyPatch) -> Generator[type[rs.Estimator]]:
    """Class of the estimator in `examples/02_own_estimator.py`."""
    monkeypatch.setattr(sys, "path", [*sys.path, str(ROOT / "examples")])
    module, _, name = OWN.partition(":")
    yield getattr(importlib.import_module(module), name)
    sys.modules.pop(module, None)


@pytest.fixture(scope="module")
def compiled() -> MethodComparison:
    """Two compiled methods in 20 scenes, in which some runs succeed and some do not."""
    return rs.compare({"dlt": "dlt", "rule": "projection"}, scenes=20, duration=2.5, workers=1)


def run_plan(methods: Iterable[str], own: type[rs.Estimator], folder: Path) -> list[dict[str, Any]]:
    """Return the rows of the same study as a plan of the command line."""
    request = StudyFile(methods=tuple(methods), count=1, duration=1.3)
    execution = StudyExecution(make_plan(request, {OWN: own}), folder)
    execution.run(InProcessPool(), lambda _: None)  # pyright: ignore[reportArgumentType]
    return execution.gather().to_pylist()


def test_every_estimator_takes_part_with_the_same_row_as_in_a_study_of_the_command_line(
    own_estimator: type[rs.Estimator], tmp_path: Path
) -> None:
    methods: dict[str, Any] = {name: name for name in (*ESTIMATORS, *PRESETS)}
    methods[OWN] = own_estimator()
    compared = rs.compare(methods, scenes=1, duration=1.3, workers=1)
    assert [row.method for row in compared.rows] == list(methods) and len(methods) > 10
    assert {row.engine for row in compared.rows} == {"mujoco"}
    assert [asdict(row) for row in compared.rows] == run_plan(methods, own_estimator, tmp_path)
    assert len(compared.rows[-1].source) == 64 and compared.rows[0].source == ""


def test_methods_run_on_the_compiled_plant_only_if_all_of_them_can() -> None:
    fast = rs.compare({"a": "dlt", "b": "projection"}, scenes=1, duration=1.1)
    mixed = rs.compare({"a": "dlt", "b": "rls"}, scenes=1, duration=1.1)
    assert [row.engine for row in fast.rows] == ["compiled"] * 2 and fast.engine == "compiled"
    assert [row.engine for row in mixed.rows] == ["mujoco"] * 2 and mixed.engine == "mujoco"
    assert "all methods on the mujoco engine" in str(mixed)


def test_rows_do_not_depend_on_the_number_of_processes_even_for_a_local_class(
    own_estimator: type[rs.Estimator],
) -> None:
    class Local(own_estimator):  # pyright: ignore[reportGeneralTypeIssues]
        """Estimator that no other process can import."""

    methods = {"dlt": rs.DltEstimator(), "mine": Local(forgetting=0.9)}
    alone, together = (
        rs.compare(methods, scenes=[7, 3, 5], duration=1.2, workers=n) for n in (1, 2)
    )
    assert alone.rows == together.rows
    assert [(row.method, row.seed) for row in alone.rows] == [
        (name, seed) for name in methods for seed in (7, 3, 5)
    ]


def test_a_seed_is_that_of_the_simulated_rig() -> None:
    settings = rs.sim.RigSettings(point_noise=0.0)
    compared = rs.compare({"dlt": "dlt"}, [11], settings, duration=1.1, workers=1)
    rig = rs.sim.Rig(11, settings)
    (row,) = compared.rows
    assert row.focal_px == rig.scene.optics.focal
    assert (row.seed, row.scenes, row.noise_px, row.bound_mm) == (11, "settings", 0.0, 0.0)


def test_a_servo_runs_with_its_own_settings(compiled: MethodComparison) -> None:
    law = rs.SaturatedController(gain=2.0)
    servo = rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0), controller=law)
    slow = rs.compare({"slow": servo}, scenes=5, duration=2.5, workers=1)
    assert all(
        slow_row.pose_error_mm > row.pose_error_mm
        for slow_row, row in zip(slow.rows, compiled.rows, strict=False)
    )


class NoEstimator:
    """Class with the members of an estimator, but not derived from one."""

    name = "none"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"methods": {}}, "methods must be a mapping of names to estimators or servos, such as"),
        ({"methods": rs.DltEstimator()}, "methods must be a mapping of names"),
        ({"methods": {3: "dlt"}}, "name of a method must be a text that is not empty, got 3"),
        ({"methods": {" ": "dlt"}}, "name of a method must be a text that is not empty"),
        ({"methods": {"a": "dtl"}}, "(did you mean dlt?)"),
        ({"methods": {"a": rs.DltEstimator}}, "methods['a'] must be an estimator, a servo or the"),
        ({"methods": {"a": rs.DltEstimator}}, "call the class, with () after its name"),
        ({"methods": {"a": NoEstimator()}}, "methods['a'] must be an estimator"),
        (
            {"methods": {"a": rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=29.0))}},
            "methods['a'].tool must be equal to that of the simulated laboratory",
        ),
        ({"scenes": 0}, "scenes must be a number of scenes from 1 to"),
        ({"scenes": True}, "scenes must be a number of scenes"),
        ({"scenes": 2.5}, "scenes must be a number of scenes"),
        ({"scenes": "200"}, "scenes must be a number of scenes"),
        ({"scenes": [1, 2, 1]}, "or different seeds such as range(10, 60)"),
        ({"scenes": [3, -1]}, "scenes must be a whole number from 0"),
        ({"settings": 3}, "settings must be None or the settings of a simulated laboratory"),
        ({"duration": 1.0}, "duration must be a time above 1"),
        ({"duration": np.nan}, "duration must be a time above 1"),
        ({"workers": 0}, "workers must be a whole number from 1"),
    ],
)
def test_an_invalid_argument_raises_one_sentence_that_names_it(
    arguments: dict[str, Any], message: str
) -> None:
    with pytest.raises(rs.BadInput) as raised:
        rs.compare(**{"methods": {"dlt": "dlt"}, **arguments})
    assert message in str(raised.value) and "\n" not in str(raised.value)


def test_an_estimator_that_fails_is_refused_before_any_run(
    own_estimator: type[rs.Estimator], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(method_comparison, "_run_scene", lambda *_: pytest.fail("it ran"))

    class Broken(own_estimator):  # pyright: ignore[reportGeneralTypeIssues]
        """Estimator whose Jacobian has an invalid shape."""

        def jacobian(self, memory: Any, tool: Any, sample: Any) -> Any:
            return np.zeros((2, 3))

    with pytest.raises(RcmServoError, match=r"its jacobian returned an array of shape \(2, 3\)"):
        rs.compare({"dlt": "dlt", "mine": Broken()})


def test_ctrl_c_keeps_the_complete_scenes(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(scenes: Iterable[Any], *arguments: Any, **options: Any) -> Generator[Any]:
        yield next(iter(scenes))
        raise KeyboardInterrupt

    monkeypatch.setattr(method_comparison, "track", interrupt)
    methods = {"dlt": "dlt", "rule": "projection"}
    study = rs.compare(methods, scenes=40, duration=1.1, workers=2)
    assert study.seeds == [0, 1] and len(study.rows) == 4
    assert "2 scenes, 1.1 s each" in str(study)
    assert "Ctrl-C ended the comparison before the other 38" in str(study)
    assert study.rows == rs.compare(methods, scenes=2, duration=1.1, workers=1).rows


def test_ctrl_c_before_the_first_scene_ends_with_an_interrupt(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupt(*arguments: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(method_comparison, "_run_scene", interrupt)
    with pytest.raises(KeyboardInterrupt):
        rs.compare({"dlt": "dlt"}, scenes=3)


def test_the_printed_table_holds_every_number_with_its_interval(
    compiled: MethodComparison,
) -> None:
    text = str(compiled)
    assert text.startswith("20 scenes, 2.5 s each, all methods on the compiled engine\nmedians")
    for summary in compiled.summaries:
        assert summary.runs == 20 and summary.method in text
        assert f"{summary.pose_median_mm.low:.3f} to {summary.pose_median_mm.high:.3f}" in text
        assert f"{100.0 * summary.success.low:.1f} to {100.0 * summary.success.high:.1f}" in text
        assert f"{summary.time_median_s.value:.2f}" in text
    assert {row.success for row in compiled.rows} == {True, False}
    rates = [np.mean([r.success for r in compiled.rows[i : i + 20]]) for i in (0, 20)]
    assert [summary.success.value for summary in compiled.summaries] == rates
    (difference,) = compiled.differences
    assert difference.success.value == pytest.approx(rates[1] - rates[0])
    assert re.search(r"^rule compared with dlt, random, 20 pairs: success", text, re.M)
    assert max(map(len, text.splitlines()[1:-1])) <= 100


def test_the_worst_run_opens_with_the_same_numbers(
    compiled: MethodComparison, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = compiled.rows[20:]
    worst, opened = compiled.worst("rule"), max(rows, key=lambda row: row.pose_error_mm)
    assert (worst.seed, worst.error) == (opened.seed, opened.pose_error_mm)
    assert worst.outcome.pose_error == worst.error and worst.cause != ""
    path = worst.show()
    printed = capsys.readouterr().out
    assert f"rule, seed {worst.seed}, compiled: no success" in printed
    assert f"{worst.error:.3f} mm" in printed and worst.cause in printed and str(path) in printed
    assert path.read_bytes().startswith(b"\x89PNG")
    (axis,) = worst.plot().axes
    assert axis.lines[0].get_ydata()[0] == pytest.approx(worst.row.start_error_mm, rel=1e-5)
    with pytest.raises(rs.BadInput, match=r"name must be one of dlt, rule \(did you mean rule\?\)"):
        compiled.worst("rul")


def test_any_run_opens_by_name_and_seed(compiled: MethodComparison) -> None:
    run = compiled.run("rule", 4)
    assert (run.seed, run.row) == (4, compiled.rows[24])
    assert run.outcome.pose_error == run.error
    with pytest.raises(rs.BadInput, match="seed must be one of the 20 seeds of the comparison"):
        compiled.run("rule", 20)


def test_the_figures_show_every_method_in_a_notebook_too(compiled: MethodComparison) -> None:
    times, errors = compiled.plot().axes
    for axis in (times, errors):
        assert [text.get_text() for text in axis.get_legend().get_texts()] == ["dlt", "rule"]
    page = rs.compare({"<b>": "dlt"}, scenes=1, duration=1.1)._repr_html_()
    assert "&lt;b&gt;" in page and "<b>" not in page and "<svg" in page
    assert "<svg" in compiled.worst("dlt")._repr_html_()


def test_the_program_of_a_user_runs(
    own_estimator: type[rs.Estimator],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Three scenes of 2 s instead of 200 of 15 s; a stand-in for pandas only if it is missing."""
    tables: list[list[dict[str, Any]]] = []
    try:
        import pandas  # noqa: F401  # pyright: ignore
    except ModuleNotFoundError:
        stand_in = SimpleNamespace(DataFrame=lambda rows, columns: tables.append(rows))
        monkeypatch.setitem(sys.modules, "pandas", stand_in)
    lines = PROGRAM.strip().splitlines()
    assert len(lines) == 2
    short = PROGRAM.replace("scenes=200", "scenes=3, duration=2.0")
    names: dict[str, Any] = {"rs": rs, "MyEstimator": own_estimator}
    exec(short, names)
    study, printed = names["study"], capsys.readouterr().out
    assert "mine compared with dlt, random, 3 pairs" in printed and "error over time: " in printed
    assert "3 scenes" in printed and study.worst("mine").error > 0.0
    assert all(table == [asdict(row) for row in study.rows] for table in tables)


def test_without_pandas_the_table_names_the_command_that_installs_it(
    compiled: MethodComparison, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(NotInstalled, match=r"pandas, which is not installed: run pip install -e"):
        compiled.to_pandas()
