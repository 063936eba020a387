"""III-C: the flow rule resembles Broyden's update [15]-[17]; which of them settles, and when."""

from rcmservo.experiments.harness.claims import Claim
from rcmservo.experiments.harness.lab.methods import STEP
from rcmservo.experiments.harness.lab.tally import Tallies

CASES = {"broyden": f"displacements of {STEP:g} mm", "broyden-1mm": "displacements of 1 mm"}


def claims(found: Tallies) -> list[Claim]:
    return [*(settles(found, name) for name in CASES), *(sooner(found, name) for name in CASES)]


def settles(found: Tallies, name: str) -> Claim:
    flow, broyden = found.accepted["flow"], found.accepted[name]
    return Claim(
        "Broyden's update settles in no fewer scenes than the flow rule",
        "broyden",
        broyden.settled - flow.settled,
        "% points",
        ">=",
        0.0,
        found.seeds,
        follows=True,
        case=(CASES[name], ""),
        remark=broyden.failures,
        detail=f"{broyden.settled:.0f} % against {flow.settled:.0f} %; Ĵ "
        f"{100 * broyden.jacobian:.0f} % wrong against {100 * flow.jacobian:.0f} %",
        figure="baselines-final",
    )


def sooner(found: Tallies, name: str) -> Claim:
    flow, broyden = found.accepted["flow"], found.accepted[name]
    ratio = broyden.time / flow.time
    return Claim(
        "Broyden's update needs less than half of the flow rule's time",
        "broyden",
        ratio,
        "x the time",
        "<=",
        0.5,
        found.seeds,
        follows=True,
        case=(CASES[name], ""),
        detail=f"{broyden.time:.1f} s against {flow.time:.1f} s, of which {flow.explored:.1f} s "
        "are the exploration from which γ = 0.001 can learn; a run that never settles counts as "
        "the longest",
        figure="baselines-costs",
        trap="T7" if name == "broyden" else "",
        confirmed=ratio <= 0.5,
    )
