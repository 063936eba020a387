"""A request of the operator applies from the next tick on and is recorded."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcmservo as rs
from conftest import Laboratory, make_laboratory
from rcmservo.loop.operator import OperatorRequest, Teach
from rcmservo.recording import reader
from rcmservo.recording.replay import replay_record
from rcmservo.recording.writer import Recorder, ThreadedRecorder


class Scripted:
    """Operator with requests at given ticks."""

    def __init__(self, requests: dict[int, OperatorRequest]) -> None:
        self.requests, self.tick = requests, -1

    def __call__(self, tick: rs.Tick) -> OperatorRequest:
        self.tick += 1
        return self.requests.get(self.tick, rs.Request.NONE)


class CountingArm:
    """Arm that counts the calls of `enable`."""

    def __init__(self, arm: rs.Arm) -> None:
        self.arm, self.enabled = arm, 0
        self.measure, self.apply = arm.measure, arm.apply

    def enable(self) -> None:
        self.enabled += 1
        self.arm.enable()


def midway_target(lab: Laboratory) -> rs.Target:
    """Return another target, half-way to the first."""
    scene = lab.rig.scene
    lab.rig.place((scene.start + scene.target) / 2.0)
    target = rs.teach(lab.plant, frames=5)
    lab.rig.go_home()
    return target


def ticks_of(lab: Laboratory, servo: rs.Servo, seconds: float, requests: Any) -> Iterator[rs.Tick]:
    return rs.servo_ticks(lab.plant, servo, lab.target, seconds, operator=Scripted(requests))


def with_lower_gain(servo: rs.Servo) -> rs.Servo:
    return replace(servo, controller=rs.SaturatedController(gain=0.7))


def open_recorder(path: Path) -> Recorder:
    return Recorder(path, {})


def open_threaded_recorder(path: Path) -> ThreadedRecorder:
    return ThreadedRecorder(Recorder(path, {}))


@pytest.mark.parametrize("opened", [open_recorder, open_threaded_recorder])
def test_targets_and_settings_changed_during_a_run_are_stages_that_replay_bit_for_bit(
    opened: Callable[[Path], Any], tmp_path: Path
) -> None:
    lab = make_laboratory()
    servo, other = lab.servo(), midway_target(lab)
    lab.plant.arm = arm = CountingArm(lab.plant.arm)
    requests = {
        250: with_lower_gain(servo),
        350: other,
        450: Teach(frames=5),
        560: rs.Request.RESUME,
        620: servo,
        640: lab.target,
    }
    with opened(tmp_path / reader.RECORD) as recorder:
        recorder.begin(servo, lab.target)
        ticks = []
        for tick in ticks_of(lab, servo, 8.0, requests):
            recorder.write(tick)
            ticks.append(tick)
    replayed = replay_record(tmp_path)
    stages = replayed.recorded.stages
    assert replayed.same, replayed.sentence
    assert [stage.origin for stage in stages] == [-1, 0, 1, 2, 3, 4]
    assert [stage.mid_run for stage in stages] == [False] + [True] * 5
    taught = stages[3].first
    assert [stage.first for stage in stages] == [0, 251, 351, taught, 621, 641]
    assert 450 < taught < 560
    assert arm.enabled == 1 and replayed.recorded.ticks["enabled"].all()
    assert replayed.recorded.phase[taught] == "PAUSED" and replayed.recorded.phase[-1] == "SERVO"
    assert replayed.recorded.words["request"][451] == "PAUSE"
    at = [stage.servo["controller"]["gain"] for stage in stages]
    assert at == [servo.controller.gain, *[0.7] * 3, *[servo.controller.gain] * 2]
    assert np.abs(ticks[-1].state.delta / (0.02, 1.5, 1.5)).max() < 1.0


def test_a_changed_gain_applies_from_the_next_tick_on() -> None:
    lab = make_laboratory()
    servo = lab.servo()
    plain = list(ticks_of(lab, servo, 4.0, {}))
    lab = make_laboratory()
    changed = list(ticks_of(lab, servo, 4.0, {215: with_lower_gain(servo)}))
    speeds = [[np.linalg.norm(tick.state.v) for tick in ticks] for ticks in (plain, changed)]
    assert plain[215].state.phase is rs.Phase.SERVO
    assert speeds[0][:216] == speeds[1][:216] and speeds[1][216] < 0.7 * speeds[0][216]


def test_a_target_is_taught_from_a_tool_at_rest() -> None:
    lab = make_laboratory()
    taught, moved = None, []
    for tick in ticks_of(lab, lab.servo(), 3.0, {200: Teach(frames=8)}):
        if tick.state.target is not lab.target:
            taught = tick.state.target
            moved.append(tick.state.command.rates.any())
            assert np.allclose(tick.observation.points, taught.points, atol=1.5)
            assert np.allclose(tick.observation.q, taught.q, atol=1e-3)
    assert taught is not None and not any(moved) and len(moved) > 50
    assert taught.taught_at > lab.target.taught_at


def test_another_request_ends_teaching() -> None:
    lab = make_laboratory()
    requests = {200: Teach(frames=30), 215: rs.Request.RESUME, 220: rs.Request.PAUSE}
    *_, last = ticks_of(lab, lab.servo(), 4.0, requests)
    assert last.state.target is lab.target and last.state.phase is rs.Phase.PAUSED


def test_teaching_waits_for_frames_with_both_markers() -> None:
    lab = make_laboratory()
    find, hidden = lab.plant.tracker.find, [True]

    def find_partly(frame: rs.Frame) -> rs.Markers:
        markers = find(frame)
        points = np.array([markers.points[0], [np.nan, np.nan]])
        return replace(markers, points=points) if hidden[0] else markers

    targets = []
    for k, tick in enumerate(ticks_of(lab, lab.servo(), 5.0, {200: Teach(frames=5)})):
        if k == 200:
            lab.plant.tracker.find = find_partly
        hidden[0] = k < 400
        targets.append(tick.state.target)
    assert all(target is lab.target for target in targets[:401])
    assert targets[-1] is not lab.target and np.isfinite(targets[-1].points).all()


def test_an_equal_target_is_no_change(tmp_path: Path) -> None:
    lab = make_laboratory()
    servo = lab.servo()
    with Recorder(tmp_path / reader.RECORD, {}) as recorder:
        recorder.begin(servo, lab.target)
        for tick in ticks_of(lab, servo, 2.5, {200: replace(lab.target)}):
            recorder.write(tick)
    assert len(reader.read_record(tmp_path).stages) == 1
    assert replay_record(tmp_path).same


def test_a_servo_for_which_the_estimate_is_invalid_is_refused_and_the_arm_is_at_rest() -> None:
    lab = make_laboratory()
    servo = lab.servo()
    for change in (
        {"estimator": rs.FlowEstimator()},
        {"tool": rs.RigidTool(spacing=31.0)},
        {"mechanism": rs.PitchYawRcm()},
        {"imaged_rcm": rs.ImagedRcm(lines=20)},
        {"rate": 50.0},
    ):
        with pytest.raises(rs.BadInput, match=rf"servo\.{next(iter(change))} must be the same"):
            list(ticks_of(lab, servo, 2.0, {5: replace(servo, **change)}))
        assert not lab.rig.arm.measure().enabled


@pytest.mark.parametrize("answer", [None, "resume", True, [rs.Request.RESUME]])
def test_an_invalid_result_of_an_operator_is_refused_with_one_sentence(answer: Any) -> None:
    lab = make_laboratory()
    with pytest.raises(rs.BadInput, match=r"operator\(\) must be a Request, Target, Servo, Tea"):
        list(ticks_of(lab, lab.servo(), 1.0, {3: answer}))
    assert not lab.rig.arm.measure().enabled
