"""`rs.run`: confirmation, record, end and result of a run on a rig."""

import gc
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rcmservo as rs
from conftest import ROOT
from rcmservo.errors import Stopped
from rcmservo.interfaces import Floats
from rcmservo.live.device_protocols import NotReady
from rcmservo.recording.final_pose import RunCourse, measure_drive_response
from rcmservo.recording.reader import read_record
from rcmservo.recording.summary_text import list_result_rows
from rcmservo.rig import rig as rig_module


def make_simulated_rig(seed: int = 0, **settings: Any) -> Any:
    return rs.sim.Rig(seed, pictures=False, **settings)


def make_foreign_rig(simulated: Any) -> rs.Rig:
    """Return the devices of a simulation as a rig that could be a real one."""
    return rs.Rig(
        simulated.arm,
        simulated.camera,
        rs.tracking.PointMarkers(),
        rs.SphericalRcm(),
        rs.RigidTool(30.0),
        simulated.clock,
    )


@pytest.fixture(scope="module")
def arrived() -> tuple[Any, rs.RecordedResult]:
    """Return a simulated rig after a run, and its result."""
    rig = make_simulated_rig()
    return rig, rs.run(rig, rs.Servo(), rig.teach())


def test_a_simulated_run_arrives_and_its_result_is_in_mm(
    arrived: tuple[Any, rs.RecordedResult],
) -> None:
    rig, result = arrived
    taught_p2 = rig.truth.tool_body.points(rig.scene.target)[1]
    p2 = rig.truth.markers(rig.clock.now())[1]
    assert result.settled and str(result).startswith("arrived, error 0.")
    assert result.pose_error_mm == pytest.approx(np.linalg.norm(p2 - taught_p2), abs=0.05)
    assert result.pose.p2_mm == pytest.approx(p2, abs=0.05)
    assert result.pose.by_joints_mm is not None and result.pose.by_joints_mm < 0.1
    assert result.pose.by_image_mm is not None and result.pose.by_image_mm < 0.1
    assert result.drives is not None
    assert result.drives.gain == pytest.approx([1.0, 1.0, 1.0], abs=0.01)
    assert all(lag is not None and 0.0 < lag < 60.0 for lag in result.drives.lag_ms)
    assert not rig.arm.measure().enabled
    assert result.duration_s is not None and result.duration_s < 10.0, "it ends once settled"


def test_the_readme_shows_the_rows_of_a_simulated_run(
    arrived: tuple[Any, rs.RecordedResult],
) -> None:
    """A command also prints its speed."""
    _, result = arrived
    shown = re.findall(r"^│ (.*?) +│", (ROOT / "README.md").read_text(), re.M)
    assert shown == [*(title for title, _ in list_result_rows(result)), "speed"]


@pytest.mark.usefixtures("blank_figures")
def test_the_record_is_complete_and_a_folder_with_results_is_refused(tmp_path: Path) -> None:
    rig = make_simulated_rig()
    target, folder = rig.teach(), tmp_path / "first"
    result = rs.run(rig, rs.Servo(), target, 1.0, record=folder)
    record = read_record(folder)
    assert record.complete and record.about["seed"] == 0 and len(record.truth["p2"]) == 100
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["pose_error_mm"] == result.pose_error_mm and metrics["folder"] == str(folder)
    q = rig.arm.measure().q
    with pytest.raises(rs.UnusableFile, match="is not empty and is not overwritten"):
        rs.run(rig, rs.Servo(), target, 1.0, record=folder)
    np.testing.assert_array_equal(rig.arm.measure().q, q)


