"""Explanations of a target whose pixels are not where the camera shows its joints.

Each explanation maps the predicted pixels of both markers to the taught ones with a few unknowns,
such as the axis of a mirror. What remains then of the four differences is its residual.
"""

from typing import NamedTuple

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.safety.checks.facts import DetailFacts

CAMERA_CHANGED = (
    "the camera was moved, turned or zoomed since, the tool was exchanged, a joint does not move "
    "the tool, or the joints have other zeros: check mount, zoom, tool and joints"
)
"""Explanation of equal differences of both markers, and of all that nothing else explains."""

GOOD_FIT = 0.2
"""Largest residual of an explanation, as a fraction of the differences that it explains."""

MIN_EXPLAINED_PX = 4.0
"""Smallest difference (px, root mean square of both markers) that is explained."""


class Explanation(NamedTuple):
    """A possible reason, with the test that decides.

    Parameters
    ----------
    text : str
        Reason and test.
    residual_px : float
        Root mean square of what remains, for each difference that the unknowns leave, px.
    """

    text: str
    residual_px: float


def describe_contradiction(facts: DetailFacts) -> str:
    """Return the distances of the taught markers from their prediction, and what explains them.

    The text is empty if the distances are too small to explain, as at a pose that looks the same.
    """
    taught, predicted = facts.target_points, facts.predicted_target
    first_px, second_px = np.linalg.norm(taught - predicted, axis=1)
    size_px = float(np.hypot(first_px, second_px)) / np.sqrt(2.0)
    if not size_px >= MIN_EXPLAINED_PX:
        return ""
    ranked = rank_explanations(taught, predicted)
    good = [one.text for one in ranked if one.residual_px < GOOD_FIT * size_px]
    reasons = good if CAMERA_CHANGED in good else [*good, CAMERA_CHANGED]
    return (
        f"marker 1 was taught {first_px:.0f} px and marker 2 {second_px:.0f} px from where they "
        f"should be, probably because {'; or '.join(reasons)}"
    )


def rank_explanations(taught: Floats, predicted: Floats) -> list[Explanation]:
    """Return the explanations of the taught pixels (2, 2) by the predicted ones, the best first."""
    sums, differences = taught + predicted, taught - predicted
    mirrored_u, mirrored_v = _vary(sums[:, 0]), _vary(sums[:, 1])
    kept_u, kept_v = np.sum(differences[:, 0] ** 2), np.sum(differences[:, 1] ** 2)
    squares = np.sum(differences**2, axis=1)
    flips = "check the camera's settings for mirroring and rotation"
    candidates = {
        CAMERA_CHANGED: (_vary(differences[:, 0]) + _vary(differences[:, 1]), 2),
        f"the image is mirrored left to right: {flips}": (mirrored_u + kept_v, 3),
        f"the image is mirrored top to bottom: {flips}": (mirrored_v + kept_u, 3),
        f"the image is upside down: {flips}": (mirrored_u + mirrored_v, 2),
        "something else was detected as marker 1 while teaching: look at the taught image": (
            squares[1],
            2,
        ),
        "something else was detected as marker 2 while teaching: look at the taught image": (
            squares[0],
            2,
        ),
    }
    made = [
        Explanation(text, float(np.sqrt(rest / free))) for text, (rest, free) in candidates.items()
    ]
    return sorted(made, key=lambda explanation: explanation.residual_px)


def _vary(values: Floats) -> float:
    """Return the sum of squares of the values (2,) about their mean."""
    return float(np.sum((values - values.mean()) ** 2))
