"""Disturbances that start while a simulated laboratory runs, and the menu of their kinds."""

from dataclasses import dataclass
from typing import Any

from rcmservo.errors import require
from rcmservo.sim.disturbances.disturbance import Disturbance
from rcmservo.sim.disturbances.disturbance_kinds import DISTURBANCE_KINDS, NOT_LIVE_KINDS
from rcmservo.sim.disturbances.parameters import Number
from rcmservo.sim.disturbances.schedule import Schedule


@dataclass(frozen=True)
class DisturbanceChange:
    """Start or end of disturbances, sent to all processes of the laboratory.

    Parameters
    ----------
    at : int
        Wall time, ns.
    starts : Disturbance or None
        Disturbance that starts; None ends all that act.
    """

    at: int
    starts: Disturbance | None

    def apply(self, schedule: Schedule) -> None:
        """Write it into a schedule."""
        if self.starts is None:
            schedule.end(self.at)
        else:
            schedule.add(self.starts, self.at)


def parse_live_disturbance(text: str) -> Disturbance:
    """Return the disturbance of a text.

    Raises
    ------
    BadInput
        If the text is invalid, or a laboratory in wall time cannot have its kind.
    """
    disturbance = Disturbance.parse(text)
    kinds = [kind for kind in DISTURBANCE_KINDS if kind not in NOT_LIVE_KINDS]
    require(
        disturbance.kind in kinds, "disturbance", disturbance.kind, "one of " + ", ".join(kinds)
    )
    return disturbance


def list_live_disturbances() -> list[dict[str, Any]]:
    """Return the kinds with their parameters, as plain data."""
    return [
        {
            "kind": name,
            "does": kind.effect,
            "lasts": kind.default_duration is not None,
            "parameters": [
                {
                    "name": key,
                    "default": parameter.default,
                    "right": parameter.expected,
                    "unit": parameter.unit if isinstance(parameter, Number) else "",
                }
                for key, parameter in kind.parameters.items()
            ],
        }
        for name, kind in DISTURBANCE_KINDS.items()
        if name not in NOT_LIVE_KINDS
    ]
