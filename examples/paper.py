"""The paper's method in one file: a tool that pivots about a port returns to a taught pose.

Read it next to *Adaptive Image-based Positioning of RCM Mechanisms Using Angle and Distance
Features*, whose sections, symbols and equation numbers it uses, and run it with either estimator:

    python examples/paper.py projection
    python examples/paper.py flow

Units are mm, px, rad and s. A hat is an estimate, `_d` is desired, `_dot` is a rate. "Choice"
marks what the paper leaves open. The tests of rcmservo compare its compiled functions with these.
"""

import argparse

import numpy as np
from numpy import arctan2, cos, hypot, sin
from numpy.linalg import inv, norm, solve

FRAME_PERIOD = 1.0 / 60.0
SPACING = 30.0  # l, from marker 1 to marker 2 along the shaft
GAIN = 0.1  # k of (31), 1/s
BOUNDS = np.array([np.radians(10.0), 10.0, 10.0])  # b of (32); the paper's 10 is degrees and px
OBSERVATIONS = 10  # P of (20)
GAMMA_0 = np.diag([1e-5] * 6 + [1e-8] * 3)  # the paper's Γ of (21)
FLOW_GAIN = 0.001  # γ of (28), s/mm²


# ---------------------------------------------------------------------------- II-B. Kinematics
def compute_position(q):
    """Return the position p₁ (2) of marker 1 for the configuration q = [θ φ ρ] (1)."""
    theta, phi, rho = q
    return rho * np.array([sin(theta) * cos(phi), sin(theta) * sin(phi), cos(theta)])


def compute_position_jacobian(q):
    """Return ∂p₁/∂q (3, 3), the derivative of (2). It has no inverse at θ = 0."""
    theta, phi, rho = q
    dp1_dtheta = rho * np.array([cos(theta) * cos(phi), cos(theta) * sin(phi), -sin(theta)])
    dp1_dphi = rho * np.array([-sin(theta) * sin(phi), sin(theta) * cos(phi), 0.0])
    return np.column_stack([dp1_dtheta, dp1_dphi, compute_position(q) / rho])


def compute_second_marker(p1):
    """Return p₂ = λ p₁ and ∂p₂/∂p₁. Choice: λ = 1 + l/ρ as on a rigid shaft, not a constant."""
    rho = norm(p1)
    across = np.eye(3) - np.outer(p1, p1) / rho**2  # projection onto the plane across the shaft
    return p1 + SPACING / rho * p1, np.eye(3) + SPACING / rho * across


# -------------------------------------------------------------- II-E. Parameters of the camera
def extract_parameters(C):
    """Return the parameters a (9,) that remain of a calibration matrix C (3, 4) by Lemma 1."""
    o_c = C[:2, 3] / C[2, 3]  # image of the RCM p = 0, which is the pixel origin in (10)
    shifted = C - np.outer([*o_c, 0.0], C[2])  # now c₁₄ = c₂₄ = 0 (11)
    return (shifted[:, :3] / C[2, 3]).ravel()  # c₃₄ = 1, the others are a (12)


def project(a, p):
    """Return m, the image (4) of p relative to o_c, and ∂m/∂p (2, 3). With â, m is π (34)."""
    G, g = a[:6].reshape(2, 3), a[6:]  # (13)
    z = g @ p + 1.0
    m = G @ p / z
    return m, (G - np.outer(m, g)) / z


# ----------------------------------------------------------- II-D, II-F. Features, their Jacobian
def compute_features(m):
    """Return y = [s r d] (7) of the markers m = [u₁ v₁ u₂ v₂] (6) relative to o_c."""
    u1, v1, u2, v2 = m
    s = arctan2(v2 - v1, u2 - u1)  # (8)
    return np.array([s, hypot(u1, v1), hypot(u2 - u1, v2 - v1)])  # r and d (9)


def compute_feature_error(y, y_d):
    """Return Δy = y − y_d, with its angle between −π and π."""
    s, r, d = y - y_d
    return np.array([arctan2(sin(s), cos(s)), r, d])


def compute_features_jacobian(m):
    """Return ∂y/∂m (3, 4), the first factor of (15)."""
    u1, v1, u2, v2 = m
    _, r, d = compute_features(m)
    ds_dm2, dd_dm2 = np.array([v1 - v2, u2 - u1]) / d**2, np.array([u2 - u1, v2 - v1]) / d
    return np.array([[*-ds_dm2, *ds_dm2], [u1 / r, v1 / r, 0.0, 0.0], [*-dd_dm2, *dd_dm2]])


