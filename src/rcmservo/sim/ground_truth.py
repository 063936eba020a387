"""Ground truth of a simulated run, for its evaluation: true joints, markers, Jacobian, imaged RCM.

No servo can read it.
"""

import numpy as np

from rcmservo.control.saturated_controller import scale_rows
from rcmservo.interfaces import Floats
from rcmservo.loop.tick import Tick
from rcmservo.recording.writer import Recorder
from rcmservo.sim.arm import SimulatedArm
from rcmservo.sim.camera_kernels import compute_true_jacobian
from rcmservo.sim.camera_model import CameraModel
from rcmservo.sim.tool_body import ToolBody


class GroundTruth:
    """Ground truth of a simulated run, read from the true arm and the true camera.

    Parameters
    ----------
    arm : SimulatedArm
        True arm.
    body : ToolBody
        Points of the tool.
    optics : CameraModel
        True camera; the laboratory replaces it when the camera moves.
    """

    def __init__(self, arm: SimulatedArm, body: ToolBody, optics: CameraModel) -> None:
        self.arm, self.body, self.optics, self._drive = arm, body, optics, arm.drive

    def joints_at(self, time: int) -> Floats:
        """Return the true joints (3,) at a time (ns) within the last second."""
        return self.arm.joints_at(time)

    def markers(self, time: int) -> Floats:
        """Return the true p₁ and p₂ (2, 3) mm at a time (ns) within the last second."""
        return self.body.points(self.joints_at(time))[:2]

    def pixels(self, q: Floats) -> Floats:
        """Return the markers' true images (2, 2) px at the joints q (3,)."""
        return self.optics.project(self.body.points(q)[:2])

    def imaged_rcm(self) -> Floats:
        """Return the true image o_c (2,) px of the RCM, NaN where the lens model does not reach."""
        return self.optics.project(np.zeros((1, 3)))[0]

    def jacobian(self, q: Floats, o_c: Floats) -> Floats:
        """Return the true J (3, 3) = ∂y/∂p₁ at the joints q (3,), about the origin o_c (2,) px."""
        return compute_feature_jacobian(self.body, self.optics, q, o_c)

    def jacobian_error(self, J_hat: Floats, q_measured: Floats, o_c: Floats) -> float:
        """Return ‖Ĵ − J‖/‖J‖ (Frobenius norms) of the scaled Jacobians at measured joints (3,)."""
        J = scale_rows(self.jacobian(self._drive.true(q_measured), o_c))
        return float(np.linalg.norm(scale_rows(J_hat) - J) / np.linalg.norm(J))

    def tick_error(self, tick: Tick) -> float:
        """Return the `jacobian_error` of the estimate at a tick."""
        state = tick.state
        return self.jacobian_error(state.J_hat, tick.observation.q_exposure, state.o_c)

    def write(self, recorder: Recorder, tick: Tick) -> None:
        """Record a tick together with the present ground truth."""
        p1, p2 = self.markers(self.arm.time)
        recorder.write(tick)
        recorder.write_truth(p1, p2, self.tick_error(tick))


def compute_feature_jacobian(body: ToolBody, optics: CameraModel, q: Floats, o_c: Floats) -> Floats:
    """Return J (3, 3) of eq. (15) at the joints q (3,), through the true, distorted camera."""
    return compute_true_jacobian(optics.lens[0], body.tool.struct, body.points(q)[0], o_c)
