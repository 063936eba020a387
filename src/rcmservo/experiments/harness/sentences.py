"""The paper's sentences that can be measured, in its order: where each stands, and its words."""

from typing import NamedTuple

OURS = "ours"
"""What a claim is about that is not the paper's."""


class Sentence(NamedTuple):
    """A sentence of the paper that can be measured."""

    where: str
    """Its section, equation or figure."""
    words: str
    """The paper's, shortened."""


SENTENCES = {
    "spherical": Sentence(
        "II-B, (1)-(2)",
        "We use the standard spherical coordinates to represent the configuration of the "
        "manipulated tool.",
    ),
    "lambda": Sentence(
        "II-B",
        "For any other feature point along the tool, we can simply express its position vector "
        "as pⱼ = λ pᵢ, for λ as a known scaling factor.",
    ),
    "lemma-1": Sentence(
        "Lemma 1",
        "The projection matrix C of the RCM mechanism has 9 independent degrees of freedom.",
    ),
    "needs-C": Sentence(
        "Remark 2, [12]",
        "The traditional visual servoing approach requires exact knowledge of the calibration "
        "matrix C.",
    ),
    "imaged-rcm": Sentence(
        "III-A, (16)",
        "We numerically estimate the image position of the RCM point by minimising the distance "
        "to H previous image lines (H = 50).",
    ),
    "six": Sentence(
        "III-B",
        "To guarantee the estimation of parameters, we must use P ≥ 6 observations.",
    ),
    "stable-21": Sentence(
        "Proposition 1, (23)",
        "The projection-based update rule (21) enforces a stable (passive) system …",
    ),
    "rank": Sentence(
        "Proposition 1, (25)",
        "For 6 non-collinear sets of vectors m₁ and p₁, the matrix M has full column rank.",
    ),
    "estimates-a": Sentence(
        "Proposition 1, (21)",
        "… which asymptotically estimates the vector of parameters a.",
    ),
    "broyden": Sentence(
        "III-C, [15]-[17]",
        "This approach resembles the rationale of other estimation algorithms, e.g. the Broyden "
        "method.",
    ),
    "stable-28": Sentence(
        "Proposition 2, (30)",
        "For slow and continuous motion of the robot, the flow-based update rule (28) provides "
        "a stable (passive) computation of the terms Ĵᵢⱼ.",
    ),
    "every-instant": Sentence(
        "Remark 3",
        "The algorithm computes a time-varying matrix that closely approximates, at every time "
        "instant t, the differential mapping.",
    ),
    "saturated": Sentence(
        "III-D, (32), Fig. 5",
        "The saturated potential action ∂Vᵢ/∂yᵢ.",
    ),
    "unity": Sentence(
        "III-D",
        "We assume that the online estimation algorithm accurately computes the unknown Jacobian "
        "matrix, in other words, J Ĵ⁻¹ ≈ I.",
    ),
    "stable-33": Sentence(
        "III-D, (33)",
        "V̇ = −k‖∂V/∂y‖² ≤ 0, which proves asymptotic stability of the error Δy.",
    ),
    "sixty": Sentence(
        "IV-A",
        "Visual feedback is captured at 60 fps; the overall motion control system has a "
        "servo-loop of 10 milliseconds.",
    ),
    "gains": Sentence(
        "IV-A, (33)",
        "The velocity controller with gain k = 0.1 and bounds bᵢ = 10.",
    ),
    "regulation-projection": Sentence(
        "IV-B, Fig. 7, Fig. 9",
        "The projection-based method regulates errors of [40, 80, 60].",
    ),
    "regulation-flow": Sentence(
        "IV-B, Fig. 8, Fig. 10",
        "The flow-based method regulates errors of [40, 80, 60].",
    ),
    "model": Sentence(
        "IV-B, Fig. 11",
        "The image point m₁ beside the point π computed with the projection-based estimator.",
    ),
    "flow": Sentence(
        "IV-B, Fig. 12",
        "The measured optical flow beside the vector ω computed with the flow-based estimator.",
    ),
    "noise": Sentence(
        "IV-B, Fig. 12 (noise)",
        "The use of a ‘small’ gain γ helps to remove noise from the output flow estimation.",
    ),
    "real-time": Sentence(
        "IV-B, (21), (28)",
        "Both gradient descent adaptive algorithms can be used to compute the Jacobian matrix in "
        "real-time.",
    ),
    "more-accurate": Sentence(
        "IV-B, last paragraph",
        "The flow-based method provides a more accurate (instantaneous) Jacobian computation …",
    ),
    "no-parameters": Sentence(
        "IV-B, last words",
        "… however in contrast with the projection-based method, it cannot asymptotically "
        "estimate the calibration parameters a.",
    ),
    "showing": Sentence(
        "IV-C, Fig. 13, Fig. 14",
        "The proposed controller can visually reposition the tool into the reference "
        "configurations with a positioning error smaller than 4 mm.",
    ),
    "no-devices": Sentence(
        "IV-C, [9], [20]",
        "… without any additional devices or pose estimation algorithms.",
    ),
    "relocate": Sentence(
        "V",
        "The gradient descent algorithms allow to arbitrarily relocate the camera to observe "
        "different regions of interest.",
    ),
}
"""Every sentence that some experiment measures, by a short name."""
