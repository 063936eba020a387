"""Estimate of the imaged RCM, the interaction matrix Ĵ and the features, in numbers."""

from rcmservo.interfaces import Floats
from rcmservo.method.features import FEATURES, MAX_FEATURES
from rcmservo.rows import Row, real, reals, whole


class Estimate(Row):
    """What frames have taught, in numbers; NaN where not known yet."""

    exposure: int = whole("ns", "of the newest frame learnt from, -1 before the first")
    points: Floats = reals((2, 2), "px", "the markers in the newest frame believed")
    p1: Floats = reals(3, "mm", "marker 1 in space at that exposure")
    line_count: int = whole("", "lines of the tool kept for eq. (16)")
    o_c: Floats = reals(2, "px", "the imaged RCM")
    o_c_covariance: Floats = reals((2, 2), "px²", "of o_c, where a fit of the projection tells it")
    rcm_condition: float = real("", "condition of eq. (16), 0 where o_c is of such a fit")
    J_hat: Floats = reals((FEATURES, 3), "rad/mm, px/mm, px/mm", "Ĵ of eq. (14)")
    condition: float = real("", "condition of the scaled Ĵ")
    law_jacobian: Floats = reals((MAX_FEATURES, 3), "", "∂/∂p₁ of the features of the law, per mm")
    law_error: Floats = reals(MAX_FEATURES, "", "their error at the exposure")
    y: Floats = reals(FEATURES, "rad, px, px", "the features, eq. (6)")
    delta: Floats = reals(FEATURES, "rad, px, px", "Δy at the exposure")
    ahead: Floats = reals(FEATURES, "rad, px, px", "Δy as predicted for now")