def compute_estimated_jacobian(a, p1):
    """Return J of ẏ = J ṗ₁ (14) by (15); with â it is Ĵ. Choice: m is predicted, not measured."""
    p2, dp2_dp1 = compute_second_marker(p1)
    (m1, dm1_dp1), (m2, dm2_dp2) = project(a, p1), project(a, p2)
    dm_dp1 = np.vstack([dm1_dp1, dm2_dp2 @ dp2_dp1])
    return compute_features_jacobian(np.concatenate([m1, m2])) @ dm_dp1


# ---------------------------------------------------------------------- III-A. The imaged RCM
def intersect_lines(lines):
    """Return o_c (16), the point nearest to H lines through raw markers [ũ₁ ṽ₁ ũ₂ ṽ₂] (H, 4)."""
    m1, along = lines[:, :2], lines[:, 2:] - lines[:, :2]
    n = np.column_stack([-along[:, 1], along[:, 0]]) / norm(along, axis=1)[:, None]
    return solve(n.T @ n, n.T @ np.sum(n * m1, axis=1))  # Σ n nᵀ o_c = Σ n nᵀ m̃₁


# ----------------------------------------------------------- III-B. Projection-based estimation
def build_regressor(m1, p1):
    """Return W (2, 9) (19), with which the projection error (17) is e = W â − m₁ = W Δa (18)."""
    (u1, v1), zero = m1, np.zeros(3)
    return np.array([[*p1, *zero, *(-u1 * p1)], [*zero, *p1, *(-v1 * p1)]])


def compute_parameter_rate(a_hat, M, m, gamma):
    """Return dâ/dt of rule (21), which descends the gradient Mᵀe of Q = ½ eᵀe (20).

    M (24) stacks W of P observations, and m their m₁, so that e = M â − m = M Δa. The error
    U = ½ Δaᵀ Γ⁻¹ Δa (22) of â then decreases at the rate |M Δa|² (23).
    """
    return -gamma @ M.T @ (M @ a_hat - m)


class ProjectionEstimator:
    """Estimator of Ĵ by the parameters â, which are fitted to random observations."""

    def __init__(self):
        self.a_hat, self.observations = np.zeros(9), []
        self.random = np.random.default_rng(0)

    def update(self, m, p1):
        """Return Ĵ after another frame, with the markers m relative to o_c."""
        # Choice: observations are 2 mm apart, and each frame draws P of all. By (25) their p₁ must
        # span space, which those of a resting tool do not.
        if not self.observations or norm(p1 - self.observations[-1][1]) > 2.0:
            self.observations.append((m[:2], p1))
        drawn = self.random.choice(len(self.observations), OBSERVATIONS)
        M = np.vstack([build_regressor(*self.observations[i]) for i in drawn])
        pixels = np.concatenate([self.observations[i][0] for i in drawn])
        # Choice: with Γ₀ rule (21) takes hours. With this Γ, which (23) allows as well, the part of
        # Δa that M observes decays at 2/s.
        gamma = 2.0 * inv(M.T @ M + 1e-6 * inv(GAMMA_0))
        a_hat_dot = compute_parameter_rate(self.a_hat, M, pixels, gamma)
        self.a_hat = self.a_hat + FRAME_PERIOD * a_hat_dot
        return compute_estimated_jacobian(self.a_hat, p1)


# ----------------------------------------------------------------- III-C. Flow-based estimation
def compute_jacobian_rate(J_hat, p1_dot, y_dot):
    """Return dĴ/dt of rule (28), which descends the gradient of F = ½ |Ĵ ṗ₁ − ẏ|² (27).

    The error R = |ΔJ|² / 2γ of each row of Ĵ (29) then decreases at the rate (ΔJ ṗ₁)² (30).
    """
    omega = J_hat @ p1_dot  # flow (35) that Ĵ predicts for ẏ (26)
    return -FLOW_GAIN * np.outer(omega - y_dot, p1_dot)


class FlowEstimator:
    """Estimator of Ĵ by the motion of tool and features from frame to frame."""

    def __init__(self):
        self.J_hat, self.last = np.zeros((3, 3)), None

    def update(self, m, p1):
        y = compute_features(m)
        if self.last is not None:
            y_dot = compute_feature_error(y, self.last[0]) / FRAME_PERIOD
            p1_dot = (p1 - self.last[1]) / FRAME_PERIOD
            J_hat_dot = compute_jacobian_rate(self.J_hat, p1_dot, y_dot)
            self.J_hat = self.J_hat + FRAME_PERIOD * J_hat_dot
        self.last = y, p1
        return self.J_hat