def test_without_a_folder_the_record_lives_as_long_as_the_result(tmp_path: Path) -> None:
    rig = make_simulated_rig()
    result = rs.run(rig, rs.Servo(), rig.teach(), 1.0)
    folder = Path(result.folder)
    assert len(result.record.time) == 100
    saved = result.save(tmp_path / "kept")
    assert (tmp_path / "kept/metrics.json").exists() and saved.folder == str(tmp_path / "kept")
    with pytest.raises(rs.UnusableFile, match="exists and is not overwritten"):
        result.save(tmp_path / "kept")
    assert "<table>" in result._repr_html_()  # pyright: ignore[reportPrivateUsage]
    assert result.plot().axes[0].get_ylabel() == "marker 2 to target [mm]"
    del result
    gc.collect()
    assert not folder.exists() and saved.record.complete


def refuse(question: str) -> str:
    return "yes"


@pytest.mark.parametrize(
    ("confirm", "error", "words"),
    [
        (None, rs.BadInput, "confirm must be a function that asks the person at the arm"),
        (refuse, Stopped, "the drive was not switched on: the answer was not enable"),
    ],
)
def test_an_unknown_arm_is_not_enabled_without_the_word(
    confirm: Callable[[str], str] | None, error: type[Exception], words: str, tmp_path: Path
) -> None:
    """The folder of the record stays free for the next attempt."""
    simulated = make_simulated_rig()
    simulated.move_to_target()
    rig = make_foreign_rig(simulated)
    target, enabled = rig.teach(30), list[int]()
    simulated.arm.enable = lambda: enabled.append(1)
    with pytest.raises(error, match=words):
        rs.run(rig, rs.Servo(), target, record=tmp_path / "first", confirm=confirm)
    assert not enabled and not (tmp_path / "first").exists()


def test_the_question_states_the_motion_and_the_word_enables_the_drive() -> None:
    simulated, questions = make_simulated_rig(), list[str]()
    rig = make_foreign_rig(simulated)
    simulated.move_to_target()
    target = rig.teach(30)
    simulated.go_home()
    rig.plant.reset()

    def confirm(question: str) -> str:
        questions.append(question)
        return "enable"

    result = rs.run(rig, rs.Servo(), target, confirm=confirm)
    assert result.settled and result.pose_error_mm is None and not result.simulated
    assert "error" in str(result) and "by the image" in str(result)
    (question,) = questions
    assert "for at most 30 s" in question and "8 mm between two corners" in question
    assert question.endswith("Type enable to switch the drive on: ")


def test_an_arm_that_is_on_or_does_not_know_its_joints_is_refused() -> None:
    rig = make_simulated_rig()
    target = rig.teach(30)
    rig.arm.is_homed = lambda: False
    with pytest.raises(NotReady, match="the joint values of the arm are unknown"):
        rs.run(rig, rs.Servo(), target)
    rig.arm.is_homed = lambda: True
    rig.plant.enable()
    with pytest.raises(NotReady, match="another program has switched the arm's drive on"):
        rs.run(rig, rs.Servo(), target)


def test_the_error_is_that_of_the_target_at_the_end() -> None:
    """A target that the simulation has not taught has no true error."""
    rig = make_simulated_rig()
    first, second = rig.teach(30), rig.teach(30)
    other = rs.Target(second.points + np.array([15.0, 0.0]), second.q)

    def go_to(target: rs.Target) -> Callable[[rs.Tick], Any]:
        return lambda tick: target if tick.time == 500_000_000 else rs.Request.NONE

    known = rs.run(rig, rs.Servo(), first, 4.0, operator=go_to(second))
    assert known.pose_error_mm is not None and known.bound_mm is not None
    rig.go_home()
    unknown = rs.run(rig, rs.Servo(), first, 4.0, operator=go_to(other))
    assert unknown.pose_error_mm is None and unknown.bound_mm is None
    assert len(unknown.record.stages) == 2


def test_a_record_that_failed_does_not_stay_with_the_plant() -> None:
    rig = make_simulated_rig()
    target, watched = rig.teach(30), rig.plant.recorded
    rs.run(rig, rs.Servo(), target, 0.5)
    assert rig.plant.recorded is watched


