"""PyBullet's iiwa, with its tool held in a port by software, returns to poses taught by a camera.

python examples/pybullet_iiwa.py [SEEDS]     # after: pip install pybullet
"""

import sys

import cv2
import numpy as np
import pybullet as pb
import pybullet_data

import rcmservo as rs

MECHANISM = rs.PitchYawRcm()  # joints q about the port, in axes parallel to PyBullet's world
BALL_1, BALL_2, TIP = 0.3, 0.33, 0.35  # m from the flange; PyBullet's lengths are in m
PORT, AIM, EYE = np.array([[0.55, 0.0, 0.3], [0.55, 0.0, 0.18], [0.7, 0.12, 0.25]])
FLANGE, HOME = 6, (0.0, 0.6, 0.0, -1.5, 0.0, 1.0, 0.0)  # link; robot's joints, rad
STEP_NS, FRAME_NS, DELAY_NS = 5_000_000, 40_000_000, 25_000_000  # of physics, frames, images
VIEW_DEG, IMAGE_PX, SAMPLES = 45.0, (320, 240), (640, 480)  # 2 x 2 samples for each pixel
SHAFT = {"shapeType": pb.GEOM_CYLINDER, "radius": 0.0015, "length": TIP}
BALL = {"shapeType": pb.GEOM_MESH, "fileName": "sphere_smooth.obj", "meshScale": [0.005] * 3}
GREY, GREEN, BLUE = (0.3, 0.3, 0.3, 1.0), (0.0, 0.9, 0.0, 1.0), (0.0, 0.0, 0.9, 1.0)
pb.connect(pb.DIRECT)  # one simulation, without a window


class IiwaLab:
    """Simulated lab that is an `rs.Arm`, an `rs.Camera` and their `rs.Clock`."""

    def __init__(self, eye: np.ndarray) -> None:
        pb.resetSimulation()
        pb.setAdditionalSearchPath(pybullet_data.getDataPath())
        pb.setTimeStep(STEP_NS * 1e-9)
        pb.setGravity(0.0, 0.0, -9.81)
        self.robot = pb.loadURDF("kuka_iiwa/model.urdf", useFixedBase=True)
        self.eye, self.tool, self.time, self.frames = eye, {}, 0, []
        parts = (TIP / 2, GREY, SHAFT), (BALL_1, GREEN, BALL), (BALL_2, BLUE, BALL)
        for distance, colour, shape in parts:
            visual = pb.createVisualShape(rgbaColor=colour, specularColor=(0, 0, 0), **shape)
            self.tool[distance] = pb.createMultiBody(baseVisualShapeIndex=visual)
        self.enabled, self.deadline, self.rates = False, 0, np.zeros(3)

    def tool_pose(self, distance: float) -> tuple:
        """Return the true position and orientation of the shaft `distance` m from the flange."""
        flange = pb.getLinkState(self.robot, FLANGE, computeForwardKinematics=True)[4:6]
        return pb.multiplyTransforms(*flange, (0.0, 0.0, distance), (0.0, 0.0, 0.0, 1.0))

    def solve(self, q: np.ndarray) -> tuple:
        """Return the robot's joints with the shaft in the port, turned and inserted by q."""
        flange = PORT + MECHANISM.position(q) * (1e-3 - BALL_1 / q[2])
        orientation = pb.getQuaternionFromEuler((q[1], np.pi - q[0], 0.0))
        accuracy = {"maxNumIterations": 100, "residualThreshold": 1e-7}
        return pb.calculateInverseKinematics(self.robot, FLANGE, flange, orientation, **accuracy)

    def place(self, q: np.ndarray) -> None:
        joints, self.q_command = HOME, q.copy()
        for _ in range(8):  # each solution starts from the one before
            pb.resetJointStatesMultiDof(self.robot, range(7), [[joint] for joint in joints])
            joints = self.solve(q)

    def now(self) -> int:
        return self.time

    def wait_until(self, time: int) -> None:
        while self.time < time:
            self.enabled = self.enabled and self.time <= self.deadline
            self.q_command += self.enabled * self.rates * STEP_NS * 1e-9  # the measured q lags
            joints = self.solve(self.q_command)
            pb.setJointMotorControlArray(self.robot, range(7), pb.POSITION_CONTROL, joints)
            pb.stepSimulation()
            self.time += STEP_NS
            if self.time % FRAME_NS == 0:
                exposure = self.time // FRAME_NS, self.time, self.time + DELAY_NS
                self.frames = [rs.Frame(*exposure, self.render()), *self.frames[:1]]

    def enable(self) -> None:
        self.enabled, self.deadline, self.rates = True, self.time + 50_000_000, np.zeros(3)

    def measure(self) -> rs.ArmMeasurement:
        ball_1_mm = 1e3 * (np.array(self.tool_pose(BALL_1)[0]) - PORT)
        return rs.ArmMeasurement(self.time, MECHANISM.joints(ball_1_mm), self.enabled)

    def apply(self, command: rs.Command) -> np.ndarray:
        self.enabled, self.deadline = self.enabled and command.enabled, command.deadline
        self.rates = self.enabled * command.rates
        return self.rates

    def latest(self) -> rs.Frame | None:
        return next((one for one in self.frames if one.arrival <= self.time), None)

    def render(self) -> np.ndarray:
        for distance, body in self.tool.items():
            pb.resetBasePositionAndOrientation(body, *self.tool_pose(distance))
        view = pb.computeViewMatrix(self.eye, AIM, (0.0, 0.0, 1.0))
        lens = pb.computeProjectionMatrixFOV(VIEW_DEG, IMAGE_PX[0] / IMAGE_PX[1], 0.02, 3.0)
        rgba = pb.getCameraImage(*SAMPLES, view, lens, shadow=0, renderer=pb.ER_TINY_RENDERER)[2]
        image = cv2.cvtColor(np.reshape(rgba, (*SAMPLES[::-1], 4)), cv2.COLOR_RGBA2BGR)
        return cv2.resize(image, IMAGE_PX, interpolation=cv2.INTER_AREA)


def run_seed(seed: int) -> float:
    """Print and return the true error of ball 2 in mm after a run to a taught pose."""
    random = np.random.default_rng(seed)
    start, target_q = random.uniform((-0.3, -0.3, 80.0), (0.3, 0.3, 140.0), (2, 3))
    lab = IiwaLab(EYE + random.uniform(-0.03, 0.03, 3))
    rig = rs.Rig(lab, lab, rs.tracking.ColourMarkers(), MECHANISM, rs.RigidTool(30.0), lab)
    rig.is_simulated = True  # nobody needs to confirm that the drive is switched on
    lab.place(target_q)
    target, taught = rig.teach(frames=20), np.array(lab.tool_pose(BALL_2)[0])
    lab.place(start)
    result = rs.run(rig, rs.Servo(), target, duration=15.0)
    error_mm = 1e3 * float(np.linalg.norm(lab.tool_pose(BALL_2)[0] - taught))
    print(f"seed {seed}: {error_mm:.2f} mm from the target; {result}", flush=True)
    return error_mm


if __name__ == "__main__":
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    errors_mm = np.array([run_seed(seed) for seed in range(seeds)])
    print(f"{sum(errors_mm <= 1.0)} of {seeds} within 1 mm, median {np.median(errors_mm):.2f} mm")
