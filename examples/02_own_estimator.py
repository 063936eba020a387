"""User-defined estimator, recursive least squares, compared with the default in ten scenes.

python examples/02_own_estimator.py [SEEDS]
rcmservo run --estimator 02_own_estimator:RLS --pixels.forgetting 0.99     # in this folder
"""

import sys
from dataclasses import dataclass

import numpy as np

import rcmservo as rs
from rcmservo.geometry.features import compute_features_jacobian, shift_to_rcm


@dataclass(frozen=True)
class RLS(rs.Estimator):
    """Pixels of both markers as A [p₁ 1]ᵀ, with A (4, 4) by recursive least squares.

    Parameters
    ----------
    forgetting : float
        Forgetting factor: weight of earlier observations at each step, between 0 and 1.
    min_step : float
        Smallest displacement (mm) of marker 1 between two updates.
    """

    forgetting: float = 0.98
    min_step: float = 1.0

    name = "pixels"

    def init(self):
        return np.zeros((4, 4)), 1e6 * np.eye(4), np.full(3, np.inf)

    def update(self, memory, tool, sample):
        A, P, last = memory
        if np.linalg.norm(sample.p1 - last) < self.min_step:
            return memory
        x = np.append(sample.p1, 1.0)
        gain = P @ x / (self.forgetting + x @ P @ x)
        A = A + np.outer(sample.points.ravel() - A @ x, gain)
        return A, (P - np.outer(gain, P @ x)) / self.forgetting, sample.p1

    def jacobian(self, memory, tool, sample):
        return compute_features_jacobian(shift_to_rcm(sample.points, sample.o_c)) @ memory[0][:, :3]

    def recorded_numbers(self, memory):
        return memory[0].ravel()


def pose_error(seed: int, estimator: rs.Estimator) -> float:
    """Return the true pose error of marker 2 in mm after 15 s."""
    rig = rs.sim.Rig(seed, pictures=False)
    plant = rs.Plant(rig.arm, rig.camera, rs.tracking.PointMarkers(), rig.clock)
    rig.move_to_target()
    target = rs.teach(plant)
    rig.move_to_start()
    servo = rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0), estimator)
    for _ in rs.servo_ticks(plant, servo, target, duration=15.0):
        pass
    now, taught = rig.truth.markers(rig.clock.now()), rig.body.points(rig.scene.target)
    return float(np.linalg.norm(now[1] - taught[1]))


if __name__ == "__main__":
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    print("pose error after 15 s, mm\nseed     RLS  default")
    for seed in range(seeds):
        errors = [pose_error(seed, one) for one in (RLS(), rs.DltEstimator())]
        print(f"{seed:4d} {errors[0]:7.2f} {errors[1]:8.2f}")
