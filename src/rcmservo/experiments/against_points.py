"""What the three features [s r d] give away: point-based servoing on all four marker coordinates
beside them."""

from rcmservo.experiments.harness.claims import Claim
from rcmservo.experiments.harness.lab.methods import OUR_METHODS
from rcmservo.experiments.harness.lab.tally import Tallies
from rcmservo.experiments.harness.sentences import OURS

AS_NEAR = 1.25
"""Ratio of pose errors up to which two methods end equally near."""

CASES = {
    "constant": "one constant 4x3 Jacobian, learnt",
    "points-exact": "exact calibration",
    "points-wrong": "wrong calibration",
}


def claims(found: Tallies) -> list[Claim]:
    return [as_near(found, name, other) for name in OUR_METHODS for other in CASES]


def as_near(found: Tallies, name: str, other: str) -> Claim:
    ours, points = found.accepted[name], found.accepted[other]
    wrong = f"; {found.conditions.miscalibration.words}" if other == "points-wrong" else ""
    return Claim(
        "our method on [s r d] ends as near the target's pose as a law on all four marker "
        "coordinates",
        OURS,
        ours.pose / points.pose,
        "x the pose error",
        "<=",
        AS_NEAR,
        found.seeds,
        case=(ours.name, CASES[other]),
        remark="[s r d] drops one of four coordinates, and s lives on the short baseline",
        detail=f"{found.apart(name)} against {found.apart(other)}; settled "
        f"{ours.settled:.0f} % against {points.settled:.0f} %, after {ours.time:.1f} s against "
        f"{points.time:.1f} s{wrong}",
        figure="baselines-final",
    )
