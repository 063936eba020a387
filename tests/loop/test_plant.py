"""A device whose first result breaks its protocol is refused with one sentence."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rcmservo as rs
from conftest import Laboratory, make_laboratory
from rcmservo.loop.plant import ENABLE_TIMEOUT_S, JOINT_HISTORY, NotEnabled
from rcmservo.tracking import PointMarkers

READ_ONLY = np.zeros(3)
READ_ONLY.flags.writeable = False


class FaultyArm:
    """Simulated arm with results that a test replaces."""

    def __init__(self, lab: Laboratory, **answers: Any) -> None:
        self.arm, self.answers, self.calls = lab.rig.arm, answers, 0

    def enable(self) -> None:
        self.arm.enable()

    def measure(self) -> Any:
        return self.answers.get("measure", self.arm.measure())

    def apply(self, command: rs.Command) -> Any:
        applied = self.arm.apply(command)
        return self.answers.get("apply", applied)


class FaultyCamera:
    def __init__(self, answer: Any) -> None:
        self.answer = answer

    def latest(self) -> Any:
        return self.answer


class FaultyTracker:
    def __init__(self, answer: Any) -> None:
        self.answer = answer

    def find(self, frame: rs.Frame) -> Any:
        return self.answer

    def reset(self) -> None:
        pass


def refusal(lab: Laboratory) -> str:
    """Return the message with which a run is refused, without motion and with the drive off."""
    before = lab.rig.arm.q_true
    with pytest.raises(rs.BadInput) as error:
        list(rs.servo_ticks(lab.plant, lab.servo(), lab.target, 1.0))
    assert not lab.rig.arm.measure().enabled
    np.testing.assert_allclose(lab.rig.arm.q_true, before, atol=1e-9)
    return str(error.value)


@pytest.mark.parametrize(
    "answer",
    [
        None,
        [0, np.zeros(3), True],
        (0, [0.0, 0.0, 0.0], True),
        (0, np.zeros(3, dtype=np.float32), True),
        (0, np.zeros(2), True),
        (0, READ_ONLY, True),
        (0.5, np.zeros(3), True),
        (0, np.zeros(3), 1),
    ],
)
def test_an_invalid_measurement_is_refused(answer: Any) -> None:
    lab = make_laboratory()
    lab.plant = rs.Plant(
        FaultyArm(lab, measure=answer), lab.rig.camera, PointMarkers(), lab.rig.clock
    )
    message = refusal(lab)
    assert message.startswith(
        "FaultyArm.measure() must be ArmMeasurement(time in whole ns, q as a writable"
    )
    assert message.endswith(f"got {answer!r}")


@pytest.mark.parametrize("answer", [None, [0.0, 0.0, 0.0], np.zeros(2), READ_ONLY])
def test_invalid_applied_rates_are_refused(answer: Any) -> None:
    lab = make_laboratory()
    lab.plant = rs.Plant(
        FaultyArm(lab, apply=answer), lab.rig.camera, PointMarkers(), lab.rig.clock
    )
    message = refusal(lab)
    assert message.startswith(
        "FaultyArm.apply() must be the joint rates that it applies, a writable float64"
    )


@pytest.mark.parametrize(
    "answer", [[], np.zeros((480, 640, 3), np.uint8), rs.Frame(0, 0.5, 1), rs.Frame(None, 0, 1)]
)
def test_an_invalid_frame_is_refused(answer: Any) -> None:
    lab = make_laboratory()
    lab.plant = rs.Plant(lab.rig.arm, FaultyCamera(answer), PointMarkers(), lab.rig.clock)
    message = refusal(lab)
    assert message.startswith(
        "FaultyCamera.latest() must be a Frame with its number and times as whole"
    )


@pytest.mark.parametrize(
    "answer",
    [
        None,
        [],
        np.zeros((2, 2)),
        rs.Markers([[0, 0], [1, 1]], np.ones(2), np.ones(2)),
        rs.Markers(np.ones((2, 2)), [9, 9], np.ones(2)),
    ],
)
def test_invalid_markers_are_refused(answer: Any) -> None:
    lab = make_laboratory()
    lab.plant = rs.Plant(lab.rig.arm, lab.rig.camera, FaultyTracker(answer), lab.rig.clock)
    message = refusal(lab)
    assert message.startswith(
        "FaultyTracker.find() must be Markers with points as a writable float64"
    )


class LateArm(FaultyArm):
    """Arm that reports its drive as on only some time after `enable`."""

    delay_s = 0.0

    def enable(self) -> None:
        self.since = self.arm.measure().time

    def measure(self) -> Any:
        measured = self.arm.measure()
        if not measured.enabled and measured.time - self.since >= self.delay_s * 1e9:
            self.arm.enable()
        return self.arm.measure()


@pytest.mark.parametrize("delay_s", [0.1, 0.9 * ENABLE_TIMEOUT_S])
def test_the_plant_waits_for_a_drive_that_comes_on_late(delay_s: float) -> None:
    lab = make_laboratory()
    arm = LateArm(lab)
    arm.delay_s, arm.since = delay_s, 10**18
    lab.plant = rs.Plant(arm, lab.rig.camera, PointMarkers(), lab.rig.clock)
    *_, last = rs.servo_ticks(lab.plant, lab.servo(), lab.target, 3.0)
    assert last.state.phase is rs.Phase.SERVO
    *_, next_run = rs.servo_ticks(lab.plant, lab.servo(), lab.target, 1.0, state=last.state)
    assert next_run.state.phase is rs.Phase.SERVO  # the drive was off in between


def test_a_drive_that_does_not_come_on_in_time_is_reported_and_stays_off() -> None:
    lab = make_laboratory()
    arm = LateArm(lab)
    arm.delay_s, arm.since = ENABLE_TIMEOUT_S + 0.5, 10**18
    lab.plant = rs.Plant(arm, lab.rig.camera, PointMarkers(), lab.rig.clock)
    with pytest.raises(
        NotEnabled, match=r"LateArm\.measure\(\) must report enabled = True within 2"
    ):
        list(rs.servo_ticks(lab.plant, lab.servo(), lab.target, 3.0))
    assert not lab.rig.arm.measure().enabled


def test_only_the_first_result_is_checked() -> None:
    lab = make_laboratory()
    arm = FaultyArm(lab)
    lab.plant = rs.Plant(arm, lab.rig.camera, PointMarkers(), lab.rig.clock)
    ticks = rs.servo_ticks(lab.plant, lab.servo(), lab.target, 1.0)
    next(ticks)
    time, q, _ = arm.arm.measure()
    arm.answers = {"measure": [time, q, True]}
    assert next(ticks).observation.q_time == time
    ticks.close()


def test_a_frame_without_an_image_is_dropped_as_damaged() -> None:
    lab = make_laboratory()
    lab.plant.tracker = rs.tracking.ColourMarkers()
    frame = replace(lab.rig.camera.latest(), points=None)
    lab.plant.camera = FaultyCamera(frame)
    *_, last = rs.servo_ticks(lab.plant, lab.servo(), lab.target, 0.2)
    assert last.observation.frame == -1


class SharedArrayArm(FaultyArm):
    """Arm that returns its joints in the same array every time."""

    def __init__(self, lab: Any) -> None:
        super().__init__(lab)
        self.joints = np.zeros(3)

    def measure(self) -> Any:
        measured = self.arm.measure()
        self.joints[:] = measured.q
        return rs.ArmMeasurement(measured.time, self.joints, measured.enabled)


def test_a_device_may_reuse_one_array() -> None:
    ends = []
    for kind in (None, SharedArrayArm):
        lab = make_laboratory()
        if kind is not None:
            lab.plant = rs.Plant(kind(lab), lab.rig.camera, PointMarkers(), lab.rig.clock)
        *_, last = rs.servo_ticks(lab.plant, lab.servo(), lab.target, 3.0)
        ends.append((last.state.phase, last.state.J_hat.tobytes()))
    assert ends[0] == ends[1]


def test_joints_before_the_oldest_stored_measurement_are_unknown() -> None:
    lab, camera = make_laboratory(), FaultyCamera(None)
    plant, clock = rs.Plant(lab.rig.arm, camera, PointMarkers(), lab.rig.clock), lab.rig.clock
    plant.read()
    clock.wait_until(clock.now() + 50_000_000)
    frame = lab.rig.camera.latest()
    for _ in range(JOINT_HISTORY):
        clock.wait_until(clock.now() + 1_000_000)
        plant.read()
    camera.answer = frame
    observation = plant.read()
    assert observation.frame == frame.number and np.isnan(observation.q_exposure).all()


@pytest.mark.parametrize(
    ("pause_s", "moves", "is_used"), [(0.02, False, True), (0.3, False, True), (0.1, True, False)]
)
def test_frames_are_ignored_that_show_a_motion_without_readings(
    pause_s: float, moves: bool, is_used: bool
) -> None:
    """Interpolated joints would be those of a straight motion."""
    lab = make_laboratory()
    plant, clock = lab.plant, lab.rig.clock
    for _ in rs.ticks(clock, rate=100.0, duration=0.1):
        before = plant.read()
    if moves:
        lab.rig.arm.place(before.q + 0.2)
    clock.wait_until(clock.now() + round(pause_s * 1e9))
    frame, after = lab.rig.camera.latest(), plant.read()
    assert frame.exposure < clock.now()
    assert (after.frame > before.frame) == is_used


def test_an_own_loop_may_begin_right_after_the_tool_is_moved_by_hand() -> None:
    """A plant that nobody resets must not pair the first frame with joints of the motion."""
    lab, servo = make_laboratory(4), rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0))
    rig = lab.rig
    plant = rs.Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    rig.move_to_target()
    target = rs.teach(plant, frames=30)
    rig.go_home()
    plant.enable()
    state, phases = servo.init(), set[rs.Phase]()
    for _ in rs.ticks(rig.clock, rate=100.0, duration=4.0):
        state = servo.step(state, plant.read(), target)
        plant.send(state.command)
        phases.add(state.phase)
    assert rs.Phase.PAUSED not in phases and state.phase is rs.Phase.SERVO


def test_an_observation_contains_the_sizes_of_detected_markers() -> None:
    lab = make_laboratory()
    points = np.array([[100.0, 50.0], [np.nan, np.nan]])
    tracker = FaultyTracker(rs.Markers(points, np.array([9.5, 8.0]), np.array([1.0, 0.0])))
    plant = rs.Plant(lab.rig.arm, lab.rig.camera, tracker, lab.rig.clock)
    assert np.isnan(plant.read().sizes).all(), "no frame yet"
    lab.rig.clock.wait_until(lab.rig.clock.now() + 200_000_000)
    np.testing.assert_array_equal(plant.read().sizes, [9.5, np.nan])
    plant.reset()
    assert np.isnan(plant.read().sizes).all(), "the reset discards them"


@pytest.mark.parametrize("far", [1e6, -1.25e12, 3.7e156, np.inf])
def test_a_marker_outside_any_image_counts_as_lost(far: float) -> None:
    """One such frame once made the estimate non-finite."""
    lab = make_laboratory()
    points = np.array([[300.0, 200.0], [310.0, far]])
    markers = rs.Markers(points, np.array([9.0, 9.0]), np.ones(2))
    plant = rs.Plant(lab.rig.arm, lab.rig.camera, FaultyTracker(markers), lab.rig.clock)
    while plant.frame is None:
        lab.rig.clock.wait_until(lab.rig.clock.now() + 10_000_000)
        observation = plant.read()
    assert observation.points[0].tolist() == [300.0, 200.0] and observation.sizes[0] == 9.0
    assert np.isnan(observation.points[1]).all() and np.isnan(observation.sizes[1])
    assert points[1, 1] == far


def test_an_observation_contains_the_detection_quality_with_0_for_a_lost_marker() -> None:
    lab = make_laboratory()

    class QualityTracker(rs.tracking.PointMarkers):
        reported: Any = np.array([0.9, 0.4])

        def find(self, frame: rs.Frame) -> rs.Markers:
            lost = np.array([[1.0, 1.0], [np.nan, np.nan]])
            markers = super().find(frame)
            return replace(markers, points=markers.points * lost, quality=self.reported)

    plant = rs.Plant(lab.rig.arm, lab.rig.camera, QualityTracker(), lab.rig.clock)
    for _ in rs.ticks(plant.clock, duration=0.2):
        observation = plant.read()
    assert observation.quality.tolist() == [0.9, 0.0]
    plant.reset()
    assert np.isnan(plant.read().quality).all()
    QualityTracker.reported = np.zeros(3)  # of an invalid shape
    for _ in rs.ticks(plant.clock, duration=0.2):
        observation = plant.read()
    assert np.isnan(observation.quality).all()


@pytest.mark.parametrize("duration", [0.0, -1.0, float("nan")])
def test_an_invalid_duration_of_a_run_is_refused_before_the_drive_is_enabled(
    duration: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = make_laboratory()
    enabled: list[str] = []
    monkeypatch.setattr(lab.plant, "enable", lambda: enabled.append("enabled"))
    with pytest.raises(rs.BadInput, match="duration must be a positive time in s"):
        list(rs.servo_ticks(lab.plant, lab.servo(), lab.target, duration))
    assert not enabled
