"""What real arms have: encoders that count from a wrong zero, and motors that make more or less of
a rate than they are asked for. The truth stays the truth, and hard stops are where they are."""

import numpy as np
import pytest

import rcmservo as rs
from rcmservo.errors import BadInput
from rcmservo.interfaces import Floats
from rcmservo.loop.teach import teach
from rcmservo.sim import Disturbance, Drive, Rig, RigSettings
from rcmservo.sim.arm import HARD_STOP, SimulatedArm
from rcmservo.sim.processes.motion_log import TrueError
from rcmservo.tracking import PointMarkers

OFFSET, ERROR = (0.02, -0.03, 1.5), (0.1, -0.2, 0.3)
WRONG = Drive(encoder_offset=OFFSET, rate_error=ERROR)
START = np.array([0.6, 0.3, 100.0])
RATES = np.array([0.1, -0.2, 5.0])


def moved(drive: Drive, rates: Floats, seconds: float, start: Floats = START) -> SimulatedArm:
    """An arm that was asked for joint rates (3,) for some seconds."""
    arm = SimulatedArm(rs.SphericalRcm(), drive)
    arm.place(start)
    arm.control(rates.tolist(), True)
    arm.advance_until(round(seconds * 1e9))
    return arm


def test_an_arm_tells_joints_that_are_off_by_the_offset() -> None:
    arm = moved(WRONG, RATES, 1.0)
    np.testing.assert_array_less(
        np.abs(arm.measure().q - arm.q_true - OFFSET), 0.51 * np.array(WRONG.encoder)
    )
    assert (WRONG.true(WRONG.told(START)) == pytest.approx(START)) and (
        WRONG.told(START) != START
    ).all()


def test_every_joint_moves_by_its_share_faster_than_it_is_asked_to() -> None:
    right, wrong = (moved(drive, RATES, 1.0).q_true - START for drive in (Drive(), WRONG))
    np.testing.assert_allclose(wrong / right, 1.0 + np.array(ERROR), rtol=2e-3)


def test_the_hard_stop_is_at_the_true_joints() -> None:
    arm = moved(WRONG, np.array([0.0, 0.0, 5.0]), 3.0, np.array([0.6, 0.3, 215.0]))
    lower, upper = arm.mechanism.limits.arrays
    stop = (lower + upper)[2] / 2.0 + HARD_STOP * (upper - lower)[2] / 2.0
    assert arm.q_true[2] == pytest.approx(stop, abs=0.5)
    assert arm.measure().q[2] == pytest.approx(arm.q_true[2] + OFFSET[2], abs=0.01)


def test_no_error_is_no_change_to_the_last_bit() -> None:
    none = Drive(encoder_offset=(0.0, 0.0, 0.0), rate_error=(0.0, 0.0, 0.0))
    assert none == Drive()
    arm = moved(none, RATES, 0.5)
    counted = np.round(arm.q_true / arm.drive.encoder) * arm.drive.encoder
    assert arm.measure().q.tobytes() == counted.tobytes()


def test_the_judge_of_a_run_knows_the_true_joints() -> None:
    right, wrong = (
        Rig(3, RigSettings(drive=drive), pictures=False)
        for drive in (Drive(), Drive(encoder_offset=OFFSET))
    )
    now, o_c = right.clock.now(), right.truth.imaged_rcm()
    assert right.truth.markers(now).tobytes() == wrong.truth.markers(now).tobytes()
    J = right.truth.jacobian(right.scene.start, o_c)
    off = [rig.truth.jacobian_error(J, rig.arm.measure().q, o_c) for rig in (right, wrong)]
    assert max(off) < 1e-3
    assert right.truth.jacobian_error(J, wrong.arm.measure().q, o_c) > 3e-3


def test_how_far_a_tool_is_from_where_it_was_shown_is_told_by_the_true_joints() -> None:
    settings = RigSettings(drive=Drive(encoder_offset=OFFSET))
    rig = Rig(3, settings, pictures=False)
    plant = rs.Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    rig.show_target()
    target = teach(plant)

    class Log:
        def last(self) -> dict[str, Floats]:
            return {"q": rig.arm.q_true}

    error = TrueError(settings, Log())  # type: ignore[arg-type]
    assert error(target.q) < 0.01
    rig.go_home()
    way = rig.body.points(rig.scene.start)[1] - rig.body.points(rig.scene.target)[1]
    assert error(target.q) == pytest.approx(np.linalg.norm(way), abs=0.01)


def test_an_encoder_that_begins_to_count_backwards_goes_on_from_what_it_told() -> None:
    rig = Rig(
        0,
        RigSettings(drive=Drive(encoder_offset=OFFSET)),
        pictures=False,
        disturbances=[Disturbance.parse("encoder:at=0.05,axis=3")],
    )
    before = rig.arm.measure().q
    rig.begin()
    rig.clock.wait_until(rig.clock.now() + 100_000_000)
    np.testing.assert_allclose(rig.arm.measure().q, before, atol=3e-3)


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        ({"encoder_offset": (0.0, np.nan, 0.0)}, "encoder_offset must be three finite numbers"),
        ({"encoder_offset": (0.0, 0.0)}, "encoder_offset must be three finite numbers"),
        ({"rate_error": (0.0, -1.0, 0.0)}, "rate_error must be three shares above -1"),
        ({"rate_error": (0.0, 0.0, 1.1)}, "rate_error must be three shares above -1"),
        ({"rate_error": (np.nan, 0.0, 0.0)}, "rate_error must be three shares above -1"),
    ],
)
def test_what_no_drive_has_is_one_sentence(choices: dict, words: str) -> None:
    with pytest.raises(BadInput, match=rf"drive\.{words}"):
        Drive(**choices)
