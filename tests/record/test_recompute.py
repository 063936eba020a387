"""A recorded run computed again decides the same, bit for bit; with other settings it says where it
would not."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from replays import NAMES, Disturbed, faults, operator
from replays import recorded as record_of_a_seed

import rcmservo as rs
from conftest import CONTROLLERS, ESTIMATORS, TOOLS, first_quick, random_from
from rcmservo.config.servo_json import describe, rebuild
from rcmservo.interfaces import Floats
from rcmservo.method.estimators.base import Estimator, Sample
from rcmservo.record import reader
from rcmservo.record.recompute import recompute
from rcmservo.record.writer import Recorder
from rcmservo.tracking import PointMarkers


@dataclass
class Recorded:
    """A simulated laboratory whose runs are recorded, stage after stage."""

    folder: Path
    seed: int
    plant: Disturbed
    rig: Any
    recorder: Recorder

    def shown(self) -> rs.Target:
        self.rig.show_target()
        target = rs.teach(self.plant, frames=5)
        self.rig.go_home()
        return target

    def stage(
        self, servo: rs.Servo, target: rs.Target, seconds: float, state: rs.State | None = None
    ) -> rs.State:
        self.recorder.begin(servo, target, state)
        for tick in rs.run(self.plant, servo, target, seconds, state=state, operator=operator):
            self.recorder.write(tick)
        return tick.state


@pytest.fixture
def recorded(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Recorded]:
    seed = getattr(request, "param", 1)
    rig = rs.sim.Rig(seed, pictures=False)
    plant = Disturbed(rig.arm, rig.camera, PointMarkers(), rig.clock)
    with Recorder(tmp_path / reader.RECORD, {"seed": seed}) as recorder:
        yield Recorded(tmp_path, seed, plant, rig, recorder)


def simple(**choices: Any) -> rs.Servo:
    return rs.Servo(
        **({"mechanism": rs.SphericalRcm(), "tool": rs.RigidTool(spacing=30.0)} | choices)
    )


def phases(folder: Path) -> set[str]:
    return set(reader.read(folder).phase)


@pytest.mark.parametrize("recorded", first_quick(range(6)), indirect=True)
def test_a_disturbed_run_with_pauses_comes_out_the_same_bit_for_bit(recorded: Recorded) -> None:
    target = recorded.shown()
    recorded.plant.change = faults(
        random_from(recorded.seed), recorded.rig.clock, ("points", "stop")
    )
    recorded.stage(simple(), target, 6.0)
    recorded.recorder.close()
    again = recompute(recorded.folder)
    assert again.same and not again.open_loop and again.differs == {}
    assert "all 600 ticks" in again.words and "bit for bit" in again.words
    assert {"HOLD", "PAUSED", "ACQUIRE"} <= phases(recorded.folder)
    assert "RESUME" in again.then.words["request"]


@pytest.mark.parametrize("seed", first_quick(range(20, 28)))
def test_whatever_goes_wrong_comes_out_the_same(seed: int, tmp_path: Path) -> None:
    assert recompute(record_of_a_seed(tmp_path, seed, 3.0, NAMES)).same


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("tool", TOOLS)
def test_every_estimator_and_tool_comes_out_the_same(
    estimator: str, tool: str, recorded: Recorded
) -> None:
    servo = simple(
        estimator=ESTIMATORS[estimator], tool=TOOLS[tool], controller=CONTROLLERS["printed"]
    )
    recorded.stage(servo, recorded.shown(), 1.5)
    recorded.recorder.close()
    assert recompute(recorded.folder).same


def test_later_stages_go_on_from_the_states_that_they_went_on_from(recorded: Recorded) -> None:
    target, servo = recorded.shown(), simple()
    explored = recorded.stage(servo, target, 3.0)
    moved = recorded.stage(servo, target, 2.0, explored)
    recorded.stage(servo, recorded.shown(), 2.0, moved)
    recorded.stage(
        simple(controller=rs.SaturatedController(gain=0.5)), recorded.shown(), 2.0, explored
    )
    recorded.recorder.close()
    again = recompute(recorded.folder)
    assert [stage.origin for stage in again.then.stages] == [-1, 0, 1, 0]
    assert again.same


def test_a_stage_from_a_state_that_is_not_in_the_record_is_refused(recorded: Recorded) -> None:
    target, servo = recorded.shown(), simple()
    *_, tick = rs.run(recorded.plant, servo, target, 0.5)
    recorded.stage(servo, target, 0.5, tick.state)
    recorded.recorder.close()
    with pytest.raises(rs.UnusableFile, match="not in this record"):
        recompute(recorded.folder)


def test_other_settings_show_where_the_servo_would_have_decided_otherwise(
    recorded: Recorded,
) -> None:
    recorded.stage(simple(), recorded.shown(), 4.0)
    recorded.recorder.close()
    again = recompute(recorded.folder, simple(controller=rs.SaturatedController(gain=0.5)))
    assert again.open_loop and not again.same
    assert again.first is not None and again.then.phase[again.first] == "ACQUIRE"
    assert "open loop" in again.words and "v" in again.differs and "o_c" not in again.differs
    np.testing.assert_array_equal(again.then.ticks["q"], again.now.ticks["q"])
    late = slice(again.first + 50, None)
    assert np.abs(again.now.ticks["v"][late]).mean() < np.abs(again.then.ticks["v"][late]).mean()


def test_the_recorded_settings_given_by_hand_are_no_other_settings(recorded: Recorded) -> None:
    recorded.stage(simple(), recorded.shown(), 1.0)
    recorded.recorder.close()
    again = recompute(recorded.folder, simple())
    assert again.same and not again.open_loop


def test_one_changed_bit_of_an_observation_is_found(recorded: Recorded, tmp_path: Path) -> None:
    target, servo, ticks = recorded.shown(), simple(), []
    for tick in rs.run(recorded.plant, servo, target, 3.0):
        ticks.append(tick)
    seen = ticks[150].seen
    q = seen.q.copy()
    q[0] = np.nextafter(q[0], np.inf)
    ticks[150] = replace(ticks[150], seen=replace(seen, q=q))
    with Recorder(tmp_path / "changed.mcap", {}) as recorder:
        recorder.begin(servo, target)
        for tick in ticks:
            recorder.write(tick)
    again = recompute(tmp_path / "changed.mcap")
    assert again.first == 150 and "command" in again.differs


def test_a_record_that_was_cut_comes_out_the_same_up_to_there(recorded: Recorded) -> None:
    recorded.stage(simple(), recorded.shown(), 2.0)
    recorded.recorder.close()
    path = recorded.folder / reader.RECORD
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    again = recompute(path)
    assert again.same and 50 < len(again.now.time) < 200


@dataclass(frozen=True)
class Guess(Estimator):
    """An estimator that somebody else has made."""

    name = "guess"
    models = False
    size: float = 1.0

    def init(self) -> Floats:
        return np.zeros((3, 3))

    def update(self, memory: Floats, tool: Any, sample: Sample) -> Floats:
        return memory + self.size * np.eye(3)

    def jacobian(self, memory: Floats, tool: Any, sample: Sample) -> Floats:
        return memory


def test_a_servo_with_a_part_of_ones_own_is_run_again_when_it_is_given(recorded: Recorded) -> None:
    servo = simple(estimator=Guess())
    recorded.stage(servo, recorded.shown(), 0.5)
    recorded.recorder.close()
    with pytest.raises(rs.UnusableFile, match=r"estimator\.kind"):
        recompute(recorded.folder)
    assert recompute(recorded.folder, servo).same


@pytest.mark.parametrize("mechanism", [rs.SphericalRcm(), rs.PitchYawRcm(insertion_zero=1.0 / 3.0)])
@pytest.mark.parametrize("controller", CONTROLLERS)
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_a_servo_comes_back_from_its_description(
    mechanism: Any, controller: str, estimator: str
) -> None:
    servo = simple(
        mechanism=mechanism,
        controller=CONTROLLERS[controller],
        estimator=ESTIMATORS[estimator],
        gate=rs.Gate(latency=0.1 + 0.2),
        thresholds=rs.Thresholds(jump=np.nextafter(4.0, 5.0)),
        rate=125.0,
    )
    description = json.loads(json.dumps(describe(servo)))
    assert rebuild(description) == servo


@pytest.mark.parametrize(
    "box", ["mechanism", "tool", "estimator", "controller", "exploration", "gate", "thresholds"]
)
def test_a_description_that_lacks_a_setting_is_refused_by_name(box: str) -> None:
    description = describe(simple())
    description[box].popitem()
    with pytest.raises(rs.BadInput, match=rf"servo\.{box}"):
        rebuild(description)


@pytest.mark.parametrize("wrong", [None, 3, [], "servo", {}, {"rate": 100.0}])
def test_what_is_no_description_is_refused(wrong: Any) -> None:
    with pytest.raises(rs.BadInput):
        rebuild(wrong)
    with pytest.raises(rs.BadInput):
        rebuild(describe(simple()) | {"tool": wrong})
    with pytest.raises(rs.BadInput):
        rebuild(describe(simple()) | {"rate": wrong})
