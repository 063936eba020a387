"""Tuning of the emulated axes to the simulated drives."""

import numpy as np

from rcmservo.geometry.kinematics import SphericalRcm
from rcmservo.hardware.galil.emulator.controller import SAMPLE_TIME_S, TCP, GalilController
from rcmservo.sim.arm import Drive, SimulatedArm
from rcmservo.sim.motor_interface import SimulatedMotors

COUNTS = np.array([50000.0, 50000.0, 500.0])


def test_a_jog_and_its_stop_overshoot_by_at_most_10_percent() -> None:
    """Without acceleration feedforward the overshoot was 25 %, a following error of the servo."""
    arm = SimulatedArm(SphericalRcm(), Drive())
    arm.place(np.array([1.0, 0.2, 100.0]))
    controller = GalilController(SimulatedMotors(arm, COUNTS, 4), 4)
    handle = controller.connect(TCP)
    assert handle is not None
    controller.receive(handle, b"AC ,,500000;DC ,,500000;SH ABC;JG 0,0,10000;BG ABC\r")
    positions = []
    for k in range(900):
        if k == 450:
            controller.receive(handle, b"ST ABC\r")
        controller.sample()
        positions.append(arm.q_true[2])
    motion = np.array(positions)
    fast, end = (motion[40:450] - motion[:410]) / (40 * SAMPLE_TIME_S), motion[450:]
    assert 20.0 * 0.97 < fast[-1] < 20.0 * 1.03
    assert fast.max() < 20.0 * 1.10
    assert end.max() - end[-1] < 0.1
