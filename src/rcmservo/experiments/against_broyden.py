"""III-C: the flow rule resembles Broyden's update [15]-[17]; which of them arrives, and when."""

from rcmservo.experiments.harness.claims import Claim
from rcmservo.experiments.harness.lab.methods import STEP
from rcmservo.experiments.harness.lab.tally import Tallies
from rcmservo.experiments.harness.statistics import spread

CASES = {"broyden": f"displacements of {STEP:g} mm", "broyden-1mm": "displacements of 1 mm"}


def claims(found: Tallies) -> list[Claim]:
    return [*(arrives(found, name) for name in CASES), *(sooner(found, name) for name in CASES)]


def arrives(found: Tallies, name: str) -> Claim:
    flow, broyden = found.accepted["flow"], found.accepted[name]
    oftener = broyden.oftener(flow)
    return Claim(
        "Broyden's update ends within 1 mm in no fewer scenes than the flow rule",
        "broyden",
        oftener.value,
        "% points",
        ">=",
        0.0,
        found.seeds,
        interval=oftener[1:],
        follows=True,
        case=(CASES[name], ""),
        remark=broyden.failures,
        detail=f"{spread(broyden.success, '.0f')} % against {spread(flow.success, '.0f')} %; Ĵ "
        f"{100 * broyden.jacobian:.0f} % wrong against {100 * flow.jacobian:.0f} %",
        figure="baselines-final",
    )


def sooner(found: Tallies, name: str) -> Claim:
    flow, broyden = found.accepted["flow"], found.accepted[name]
    ratio = broyden.times_as_long(flow)
    return Claim(
        "Broyden's update needs less than half of the flow rule's time to be within 1 mm",
        "broyden",
        ratio.value,
        "x the time",
        "<=",
        0.5,
        found.seeds,
        interval=ratio[1:],
        follows=True,
        case=(CASES[name], ""),
        detail=f"{spread(broyden.time, '.1f')} s against {spread(flow.time, '.1f')} s, of which "
        f"{flow.explored:.1f} s are the exploration from which γ = 0.001 can learn; a run that "
        f"never was counts as {flow.never:.0f} s",
        figure="baselines-costs",
        trap="T7" if name == "broyden" else "",
        confirmed=ratio.value <= 0.5,
    )
