"""Ground truth of a simulated run: the exact joints, markers, Jacobian and imaged RCM.

It serves the evaluation of a run. A servo receives observations only and has no access to it.
"""

import numpy as np

from rcmservo.control.saturated_controller import scale_rows
from rcmservo.interfaces import Floats
from rcmservo.loop.tick import Tick
from rcmservo.recording.writer import Recorder, ThreadedRecorder
from rcmservo.sim.arm import SimulatedArm
from rcmservo.sim.camera_kernels import compute_true_jacobian
from rcmservo.sim.camera_model import CameraModel
from rcmservo.sim.imperfect_markers import BEND_INTERVAL_NS
from rcmservo.sim.tool_body import ToolBody


class GroundTruth:
    """Exact state of a simulated arm and camera, for evaluation.

    Joints q (3,) are in rad, rad, mm; times are in ns on the clock of the simulation.

    Parameters
    ----------
    arm : SimulatedArm
        Simulated arm with its exact joints.
    tool_body : ToolBody
        Tool as points in space.
    camera_model : CameraModel
        Present pose and lens of the simulated camera. `Rig` replaces it when the camera moves.
    """

    def __init__(self, arm: SimulatedArm, tool_body: ToolBody, camera_model: CameraModel) -> None:
        self.arm, self.tool_body, self.camera_model = arm, tool_body, camera_model

    def joints_at(self, time: int) -> Floats:
        """Return the true joints (3,) in rad, rad, mm at a time (ns) within the last second.

        Before that they are the oldest stored joints.
        """
        return self.arm.joints_at(time)

    def markers(self, time: int) -> Floats:
        """Return the true p₁ and p₂ (2, 3) in mm at a time (ns) within the last second.

        Before that they are those at the oldest stored joints.
        """
        before = self.joints_at(time - BEND_INTERVAL_NS)
        return self.tool_body.points(self.joints_at(time), before, time)[:2]

    def pixels(self, q: Floats) -> Floats:
        """Return the true images (2, 2) in px of the markers at the joints q (3,) rad, rad, mm."""
        return self.camera_model.project(self.tool_body.points(q)[:2])

    def imaged_rcm(self) -> Floats:
        """Return the true image o_c (2,) of the RCM in px.

        It is NaN if the direction to the RCM is outside the range of the lens model.
        """
        return self.camera_model.project(np.zeros((1, 3)))[0]

    def jacobian(self, q: Floats, o_c: Floats) -> Floats:
        """Return the true J = ∂y/∂p₁ of the features y = [s r d], eq. (15).

        Parameters
        ----------
        q : array (3,)
            True joints in rad, rad, mm.
        o_c : array (2,)
            Image of the RCM about which the features are taken, px.

        Returns
        -------
        Floats
            J (3, 3), rows in rad/mm, px/mm, px/mm.
        """
        return compute_true_jacobian_at_joints(self.tool_body, self.camera_model, q, o_c)

    def jacobian_error(self, J_hat: Floats, q_measured: Floats, o_c: Floats) -> float:
        """Return the relative error ‖Ĵ − J‖/‖J‖ of an estimated Jacobian.

        The norms are Frobenius norms, after `scale_rows` has made the rows comparable.

        Parameters
        ----------
        J_hat : array (3, 3)
            Ĵ, rows in rad/mm, px/mm, px/mm.
        q_measured : array (3,)
            Measured joints in rad, rad, mm; J is computed at the true joints there.
        o_c : array (2,)
            Image of the RCM about which the features are taken, px.

        Returns
        -------
        float
            Relative error.
        """
        J = scale_rows(self.jacobian(self.arm.drive.true(q_measured), o_c))
        return float(np.linalg.norm(scale_rows(J_hat) - J) / np.linalg.norm(J))

    def jacobian_error_at_tick(self, tick: Tick) -> float:
        """Return the `jacobian_error` of a tick's Ĵ, at the exposure of its newest frame."""
        state = tick.state
        return self.jacobian_error(state.J_hat, tick.observation.q_exposure, state.o_c)

    def record_tick(self, recorder: Recorder | ThreadedRecorder, tick: Tick) -> None:
        """Record a tick, the true markers at the present time, and the error of the tick's Ĵ."""
        p1, p2 = self.markers(self.arm.time)
        recorder.write(tick)
        recorder.write_truth(p1, p2, self.jacobian_error_at_tick(tick))


def compute_true_jacobian_at_joints(
    tool_body: ToolBody, camera_model: CameraModel, q: Floats, o_c: Floats
) -> Floats:
    """Return J (3, 3) of eq. (15) with the true camera, including the distortion of its lens.

    Parameters
    ----------
    tool_body : ToolBody
        Tool as points in space.
    camera_model : CameraModel
        Pose and lens of the camera.
    q : array (3,)
        True joints in rad, rad, mm.
    o_c : array (2,)
        Image of the RCM about which the features are taken, px.

    Returns
    -------
    Floats
        J (3, 3), rows in rad/mm, px/mm, px/mm.
    """
    p1 = tool_body.points(q)[0]
    return compute_true_jacobian(camera_model.lens[0], tool_body.tool.struct, p1, o_c)