# ---------------------------------------------------------------------------- III-D. Controller
def compute_velocity(J_hat, delta):
    """Return v = ṗ₁ (31). With J Ĵ⁻¹ = I it makes ẏ = −k ∂V/∂y (33), and Δy vanishes."""
    # Choice: ∂V/∂y (32) is ±b beyond b, as in Fig. 5. As printed, it drops to half of that at b.
    gradient = np.clip(delta, -BOUNDS, BOUNDS)
    return -GAIN * solve(J_hat, gradient)


# ------------------------------------------------------------------------------- IV. Experiment
class Laboratory:
    """Simulated arm and camera. The method calls `observe` and `move` and does not know C."""

    def __init__(self, seed):
        self.random = np.random.default_rng(seed)
        z = np.array([0.0, 0.0, 1.0]) + self.random.uniform(-0.5, 0.5, 3)  # optical axis
        x = np.cross([0.0, 1.0, 0.0], z)
        rotation = [axis / norm(axis) for axis in (x, np.cross(z, x), z)]
        K = np.array([[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]])
        translation = self.random.uniform([-30.0, -60.0, 300.0], [30.0, 0.0, 400.0])
        self.C = K @ np.column_stack([rotation, translation])
        self.q = self.target = np.array([0.5, 0.3, 100.0])
        self.start = self.target + self.random.uniform([0.15, 0.2, -20.0], [0.25, 0.4, -10.0])

    def observe(self):
        """Return the raw markers (4,) of a frame, with noise of 0.2 px, and q at its exposure."""
        p1 = compute_position(self.q)
        points = np.column_stack([p1, compute_second_marker(p1)[0]])
        projected = self.C @ np.vstack([points, [1.0, 1.0]])  # z [m̃ 1]ᵀ of (4), with m̃ = [ũ ṽ] (3)
        m = projected[:2] / projected[2]  # the last row is z (5)
        return self.random.normal(m.T.ravel(), 0.2), self.q

    def move(self, q_dot):
        """Move the joints at the rates q̇ until the next frame."""
        self.q = self.q + FRAME_PERIOD * q_dot

    def compute_errors(self, J_hat):
        """Return |p₂ − p_d| and the relative error of Ĵ: the truth, unknown to the method."""
        p2, p_d = (compute_second_marker(compute_position(q))[0] for q in (self.q, self.target))
        J = compute_estimated_jacobian(extract_parameters(self.C), compute_position(self.q))
        return norm(p2 - p_d), norm((J_hat - J).T / BOUNDS) / norm(J.T / BOUNDS)


def run(estimator, lab, taught, duration=100.0):
    """Explore, then return to the pose with the raw markers `taught`. Yield Δy and Ĵ."""
    record, frequencies = [], np.array([1.0, 1.5, 2.0])  # rad/s of θ, φ, ρ
    # Choice: Ĵ = 0 and â = 0 have no inverse for (31), so the tool first swings in all joints.
    for time in np.arange(0.0, 20.0, FRAME_PERIOD):
        raw, q = lab.observe()
        record.append((raw, compute_position(q)))
        lab.move([0.2, 0.4, 40.0] * sin(frequencies * time + [0.0, 1.0, 2.0]))
    # Choice: H = 50 lines of the whole exploration, as the last H of a slow motion coincide.
    lines = np.array([raw for raw, _ in record[:: len(record) // 50]])
    origin = np.tile(intersect_lines(lines), 2)
    for raw, p1 in record:
        estimator.update(raw - origin, p1)
    y_d = compute_features(taught - origin)
    for _ in np.arange(0.0, duration, FRAME_PERIOD):
        raw, q = lab.observe()
        J_hat = estimator.update(raw - origin, compute_position(q))
        delta = compute_feature_error(compute_features(raw - origin), y_d)
        yield delta, J_hat
        lab.move(solve(compute_position_jacobian(q), compute_velocity(J_hat, delta)))


if __name__ == "__main__":
    estimators = {"projection": ProjectionEstimator, "flow": FlowEstimator}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("estimator", choices=estimators)
    parser.add_argument("--seed", type=int, default=0, help="seed of camera, start and noise")
    options = parser.parse_args()
    lab = Laboratory(options.seed)
    taught = np.mean([lab.observe()[0] for _ in range(30)], axis=0)
    lab.q = lab.start
    print(" time      Δs        Δr        Δd     pose error   error of Ĵ")
    for frame, (delta, J_hat) in enumerate(run(estimators[options.estimator](), lab, taught)):
        if frame % 600 == 0:
            row = frame // 60, np.degrees(delta[0]), *delta[1:], *lab.compute_errors(J_hat)
            print("{:3d} s {:6.1f}° {:6.1f} px {:6.1f} px {:9.2f} mm {:10.1%}".format(*row))
    print(f"The tool is {lab.compute_errors(J_hat)[0]:.2f} mm from the taught pose.")
