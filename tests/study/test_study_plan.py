"""Study files and names become a plan, or raise one error that names the field."""

from pathlib import Path

import numpy as np
import pytest

from rcmservo.config import toml_json_parsing
from rcmservo.errors import RcmServoError
from rcmservo.estimation.dlt import DltEstimator
from rcmservo.estimation.projection_rule import PAPER_PROJECTION_ESTIMATOR
from rcmservo.sim.scene import NoScene
from rcmservo.study.execution.chunk import run_seed
from rcmservo.study.plan.cell import parse_cell
from rcmservo.study.plan.conditions import COMPILED, MUJOCO, PICTURES
from rcmservo.study.plan.distribution import (
    BUILT_IN_DISTRIBUTIONS,
    Distribution,
    describe_built_in,
    load_built_in,
    parse_distribution,
)
from rcmservo.study.plan.file import StudyFile, make_plan, read_study_file
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


def write_file(folder: Path, text: str) -> Path:
    path = folder / "study.toml"
    path.write_text(text)
    return path


def make_plan_of(folder: Path, text: str) -> StudyPlan:
    return make_plan(read_study_file(write_file(folder, text)), {})


def test_a_plan_is_methods_times_scenes_times_conditions(tmp_path: Path) -> None:
    plan = make_plan_of(tmp_path, FILE)
    assert plan.runs == 2 * 2 * 2 * 20 == sum(len(chunk.seeds) for chunk in plan.chunks())
    names = [(cell.condition, cell.method) for cell in plan.cells]
    assert names[:3] == [
        ("random, 0.3 px", "dlt"),
        ("random, 0.3 px", "careful"),
        ("random, 1 px", "dlt"),
    ]
    careful = plan.methods[1]
    assert (careful.estimator.rate, careful.parts["controller"].gain) == (2.0, 2.0)  # pyright: ignore


def test_without_lists_a_study_uses_everything_that_the_file_defines(tmp_path: Path) -> None:
    text = FILE.replace('methods = ["dlt", "careful"]\nscenes = ["random", "far"]\n', "")
    plan = make_plan_of(tmp_path, text)
    assert [m.name for m in plan.methods] == ["careful"]
    assert [s.name for s in plan.scenes] == ["far"]
    default = make_plan_of(tmp_path, "count = 3")
    assert [type(m.estimator) for m in default.methods] == [DltEstimator]
    assert [s.name for s in default.scenes] == ["random"]


def test_a_cell_survives_its_text_form(tmp_path: Path) -> None:
    for cell in make_plan_of(tmp_path, FILE).cells:
        parsed = parse_cell(cell.text)
        assert parsed == cell and parsed.text == cell.text
        assert parsed.rebuild_servo({}) == cell.rebuild_servo({})


def test_varying_numbers_depend_on_the_seed_and_stay_in_their_range(tmp_path: Path) -> None:
    far = make_plan_of(tmp_path, FILE).scenes[1]
    drawn = [far.draw(seed)[1] for seed in range(50)]
    delays = [settings.timing.delay for settings in drawn]
    assert 0.01 <= min(delays) < 0.015 and 0.045 < max(delays) <= 0.05
    assert all(1e-5 <= settings.drive.encoder[0] <= 1e-4 for settings in drawn)
    assert far.draw(7)[1] == drawn[7] != drawn[8]
    assert drawn[0].scene.distance == (250.0, 400.0)


def test_a_requested_condition_replaces_a_varying_number(tmp_path: Path) -> None:
    plan = make_plan_of(tmp_path, "latency = [0.012]\n" + FILE)
    far = next(cell for cell in plan.cells if cell.scenes == "far").distribution
    assert {far.draw(seed)[1].timing.delay for seed in range(9)} == {0.01}
    assert "drive.encoder" in far.vary


