"""A device that answers otherwise than its Protocol says is told so at its first call, in one
sentence.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rcmservo as rs
from conftest import Laboratory, laboratory
from rcmservo.loop.plant import ENABLE_TIMEOUT_S, JOINT_HISTORY, NotEnabled
from rcmservo.tracking import PointMarkers

READ_ONLY = np.zeros(3)
READ_ONLY.flags.writeable = False


class OddArm:
    """The simulated arm, but for what a test has it answer."""

    def __init__(self, lab: Laboratory, **answers: Any) -> None:
        self.arm, self.answers, self.calls = lab.rig.arm, answers, 0

    def enable(self) -> None:
        self.arm.enable()

    def measure(self) -> Any:
        return self.answers.get("measure", self.arm.measure())

    def apply(self, command: rs.Command) -> Any:
        taken = self.arm.apply(command)
        return self.answers.get("apply", taken)


class OddCamera:
    def __init__(self, answer: Any) -> None:
        self.answer = answer

    def latest(self) -> Any:
        return self.answer


class OddTracker:
    def __init__(self, answer: Any) -> None:
        self.answer = answer

    def find(self, frame: rs.Frame) -> Any:
        return self.answer

    def reset(self) -> None:
        pass


def refused(lab: Laboratory) -> str:
    """What a run on the laboratory's plant is refused with; nothing has moved, and the drive is
    off.
    """
    before = lab.rig.arm.q_true
    with pytest.raises(rs.BadInput) as error:
        list(rs.run(lab.plant, lab.servo(), lab.target, 1.0))
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
def test_an_arm_that_measures_something_else(answer: Any) -> None:
    lab = laboratory()
    lab.plant = rs.Plant(OddArm(lab, measure=answer), lab.rig.camera, PointMarkers(), lab.rig.clock)
    said = refused(lab)
    assert said.startswith("OddArm.measure() must be Measured(time in whole ns, q as a writable")
    assert said.endswith(f"got {answer!r}")


@pytest.mark.parametrize("answer", [None, [0.0, 0.0, 0.0], np.zeros(2), READ_ONLY])
def test_an_arm_that_applies_something_else(answer: Any) -> None:
    lab = laboratory()
    lab.plant = rs.Plant(OddArm(lab, apply=answer), lab.rig.camera, PointMarkers(), lab.rig.clock)
    said = refused(lab)
    assert said.startswith(
        "OddArm.apply() must be the joint rates that it applies, a writable float64"
    )


@pytest.mark.parametrize(
    "answer", [[], np.zeros((480, 640, 3), np.uint8), rs.Frame(0, 0.5, 1), rs.Frame(None, 0, 1)]
)
def test_a_camera_that_gives_something_else(answer: Any) -> None:
    lab = laboratory()
    lab.plant = rs.Plant(lab.rig.arm, OddCamera(answer), PointMarkers(), lab.rig.clock)
    said = refused(lab)
    assert said.startswith("OddCamera.latest() must be a Frame with its number and times as whole")


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
def test_a_tracker_that_finds_something_else(answer: Any) -> None:
    lab = laboratory()
    lab.plant = rs.Plant(lab.rig.arm, lab.rig.camera, OddTracker(answer), lab.rig.clock)
    said = refused(lab)
    assert said.startswith("OddTracker.find() must be Markers with points as a writable float64")


class LateArm(OddArm):
    """Its drive is told to be on only some time after it was switched on."""

    late = 0.0

    def enable(self) -> None:
        self.since = self.arm.measure().time

    def measure(self) -> Any:
        measured = self.arm.measure()
        if not measured.enabled and measured.time - self.since >= self.late * 1e9:
            self.arm.enable()
        return self.arm.measure()


@pytest.mark.parametrize("late", [0.1, 0.9 * ENABLE_TIMEOUT_S])
def test_a_drive_that_comes_on_late_is_waited_for(late: float) -> None:
    lab = laboratory()
    arm = LateArm(lab)
    arm.late, arm.since = late, 10**18
    lab.plant = rs.Plant(arm, lab.rig.camera, PointMarkers(), lab.rig.clock)
    *_, last = rs.run(lab.plant, lab.servo(), lab.target, 3.0)
    assert last.state.phase is rs.Phase.SERVO
    *_, again = rs.run(lab.plant, lab.servo(), lab.target, 1.0, state=last.state)
    assert again.state.phase is rs.Phase.SERVO  # it went off in between


def test_a_drive_that_does_not_come_on_in_time_is_told_in_one_sentence_and_left_off() -> None:
    lab = laboratory()
    arm = LateArm(lab)
    arm.late, arm.since = ENABLE_TIMEOUT_S + 0.5, 10**18
    lab.plant = rs.Plant(arm, lab.rig.camera, PointMarkers(), lab.rig.clock)
    with pytest.raises(
        NotEnabled, match=r"LateArm\.measure\(\) must report enabled = True within 2"
    ):
        list(rs.run(lab.plant, lab.servo(), lab.target, 3.0))
    assert not lab.rig.arm.measure().enabled


def test_only_the_first_answer_is_looked_at() -> None:
    lab = laboratory()
    arm = OddArm(lab)
    lab.plant = rs.Plant(arm, lab.rig.camera, PointMarkers(), lab.rig.clock)
    ticks = rs.run(lab.plant, lab.servo(), lab.target, 1.0)
    next(ticks)
    time, q, _ = arm.arm.measure()
    arm.answers = {"measure": [time, q, True]}
    assert next(ticks).seen.q_time == time
    ticks.close()


def test_a_frame_without_a_picture_is_a_damaged_frame_and_not_a_wrong_camera() -> None:
    lab = laboratory()
    lab.plant.tracker = rs.tracking.ColourMarkers()
    frame = replace(lab.rig.camera.latest(), points=None)
    lab.plant.camera = OddCamera(frame)
    *_, last = rs.run(lab.plant, lab.servo(), lab.target, 0.2)
    assert last.seen.frame == -1


class ThriftyArm(OddArm):
    """It tells its joints in one and the same array again and again."""

    def __init__(self, lab: Any) -> None:
        super().__init__(lab)
        self.joints = np.zeros(3)

    def measure(self) -> Any:
        measured = self.arm.measure()
        self.joints[:] = measured.q
        return rs.Measured(measured.time, self.joints, measured.enabled)


def test_a_device_may_fill_one_array_again_and_again() -> None:
    ends = []
    for kind in (None, ThriftyArm):
        lab = laboratory()
        if kind is not None:
            lab.plant = rs.Plant(kind(lab), lab.rig.camera, PointMarkers(), lab.rig.clock)
        *_, last = rs.run(lab.plant, lab.servo(), lab.target, 3.0)
        ends.append((last.state.phase, last.state.J_hat.tobytes()))
    assert ends[0] == ends[1]


def test_the_joints_before_the_oldest_measurement_that_is_stored_are_not_known() -> None:
    lab, camera = laboratory(), OddCamera(None)
    plant, clock = rs.Plant(lab.rig.arm, camera, PointMarkers(), lab.rig.clock), lab.rig.clock
    plant.read()
    clock.wait_until(clock.now() + 50_000_000)
    frame = lab.rig.camera.latest()
    for _ in range(JOINT_HISTORY):
        clock.wait_until(clock.now() + 1_000_000)
        plant.read()
    camera.answer = frame
    seen = plant.read()
    assert seen.frame == frame.number and np.isnan(seen.q_exposure).all()


def test_it_tells_the_sizes_that_the_tracker_tells_but_not_of_a_marker_that_is_lost() -> None:
    lab = laboratory()
    points = np.array([[100.0, 50.0], [np.nan, np.nan]])
    tracker = OddTracker(rs.Markers(points, np.array([9.5, 8.0]), np.array([1.0, 0.0])))
    plant = rs.Plant(lab.rig.arm, lab.rig.camera, tracker, lab.rig.clock)
    assert np.isnan(plant.read().sizes).all(), "no frame yet"
    lab.rig.clock.wait_until(lab.rig.clock.now() + 200_000_000)
    np.testing.assert_array_equal(plant.read().sizes, [9.5, np.nan])
    plant.reset()
    assert np.isnan(plant.read().sizes).all(), "all is forgotten"


@pytest.mark.parametrize("far", [1e6, -1.25e12, 3.7e156, np.inf])
def test_a_marker_where_no_camera_has_a_pixel_is_a_lost_one(far: float) -> None:
    """Or what is learnt from it is no camera's: one such frame made the estimate not finite."""
    lab = laboratory()
    points = np.array([[300.0, 200.0], [310.0, far]])
    told = rs.Markers(points, np.array([9.0, 9.0]), np.ones(2))
    plant = rs.Plant(lab.rig.arm, lab.rig.camera, OddTracker(told), lab.rig.clock)
    while plant.frame is None:
        lab.rig.clock.wait_until(lab.rig.clock.now() + 10_000_000)
        seen = plant.read()
    assert seen.points[0].tolist() == [300.0, 200.0] and seen.sizes[0] == 9.0
    assert np.isnan(seen.points[1]).all() and np.isnan(seen.sizes[1])
    assert points[1, 1] == far


def test_an_observation_tells_how_well_each_marker_was_seen_and_0_of_a_lost_one() -> None:
    lab = laboratory()

    class Telling(rs.tracking.PointMarkers):
        told: Any = np.array([0.9, 0.4])

        def find(self, frame: rs.Frame) -> rs.Markers:
            lost = np.array([[1.0, 1.0], [np.nan, np.nan]])
            found = super().find(frame)
            return replace(found, points=found.points * lost, quality=self.told)

    plant = rs.Plant(lab.rig.arm, lab.rig.camera, Telling(), lab.rig.clock)
    for _ in rs.ticks(plant.clock, duration=0.2):
        seen = plant.read()
    assert seen.quality.tolist() == [0.9, 0.0]
    plant.reset()
    assert np.isnan(plant.read().quality).all()
    Telling.told = np.zeros(3)  # of no use
    for _ in rs.ticks(plant.clock, duration=0.2):
        seen = plant.read()
    assert np.isnan(seen.quality).all()
