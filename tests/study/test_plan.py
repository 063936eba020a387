"""What a study is to try: files and names become a plan, or one sentence."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcmservo.config import texts
from rcmservo.errors import RcmServoError
from rcmservo.estimation.dlt import DltEstimator
from rcmservo.estimation.projection_rule import PRINTED
from rcmservo.sim.scene import NoScene
from rcmservo.study.execution.chunk import one_run
from rcmservo.study.plan.cell import cell_from
from rcmservo.study.plan.conditions import COMPILED, MUJOCO, PICTURES
from rcmservo.study.plan.distribution import (
    BUILT_IN,
    Distribution,
    built_in,
    described,
    distribution_from,
)
from rcmservo.study.plan.file import StudyFile, load, plan_of
from rcmservo.study.plan.plan import StudyPlan

FILE = """
methods = ["dlt", "careful"]
scenes = ["random", "far"]
noise = [0.3, 1.0]
count = 20

[method.careful]
estimator = { kind = "projection", rate = 2.0 }
controller = { gain = 2.0 }

[distribution.far]
like = "random"
scene = { distance = [250.0, 400.0] }
vary = { "camera.delay" = [0.01, 0.05], "drive.encoder" = [[1e-5, 1e-5, 1e-3], [1e-4, 1e-4, 1e-2]] }
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "study.toml"
    path.write_text(text)
    return path


def planned(folder: Path, text: str, own: Any = None) -> StudyPlan:
    return plan_of(load(written(folder, text)), own or {})


def test_a_file_is_methods_times_scenes_times_conditions(tmp_path: Path) -> None:
    plan = planned(tmp_path, FILE)
    assert plan.runs == 2 * 2 * 2 * 20 == sum(len(chunk.seeds) for chunk in plan.chunks())
    names = [(cell.condition, cell.method) for cell in plan.cells]
    assert names[:3] == [
        ("random, 0.3 px", "dlt"),
        ("random, 0.3 px", "careful"),
        ("random, 1 px", "dlt"),
    ]
    careful = plan.methods[1]
    assert (careful.estimator.rate, careful.parts["controller"].gain) == (2.0, 2.0)  # pyright: ignore


def test_without_lists_all_that_a_file_describes_is_tried(tmp_path: Path) -> None:
    text = FILE.replace('methods = ["dlt", "careful"]\nscenes = ["random", "far"]\n', "")
    plan = planned(tmp_path, text)
    assert [m.name for m in plan.methods] == ["careful"]
    assert [s.name for s in plan.scenes] == ["far"]
    usual = planned(tmp_path, "count = 3")
    assert [type(m.estimator) for m in usual.methods] == [DltEstimator]
    assert [s.name for s in usual.scenes] == ["random"]


def test_a_cell_is_the_same_after_it_was_sent(tmp_path: Path) -> None:
    for cell in planned(tmp_path, FILE).cells:
        again = cell_from(cell.text)
        assert again == cell and again.text == cell.text
        assert again.rebuilt({}) == cell.rebuilt({})


def test_what_varies_comes_from_the_seed_and_stays_in_its_range(tmp_path: Path) -> None:
    far = planned(tmp_path, FILE).scenes[1]
    drawn = [far.laboratory(seed)[1] for seed in range(50)]
    delays = [one.timing.delay for one in drawn]
    assert 0.01 <= min(delays) < 0.015 and 0.045 < max(delays) <= 0.05
    assert all(1e-5 <= one.drive.encoder[0] <= 1e-4 for one in drawn)
    assert far.laboratory(7)[1] == drawn[7] != drawn[8]
    assert drawn[0].scene.distance == (250.0, 400.0)


def test_a_condition_that_is_asked_for_stands_before_what_varies(tmp_path: Path) -> None:
    plan = planned(tmp_path, "latency = [0.012]\n" + FILE)
    far = next(cell for cell in plan.cells if cell.scenes == "far").distribution
    assert {far.laboratory(seed)[1].timing.delay for seed in range(9)} == {0.01}
    assert "drive.encoder" in far.vary


def test_one_distribution_takes_over_from_another_what_it_has_not_itself() -> None:
    base = distribution_from(
        "a", {"camera": {"width": 320, "height": 240}, "vary": {"drive.lag": [0.01, 0.1]}}, {}
    )
    more = distribution_from("b", {"like": "a", "camera": {"width": 640}}, {"a": base})
    assert more.tables["camera"] == {"width": 640, "height": 240} and more.vary == base.vary
    fixed = distribution_from("c", {"like": "a", "drive": {"lag": 0.05}}, {"a": base})
    assert fixed.vary == {} and fixed.laboratory(3)[1].drive.lag == 0.05


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_built_in_distribution_has_scenes_and_words(name: str) -> None:
    about = dict(described())[name]
    assert len(about) > 40 and about.endswith(".") and "#" not in about
    plan = StudyPlan(
        methods=plan_of(StudyFile(), {}).methods, scenes=(built_in(name),), duration=2.0
    )
    cell = plan.cells[0]
    rows = [one_run(cell, cell.rebuilt({}), seed) for seed in range(3)]
    assert len({row.focal_px for row in rows}) == 3
    if name == "hard":
        assert min(row.condition for row in rows) > 40.0
    if name == "random":
        assert max(row.condition for row in rows) <= 40.0
    if name == "laparoscopic":
        depths = [one_run(cell, cell.rebuilt({}), seed).rcm_depth for seed in range(30)]
        assert 0.2 < np.mean(np.array(depths) < 0.0) < 0.9


