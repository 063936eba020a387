"""What the three features [s r d] give away: point-based servoing on all four marker coordinates
beside them."""

from rcmservo.experiments.harness.claims import Claim
from rcmservo.experiments.harness.lab.methods import OUR_METHODS
from rcmservo.experiments.harness.lab.tally import AS_NEAR, Tallies
from rcmservo.experiments.harness.sentences import OURS
from rcmservo.experiments.harness.statistics import spread

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
    ratio, oftener = ours.times_as_far(points), ours.oftener(points)
    return Claim(
        "our method on [s r d] ends as near the target's pose as a law on all four marker "
        "coordinates",
        OURS,
        ratio.value,
        "x the pose error",
        "<=",
        AS_NEAR,
        found.seeds,
        interval=ratio[1:],
        case=(ours.name, CASES[other]),
        remark="[s r d] drops one of four coordinates, and s lives on the short baseline",
        detail=f"{found.apart(name)}, against {found.apart(other)}; arrived in "
        f"{spread(oftener, '+.0f')} % points more of the scenes, within 1 mm later by "
        f"{spread(ours.later(points), '+.1f')} s{wrong}",
        figure="baselines-final",
    )
