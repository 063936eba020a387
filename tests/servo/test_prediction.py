"""Prediction of the error for the present joints, compared with later frames."""

import numpy as np

import rcmservo as rs
from rcmservo.sim import Rig, RigSettings
from rcmservo.tracking import PointMarkers

SCALE = np.array([np.deg2rad(10.0), 10.0, 10.0])
"""Scale of s (rad), r and d (px) in sums of errors."""


def test_the_predicted_error_is_closer_to_the_present_one_than_the_last_measured_error() -> None:
    """The newest frame is at least 20 ms old while the tool moves."""
    rig = Rig(2, RigSettings(point_noise=0.0), pictures=False)
    plant = rs.Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    servo = rs.Servo(rs.SphericalRcm(), rs.RigidTool(30.0))
    rig.move_to_target()
    target = rs.teach(plant, 30)
    rig.go_home()
    ticks = [
        t for t in rs.servo_ticks(plant, servo, target, 3.0) if t.state.phase is rs.Phase.SERVO
    ]
    measured = {t.observation.exposure: t.state.estimation.estimate.delta for t in ticks}
    predicted, last = 0.0, 0.0
    for tick in ticks:
        nearest = min(measured, key=lambda exposure: abs(exposure - tick.observation.now))
        if abs(nearest - tick.observation.now) < 2_000_000:
            present, estimate = measured[nearest], tick.state.estimation.estimate
            predicted += float(np.linalg.norm((estimate.predicted_delta - present) / SCALE))
            last += float(np.linalg.norm((estimate.delta - present) / SCALE))
    assert predicted < 0.3 * last