def test_the_engine_is_the_compiled_one_wherever_it_can_be(tmp_path: Path) -> None:
    def engines(text: str) -> list[str]:
        return [cell.engine for cell in planned(tmp_path, text).cells]

    assert engines('methods = ["dlt", "projection", "flow"]') == [COMPILED, COMPILED, MUJOCO]
    assert engines('disturb = [[], ["occlusion:at=1,for=0.2"]]') == [COMPILED, MUJOCO]
    assert engines('engine = "pictures"') == [PICTURES]
    printed = planned(tmp_path, 'methods = ["projection-printed"]').methods[0]
    assert printed.estimator == PRINTED


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('methods = ["dtl"]', "method must be one of projection, dlt"),
        ('methods = ["dlt", "dlt"]', "method must be given once"),
        ("methods = []", "method must be at least one"),
        ('methods = ["mylab:RLS"]', "that --method or --own names"),
        ('scenes = ["randm"]', "scenes must be one of paper, random"),
        ("count = 0", "count must be a whole number from 1"),
        ("count = 1.5", "study.count must be a whole number"),
        ("noise = [-1.0]", "noise must be a number of px that is not negative"),
        ("noise = [0.3, 0.3]", "noise must be given once"),
        ("latency = [0.001]", "latency must be at least half of the exposure"),
        ("duration = 0.5", "duration must be more than 1"),
        ('disturb = [["occlusio"]]', "did you mean occlusion"),
        ("disturb = []", "disturb must be at least one set; [[]] for none"),
        ('disturb = [["kill:at=3"]]', "disturbance must be none of kill"),
        ('engine = "compiled"\nmethods = ["flow"]', "engine must be auto, mujoco or pictures"),
        ('engine = "quick"', "engine must be one of auto"),
        ("repetitions = 0", "repetitions must be"),
        ("cont = 3", "did you mean count"),
        ("[method.a]\nestimator = 3", "method.a.estimator must be one of"),
        ('[method.a]\nestimator = "dlt"\ncontroler = {}', "method.a.controler must be one of"),
        ('[method.a]\nestimator = "dlt"\ncontroller = { gain = -1.0 }', "method.a.controller.gain"),
        ('[method.a]\nestimator = "dlt"\ncontroller = 3', "method.a.controller must be a table"),
        ("[distribution]\na = 3", "distribution.a must be a table"),
        (
            '[distribution.a]\nlike = "b.toml"',
            "a.like must be one of paper, random, laparoscopic, hard, got 'b.toml'",
        ),
        (
            '[distribution.a]\nvary = { "scene.distance" = [[100, 150], [240, 250]] }',
            "scenes a: scene.distance must be two positive numbers, least first",
        ),
        ("[distribution.a]\ncamera = 3", "a.camera must be a section"),
        ("[distribution.a.camera]\nwidht = 640", "did you mean width"),
        ('[distribution.a.vary]\n"camera.delay" = [0.05, 0.01]', "least first"),
        ('[distribution.a.vary]\n"camera.delay" = [0.01]', "two finite numbers"),
        ('[distribution.a.vary]\n"camera.delay" = ["a", "b"]', "two finite numbers"),
        ('[distribution.a.vary]\n"gate.speed" = [1.0, 2.0]', "a section among"),
        ('[distribution.a.vary]\n"camera.delay" = [0.01, 5.0]', "camera.delay must be a time"),
        ('[distribution.a.vary]\n"camera.dely" = [0.01, 0.05]', "did you mean delay"),
        ('[distribution.a.arm]\nkind = "galil"', "of a simulation"),
        ("x = [", "is not valid TOML"),
        ("count = 3\ncount = 4", "is not valid TOML"),
    ],
)
def test_what_cannot_be_studied_is_one_sentence(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(RcmServoError, match=r".") as told:
        _ = planned(tmp_path, text).cells
    assert words in str(told.value) and "\n" not in str(told.value)


def test_scenes_that_cannot_be_drawn_are_told_with_their_name_and_seed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rcmservo.sim.scenes.sampling.MAX_DRAWS", 10)
    nowhere = Distribution("nowhere", texts.toml(b"[scene]\ntravel = [900.0, 901.0]"))
    cell = StudyPlan(methods=plan_of(StudyFile(), {}).methods, scenes=(nowhere,)).cells[0]
    with pytest.raises(NoScene, match="scenes nowhere, seed 3: no scene in"):
        one_run(cell, cell.rebuilt({}), 3)