def test_ctrl_c_leaves_the_arm_at_rest_and_names_the_complete_record(tmp_path: Path) -> None:
    rig = make_simulated_rig()
    target, folder = rig.teach(30), tmp_path / "stopped"

    def press(tick: rs.Tick) -> None:
        if tick.time > 1_500_000_000:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as interrupt:
        rs.run(rig, rs.Servo(), target, record=folder, progress=press)
    assert interrupt.value.args == (folder,)
    assert not rig.arm.measure().enabled and read_record(folder).complete


def test_a_run_that_never_sees_the_markers_names_the_reason() -> None:
    rig = make_simulated_rig(disturbances=[rs.sim.Disturbance.parse("occlusion:at=0")])
    result = rs.run(rig, rs.Servo(), rig.teach(30), 3.0)
    assert (not result.settled and "hidden" in result.cause) or "marker" in result.cause


def test_the_robot_of_the_rig_replaces_the_default_one_and_no_other() -> None:
    tool, mechanism = rs.RigidTool(25.0), rs.PitchYawRcm()
    settings = rs.sim.RigSettings(tool=tool, mechanism=mechanism)
    rig = make_simulated_rig(settings=settings, gate=rs.Gate(slew=(2.0, 2.0, 200.0)))
    servo = rig.adapt(rs.Servo(estimator=rs.FlowEstimator()))
    assert (servo.tool, servo.mechanism) == (tool, mechanism)
    assert servo.gate.slew == (2.0, 2.0, 200.0) and isinstance(servo.estimator, rs.FlowEstimator)
    with pytest.raises(rs.BadInput, match=r"servo\.tool must be left out or equal to that of the"):
        rig.adapt(rs.Servo(tool=rs.RigidTool(31.0)))


def test_a_rig_in_wall_time_must_be_open_and_have_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    simulated = make_simulated_rig()
    simulated.camera.latest = lambda: None
    parts = simulated.arm, simulated.camera, rs.tracking.PointMarkers()
    rig, closed = rs.Rig(*parts, rs.SphericalRcm(), rs.RigidTool(30.0)), list[int]()
    simulated.arm.close = lambda: closed.append(1)
    with pytest.raises(NotReady, match="write `with rig:`"):
        rs.run(rig, rs.Servo(), rs.Target(np.zeros((2, 2)), np.zeros(3)))
    assert "the rig is not open" in str(rig)
    monkeypatch.setattr(rig_module, "FIRST_FRAME_TIMEOUT_S", 0.05)
    with pytest.raises(NotReady, match="has delivered no frame"), rig:
        pass
    assert closed


def make_course(gain: Floats, lag_s: float) -> RunCourse:
    """Return a motion of 3 s whose joints follow the applied rates with gain and lag."""
    now = 5.0 + np.arange(0.0, 3.0, 0.01)
    travel_of = lambda t: np.outer(np.sin(2.0 * (t - 5.0)), [0.2, 0.1, 20.0])  # noqa: E731
    applied = 100.0 * (travel_of(now + 0.01) - travel_of(now))
    q = np.array([0.5, 0.1, 120.0]) + gain * travel_of(np.maximum(now - lag_s, 5.0))
    return RunCourse(now - 5.0, np.zeros_like(q), now, q, applied, np.eye(3), np.zeros(len(now)))


@given(st.lists(st.floats(0.8, 1.2), min_size=3, max_size=3), st.sampled_from([0.0, 0.03, 0.08]))
def test_gain_and_lag_of_the_drives_are_measured(gains: list[float], lag_s: float) -> None:
    response = measure_drive_response(make_course(np.array(gains), lag_s))
    assert response.gain == pytest.approx(gains, rel=0.01)
    assert response.lag_ms == pytest.approx([1e3 * lag_s] * 3, abs=5.1)


def test_a_joint_that_hardly_moved_has_no_response() -> None:
    course = make_course(np.ones(3), 0.02)
    still = replace(course, applied=course.applied * [1.0, 1.0, 0.01])
    response = measure_drive_response(still)
    assert response.gain[2] is None and response.lag_ms[2] is None
    assert response.gain[0] is not None
