"""What a frame that is believed teaches: where the imaged RCM is, what the camera should see, Ĵ and
the features."""

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats
from rcmservo.loops import all_finite, fill, multiply, put
from rcmservo.memory import scratch, scratch_table
from rcmservo.method.features import (
    along_line,
    measured,
    near_origin,
    shift,
    straight_jacobian,
    wrapped,
)
from rcmservo.method.foresight import image
from rcmservo.method.imaged_rcm import follow
from rcmservo.method.prospect import RCM, see
from rcmservo.rows import Rows
from rcmservo.servo.kernel_parameters import KernelParameters, shaft_of
from rcmservo.servo.state import Estimate, Kept

NOTHING, BELIEVED, LEARN = 0, 1, 2
"""What a tick brought: no frame to believe, one that is believed, or one that Ĵ is learnt from."""


REACH = 800.0
"""px from the markers to the origin of their features at most."""


@compiled
def line_up(
    kept: Rows[Kept], lines: Floats, points: Floats, fixed: Rows[KernelParameters]
) -> tuple[Floats, int]:
    """Take the raw `points` (2, 2), of which one may be lost, into what the camera should see, and
    into the lines of eq. (16), which it gives anew; whether that tells the imaged RCM."""
    e, c = kept[0].estimate, fixed[0].imaged_rcm
    see(kept[0].prospect, e.p1, points, shaft_of(fixed[0]))
    if not all_finite(points):
        return lines, BELIEVED
    lines, count, o_c, condition = follow(
        lines, e.line_count, points, c.refinements, fixed[0].printed_rcm
    )
    put(e.o_c, o_c)
    e.line_count, e.rcm_condition = count, condition
    return lines, LEARN if condition <= c.max_condition else BELIEVED


@compiled
def place_by_fit(kept: Rows[Kept]) -> None:
    """The imaged RCM, as the fit has it, with its covariance."""
    o_c, covariance = scratch(2), scratch_table(2, 2)
    image(kept[0].prospect, RCM, o_c, covariance)
    place_rcm(kept, o_c, covariance)


@compiled
def place_rcm(kept: Rows[Kept], o_c: Floats, covariance: Floats) -> None:
    """The imaged RCM (2,) px with its covariance (2, 2) px²."""
    e = kept[0].estimate
    put(e.o_c, o_c)
    put(e.o_c_covariance, covariance)
    e.rcm_condition = 0.0


@compiled
def learn(kept: Rows[Kept], J_hat: Floats, points: Floats, target: Floats, exposure: int) -> None:
    """Take in the new Ĵ: features of the markers' `points` about the present o_c, and the error to
    the `target`, both (2, 2) px."""
    e = kept[0].estimate
    e.exposure = exposure
    put(e.J_hat, J_hat)
    y, delta = measured(points, target, e.o_c)
    put(e.y, y)
    put(e.delta, delta)


@compiled
def learn_points(kept: Rows[Kept], motion: Floats, points: Floats, target: Floats) -> None:
    """Take in the markers' `motion` ∂m/∂p₁ (4, 3), and how far their `points` are from those of the
    `target`, both (2, 2) px: for a law that acts on these."""
    e = kept[0].estimate
    put(e.motion[:4], motion)
    for k in range(2):
        for i in range(2):
            e.off[2 * k + i] = points[k, i] - target[k, i]


@compiled
def learn_sizes(
    kept: Rows[Kept], motion: Floats, points: Floats, sizes: Floats, target: Floats
) -> None:
    """After `learn_points`, take in ∂R/∂p₁ (2, 3), and how far the apparent radii `sizes` are from
    those of the `target`, both (2,) px.

    What was not seen, as raw `points` (2, 2) px or sizes, asks for nothing. Put where a fit has it,
    it pulls the tool to where the fit is wrong: by 0.5 to 4 mm in rendered scenes, instead of 0.1.
    """
    e = kept[0].estimate
    for k in range(2):
        e.off[4 + k] = sizes[k] - target[k]
        put(e.motion[4 + k], motion[k])
        for i in range(2):
            if not np.isfinite(points[k, i]):
                ask_nothing(e, 2 * k + i)
        if not np.isfinite(sizes[k]):
            ask_nothing(e, 4 + k)


@compiled
def ask_nothing(e: Estimate, k: int) -> None:
    """Leave out the k-th number that the law acts on."""
    e.off[k] = 0.0
    fill(e.motion[k], 0.0)


@compiled
def learn_straight(
    kept: Rows[Kept], motion: Floats, points: Floats, target: Floats, exposure: int
) -> None:
    """`learn` with the features of the line through o_c that passes nearest to both markers, and Ĵ
    of the markers' `motion` ∂m/∂p₁ (4, 3). Where o_c is very far away, as near the camera's image
    plane, a point on the way there takes its place: at the target any origin gives the same."""
    e = kept[0].estimate
    origin, m, m_d = near_origin(e.o_c, points, REACH), scratch(4), scratch(4)
    shift(points, origin, m)
    shift(target, origin, m_d)
    e.exposure, J = exposure, scratch_table(3, 4)
    straight_jacobian(m, J)
    multiply(J, motion, e.J_hat)
    y, y_d = along_line(m), along_line(m_d)
    e.y[0], e.y[1], e.y[2] = y
    e.delta[0], e.delta[1], e.delta[2] = wrapped(y[0] - y_d[0]), y[1] - y_d[1], y[2] - y_d[2]