def test_a_distribution_inherits_sections_and_ranges_with_like() -> None:
    base = parse_distribution(
        "a", {"camera": {"width": 320, "height": 240}, "vary": {"drive.lag": [0.01, 0.1]}}, {}
    )
    more = parse_distribution("b", {"like": "a", "camera": {"width": 640}}, {"a": base})
    assert more.tables["camera"] == {"width": 640, "height": 240} and more.vary == base.vary
    fixed = parse_distribution("c", {"like": "a", "drive": {"lag": 0.05}}, {"a": base})
    assert fixed.vary == {} and fixed.draw(3)[1].drive.lag == 0.05


@pytest.mark.parametrize("name", BUILT_IN_DISTRIBUTIONS)
def test_every_built_in_distribution_has_scenes_and_a_description(name: str) -> None:
    description = dict(describe_built_in())[name]
    assert len(description) > 40 and description.endswith(".") and "#" not in description
    plan = StudyPlan(
        methods=make_plan(StudyFile(), {}).methods, scenes=(load_built_in(name),), duration=2.0
    )
    cell = plan.cells[0]
    rows = [run_seed(cell, cell.rebuild_servo({}), seed) for seed in range(3)]
    assert len({row.focal_px for row in rows}) == 3
    if name == "hard":
        assert min(row.condition for row in rows) > 40.0
    if name == "random":
        assert max(row.condition for row in rows) <= 40.0
    if name == "laparoscopic":
        depths = [run_seed(cell, cell.rebuild_servo({}), seed).rcm_depth for seed in range(30)]
        assert 0.2 < np.mean(np.array(depths) < 0.0) < 0.9


def test_all_methods_and_conditions_run_on_the_same_engine(tmp_path: Path) -> None:
    """Methods are compared on the same plant: one that needs the full simulator moves all there."""

    def choose_engines(text: str) -> list[str]:
        return [cell.engine for cell in make_plan_of(tmp_path, text).cells]

    assert choose_engines('methods = ["dlt", "projection"]') == [COMPILED] * 2
    assert choose_engines('methods = ["dlt", "projection", "flow"]') == [MUJOCO] * 3
    assert choose_engines('disturb = [[], ["occlusion:at=1,for=0.2"]]') == [MUJOCO] * 2
    assert choose_engines('engine = "pictures"') == [PICTURES]
    printed = make_plan_of(tmp_path, 'methods = ["projection-printed"]').methods[0]
    assert printed.estimator == PAPER_PROJECTION_ESTIMATOR


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('methods = ["dtl"]', "method must be one of projection, dlt"),
        ('methods = ["dlt", "dlt"]', "method must be given once"),
        ("methods = []", "method must be at least one"),
        ('methods = ["mylab:RLS"]', "that --method or --user-estimator names"),
        ('scenes = ["randm"]', "scenes must be one of paper, random"),
        ("count = 0", "count must be a whole number from 1"),
        ("count = 1.5", "study.count must be a whole number"),
        ("noise = [-1.0]", "noise must be a number of px that is not negative"),
        ("noise = [0.3, 0.3]", "noise must be given once"),
        ("latency = [0.001]", "latency must be at least half of the exposure"),
        ("duration = 0.5", "duration must be a time above 1"),
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
def test_an_invalid_file_raises_one_error_that_names_the_field(
    tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises(RcmServoError, match=r".") as raised:
        _ = make_plan_of(tmp_path, text).cells
    assert message in str(raised.value) and "\n" not in str(raised.value)


def test_scenes_that_cannot_be_drawn_raise_an_error_with_name_and_seed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rcmservo.sim.scenes.sampling.MAX_DRAWS", 10)
    impossible = Distribution(
        "impossible", toml_json_parsing.parse_toml(b"[scene]\ntravel = [900.0, 901.0]")
    )
    cell = StudyPlan(methods=make_plan(StudyFile(), {}).methods, scenes=(impossible,)).cells[0]
    with pytest.raises(NoScene, match="scenes impossible, seed 3: no scene in"):
        run_seed(cell, cell.rebuild_servo({}), 3)
