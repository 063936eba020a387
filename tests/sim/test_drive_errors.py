"""Errors of real arms: encoder offsets and rate errors. The ground truth is free of them."""

import numpy as np
import pytest

import rcmservo as rs
from rcmservo.errors import BadInput
from rcmservo.interfaces import Floats
from rcmservo.loop.teach import teach
from rcmservo.sim import Disturbance, Drive, Rig, RigSettings
from rcmservo.sim.arm import HARD_STOP_RATIO, SimulatedArm
from rcmservo.sim.processes.motion_log import TruePositionError
from rcmservo.tracking import PointMarkers

OFFSET, ERROR = (0.02, -0.03, 1.5), (0.1, -0.2, 0.3)
FAULTY = Drive(encoder_offset=OFFSET, rate_error=ERROR)
START = np.array([0.6, 0.3, 100.0])
RATES = np.array([0.1, -0.2, 5.0])


def moved(drive: Drive, rates: Floats, seconds: float, start: Floats = START) -> SimulatedArm:
    """Return an arm after joint rates (3,) that lasted for some seconds."""
    arm = SimulatedArm(rs.SphericalRcm(), drive)
    arm.place(start)
    arm.control(rates.tolist(), True)
    arm.advance_until(round(seconds * 1e9))
    return arm


def test_encoders_report_joints_with_their_offset() -> None:
    arm = moved(FAULTY, RATES, 1.0)
    np.testing.assert_array_less(
        np.abs(arm.measure().q - arm.q_true - OFFSET), 0.51 * np.array(FAULTY.encoder)
    )
    assert (FAULTY.true(FAULTY.measured(START)) == pytest.approx(START)) and (
        FAULTY.measured(START) != START
    ).all()


def test_every_joint_moves_faster_than_commanded_by_its_rate_error() -> None:
    exact, faulty = (moved(drive, RATES, 1.0).q_true - START for drive in (Drive(), FAULTY))
    np.testing.assert_allclose(faulty / exact, 1.0 + np.array(ERROR), rtol=2e-3)


def test_the_hard_stop_is_at_the_true_joints() -> None:
    arm = moved(FAULTY, np.array([0.0, 0.0, 5.0]), 3.0, np.array([0.6, 0.3, 215.0]))
    lower, upper = arm.mechanism.limits.arrays
    stop = (lower + upper)[2] / 2.0 + HARD_STOP_RATIO * (upper - lower)[2] / 2.0
    assert arm.q_true[2] == pytest.approx(stop, abs=0.5)
    assert arm.measure().q[2] == pytest.approx(arm.q_true[2] + OFFSET[2], abs=0.01)


def test_zero_errors_change_no_bit() -> None:
    none = Drive(encoder_offset=(0.0, 0.0, 0.0), rate_error=(0.0, 0.0, 0.0))
    assert none == Drive()
    arm = moved(none, RATES, 0.5)
    counted = np.round(arm.q_true / arm.drive.encoder) * arm.drive.encoder
    assert arm.measure().q.tobytes() == counted.tobytes()


def test_the_ground_truth_uses_the_true_joints() -> None:
    exact, faulty = (
        Rig(3, RigSettings(drive=drive), pictures=False)
        for drive in (Drive(), Drive(encoder_offset=OFFSET))
    )
    now, o_c = exact.clock.now(), exact.truth.imaged_rcm()
    assert exact.truth.markers(now).tobytes() == faulty.truth.markers(now).tobytes()
    J = exact.truth.jacobian(exact.scene.start, o_c)
    off = [rig.truth.jacobian_error(J, rig.arm.measure().q, o_c) for rig in (exact, faulty)]
    assert max(off) < 1e-3
    assert exact.truth.jacobian_error(J, faulty.arm.measure().q, o_c) > 3e-3


def test_the_true_error_uses_the_true_joints() -> None:
    settings = RigSettings(drive=Drive(encoder_offset=OFFSET))
    rig = Rig(3, settings, pictures=False)
    plant = rs.Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    rig.move_to_target()
    target = teach(plant)

    class Log:
        def last(self) -> dict[str, Floats]:
            return {"q": rig.arm.q_true}

    error = TruePositionError(settings, 0, Log())  # type: ignore[arg-type]
    assert error(target.q) < 0.01
    rig.go_home()
    displacement = rig.body.points(rig.scene.start)[1] - rig.body.points(rig.scene.target)[1]
    assert error(target.q) == pytest.approx(np.linalg.norm(displacement), abs=0.01)


def test_an_encoder_that_is_reversed_continues_from_its_last_reading() -> None:
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
        ({"rate_error": (0.0, -1.0, 0.0)}, "rate_error must be three ratios above -1"),
        ({"rate_error": (0.0, 0.0, 1.1)}, "rate_error must be three ratios above -1"),
        ({"rate_error": (np.nan, 0.0, 0.0)}, "rate_error must be three ratios above -1"),
    ],
)
def test_impossible_drives_are_refused_in_one_sentence(choices: dict, words: str) -> None:
    with pytest.raises(BadInput, match=rf"drive\.{words}"):
        Drive(**choices)
