"""The emulated axes are tuned to the drives behind them."""

import numpy as np

from rcmservo.hardware.galil.emulator.controller import SAMPLE, TCP, Controller
from rcmservo.method.kinematics import SphericalRcm
from rcmservo.sim.arm import Drive, SimulatedArm
from rcmservo.sim.motor_interface import ArmMotors

COUNTS = np.array([50000.0, 50000.0, 500.0])


def test_a_jog_and_its_stop_overshoot_by_a_tenth_at_most() -> None:
    """With the speed fed forward alone it was a quarter, and the servo was told that the joints do
    not follow."""
    arm = SimulatedArm(SphericalRcm(), Drive())
    arm.place(np.array([1.0, 0.2, 100.0]))
    controller = Controller(ArmMotors(arm, COUNTS, 4), 4)
    handle = controller.connect(TCP)
    assert handle is not None
    controller.hear(handle, b"AC ,,500000;DC ,,500000;SH ABC;JG 0,0,10000;BG ABC\r")
    places = []
    for k in range(900):
        if k == 450:
            controller.hear(handle, b"ST ABC\r")
        controller.sample()
        places.append(arm.q_true[2])
    went = np.array(places)
    fast, end = (went[40:450] - went[:410]) / (40 * SAMPLE), went[450:]
    assert 20.0 * 0.97 < fast[-1] < 20.0 * 1.03
    assert fast.max() < 20.0 * 1.10
    assert end.max() - end[-1] < 0.1
