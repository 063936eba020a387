"""Checks of user-defined parts against their contracts, for the user's own tests.

Each function calls one part as the loop does and raises `ContractViolation` for the first rule that
the part breaks, in one sentence that names the method. It returns None for a part that keeps its
contract. docs/own_devices.md explains the rules. For example, in a file of pytest, with ``rs`` the
package `rcmservo`::

    def test_my_arm():
        rs.testing.check_arm(MyArm(), rs.WallClock())

    def test_my_arm_in_motion():  # moves the arm
        rs.testing.check_arm(MyArm(), rs.WallClock(), may_move=True)

    def test_my_camera():
        rs.testing.check_camera(MyCamera(), rs.WallClock())

    def test_my_tracker():
        image = rs.tracking.read_image("both_markers.png")
        frame = rs.Frame(0, 0, 0, image=image)
        rs.testing.check_tracker(MyTracker(), frame, [[312.0, 140.5], [330.0, 201.0]])

    def test_my_estimator():
        rs.testing.check_estimator(MyEstimator())

    def test_my_features():
        rs.testing.check_feature_vector(MyFeatures())
"""

from rcmservo.testing.arm_contract import check_arm
from rcmservo.testing.camera_contract import check_camera
from rcmservo.testing.clock_contract import check_clock
from rcmservo.testing.estimator_contract import check_estimator
from rcmservo.testing.feature_contract import check_feature_vector
from rcmservo.testing.tracker_contract import check_tracker
from rcmservo.testing.violations import ContractViolation

__all__ = [
    "ContractViolation",
    "check_arm",
    "check_camera",
    "check_clock",
    "check_estimator",
    "check_feature_vector",
    "check_tracker",
]
