"""User-defined estimator, recursive least squares, compared with the default in ten scenes.

python examples/02_own_estimator.py [SCENES]
rcmservo run --estimator 02_own_estimator:RLS --pixels.forgetting 0.99     # in this folder
"""

import sys
from dataclasses import dataclass

import numpy as np

import rcmservo as rs


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
        m = rs.shift_to_rcm(sample.points, sample.o_c)
        return rs.compute_features_jacobian(m) @ memory[0][:, :3]

    def recorded_numbers(self, memory):
        return memory[0].ravel()


if __name__ == "__main__":
    scenes = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    print(rs.compare({"default": rs.DltEstimator(), "pixels": RLS()}, scenes))
