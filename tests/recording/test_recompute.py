"""A replay reproduces the recorded decisions, or reports where other settings differ."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from replays import NAMES, Disturbed, faults, operator
from replays import recorded as record_of_a_seed

import rcmservo as rs
from conftest import CONTROLLERS, ESTIMATORS, TOOLS, make_random, mark_others_slow
from rcmservo.config.servo_json import describe_servo, rebuild_servo
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.interfaces import Floats
from rcmservo.recording import reader
from rcmservo.recording.replay import replay_record
from rcmservo.recording.writer import Recorder
from rcmservo.tracking import PointMarkers


@dataclass
class RecordedLab:
    """Simulated laboratory that records its runs, one stage after the other."""

    folder: Path
    seed: int
    plant: Disturbed
    rig: Any
    recorder: Recorder

    def teach(self) -> rs.Target:
        self.rig.move_to_target()
        target = rs.teach(self.plant, frames=5)
        self.rig.go_home()
        return target

    def stage(
        self, servo: rs.Servo, target: rs.Target, seconds: float, state: rs.State | None = None
    ) -> rs.State:
        self.recorder.begin(servo, target, state)
        for tick in rs.servo_ticks(
            self.plant, servo, target, seconds, state=state, operator=operator
        ):
            self.recorder.write(tick)
        return tick.state


@pytest.fixture
def recorded(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[RecordedLab]:
    seed = getattr(request, "param", 1)
    rig = rs.sim.Rig(seed, pictures=False)
    plant = Disturbed(rig.arm, rig.camera, PointMarkers(), rig.clock)
    with Recorder(tmp_path / reader.RECORD, {"seed": seed}) as recorder:
        yield RecordedLab(tmp_path, seed, plant, rig, recorder)


def make_servo(**settings: Any) -> rs.Servo:
    return rs.Servo(
        **({"mechanism": rs.SphericalRcm(), "tool": rs.RigidTool(spacing=30.0)} | settings)
    )


def phases(folder: Path) -> set[str]:
    return set(reader.read_record(folder).phase)


@pytest.mark.parametrize("recorded", mark_others_slow(range(4)), indirect=True)
def test_a_disturbed_run_with_pauses_is_reproduced_bit_for_bit(recorded: RecordedLab) -> None:
    target = recorded.teach()
    recorded.plant.change = faults(
        make_random(recorded.seed), recorded.rig.clock, ("points", "stop")
    )
    recorded.stage(make_servo(), target, 6.0)
    recorded.recorder.close()
    rerun = replay_record(recorded.folder)
    assert rerun.same and not rerun.open_loop and rerun.difference_counts == {}
    assert "all 600 ticks" in rerun.sentence and "bit for bit" in rerun.sentence
    assert {"HOLD", "PAUSED", "ACQUIRE"} <= phases(recorded.folder)
    assert "RESUME" in rerun.recorded.words["request"]


@pytest.mark.parametrize("seed", mark_others_slow(range(20, 25)))
def test_all_disturbances_are_reproduced(seed: int, tmp_path: Path) -> None:
    assert replay_record(record_of_a_seed(tmp_path, seed, 3.0, NAMES)).same


@pytest.mark.parametrize(("estimator", "tool"), list(zip(ESTIMATORS, cycle(TOOLS), strict=False)))
def test_every_estimator_and_tool_is_reproduced(
    estimator: str, tool: str, recorded: RecordedLab
) -> None:
    servo = make_servo(
        estimator=ESTIMATORS[estimator], tool=TOOLS[tool], controller=CONTROLLERS["printed"]
    )
    recorded.stage(servo, recorded.teach(), 1.5)
    recorded.recorder.close()
    assert replay_record(recorded.folder).same


def test_later_stages_continue_from_their_recorded_origins(recorded: RecordedLab) -> None:
    target, servo = recorded.teach(), make_servo()
    explored = recorded.stage(servo, target, 3.0)
    moved = recorded.stage(servo, target, 2.0, explored)
    recorded.stage(servo, recorded.teach(), 2.0, moved)
    recorded.stage(
        make_servo(controller=rs.SaturatedController(gain=0.5)), recorded.teach(), 2.0, explored
    )
    recorded.recorder.close()
    rerun = replay_record(recorded.folder)
    assert [stage.origin for stage in rerun.recorded.stages] == [-1, 0, 1, 0]
    assert rerun.same


def test_a_stage_from_an_unrecorded_state_is_refused(recorded: RecordedLab) -> None:
    target, servo = recorded.teach(), make_servo()
    *_, tick = rs.servo_ticks(recorded.plant, servo, target, 0.5)
    recorded.stage(servo, target, 0.5, tick.state)
    recorded.recorder.close()
    with pytest.raises(rs.UnusableFile, match="not in this record"):
        replay_record(recorded.folder)


def test_other_settings_show_the_first_different_decision(
    recorded: RecordedLab,
) -> None:
    recorded.stage(make_servo(), recorded.teach(), 4.0)
    recorded.recorder.close()
    rerun = replay_record(recorded.folder, make_servo(controller=rs.SaturatedController(gain=0.5)))
    assert rerun.open_loop and not rerun.same
    assert (
        rerun.first_difference is not None
        and rerun.recorded.phase[rerun.first_difference] == "ACQUIRE"
    )
    assert (
        "open loop" in rerun.sentence
        and "v" in rerun.difference_counts
        and "o_c" not in rerun.difference_counts
    )
    np.testing.assert_array_equal(rerun.recorded.ticks["q"], rerun.recomputed.ticks["q"])
    late = slice(rerun.first_difference + 50, None)
    assert (
        np.abs(rerun.recomputed.ticks["v"][late]).mean()
        < np.abs(rerun.recorded.ticks["v"][late]).mean()
    )


def test_the_recorded_settings_given_explicitly_are_no_other_settings(
    recorded: RecordedLab,
) -> None:
    recorded.stage(make_servo(), recorded.teach(), 1.0)
    recorded.recorder.close()
    rerun = replay_record(recorded.folder, make_servo())
    assert rerun.same and not rerun.open_loop


def test_one_changed_bit_of_an_observation_is_found(recorded: RecordedLab, tmp_path: Path) -> None:
    target, servo, ticks = recorded.teach(), make_servo(), []
    for tick in rs.servo_ticks(recorded.plant, servo, target, 3.0):
        ticks.append(tick)
    observation = ticks[150].observation
    q = observation.q.copy()
    q[0] = np.nextafter(q[0], np.inf)
    ticks[150] = replace(ticks[150], observation=replace(observation, q=q))
    with Recorder(tmp_path / "changed.mcap", {}) as recorder:
        recorder.begin(servo, target)
        for tick in ticks:
            recorder.write(tick)
    rerun = replay_record(tmp_path / "changed.mcap")
    assert rerun.first_difference == 150 and "command" in rerun.difference_counts


def test_a_truncated_record_is_reproduced_up_to_its_end(recorded: RecordedLab) -> None:
    recorded.stage(make_servo(), recorded.teach(), 2.0)
    recorded.recorder.close()
    path = recorded.folder / reader.RECORD
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    rerun = replay_record(path)
    assert rerun.same and 50 < len(rerun.recomputed.time) < 200


@dataclass(frozen=True)
class ConstantEstimator(Estimator):
    """User-defined estimator."""

    name = "guess"
    predicts_markers = False
    size: float = 1.0

    def init(self) -> Floats:
        return np.zeros((3, 3))

    def update(self, memory: Floats, tool: Any, sample: Sample) -> Floats:
        return memory + self.size * np.eye(3)

    def jacobian(self, memory: Floats, tool: Any, sample: Sample) -> Floats:
        return memory


def test_a_servo_with_a_user_defined_estimator_is_replayed_if_given(recorded: RecordedLab) -> None:
    servo = make_servo(estimator=ConstantEstimator())
    recorded.stage(servo, recorded.teach(), 0.5)
    recorded.recorder.close()
    with pytest.raises(rs.UnusableFile, match=r"estimator\.kind"):
        replay_record(recorded.folder)
    assert replay_record(recorded.folder, servo).same


@pytest.mark.parametrize("mechanism", [rs.SphericalRcm(), rs.PitchYawRcm(insertion_zero=1.0 / 3.0)])
@pytest.mark.parametrize("controller", CONTROLLERS)
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_a_servo_is_rebuilt_from_its_description(
    mechanism: Any, controller: str, estimator: str
) -> None:
    servo = make_servo(
        mechanism=mechanism,
        controller=CONTROLLERS[controller],
        estimator=ESTIMATORS[estimator],
        gate=rs.Gate(latency=0.1 + 0.2),
        thresholds=rs.Thresholds(max_jump_px=np.nextafter(4.0, 5.0)),
        rate=125.0,
    )
    description = json.loads(json.dumps(describe_servo(servo)))
    assert rebuild_servo(description) == servo


@pytest.mark.parametrize(
    "part", ["mechanism", "tool", "estimator", "controller", "exploration", "gate", "thresholds"]
)
def test_a_servo_part_that_lacks_a_setting_is_refused_by_name(part: str) -> None:
    description = describe_servo(make_servo())
    description[part].popitem()
    with pytest.raises(rs.BadInput, match=rf"servo\.{part}"):
        rebuild_servo(description)


@pytest.mark.parametrize("invalid", [None, 3, [], "servo", {}, {"rate": 100.0}])
def test_an_invalid_servo_description_is_refused(invalid: Any) -> None:
    with pytest.raises(rs.BadInput):
        rebuild_servo(invalid)
    with pytest.raises(rs.BadInput):
        rebuild_servo(describe_servo(make_servo()) | {"tool": invalid})
    with pytest.raises(rs.BadInput):
        rebuild_servo(describe_servo(make_servo()) | {"rate": invalid})
