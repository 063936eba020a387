"""Disturbances that a user starts while a simulated laboratory runs in wall time."""

from dataclasses import dataclass
from typing import Any

from rcmservo.errors import require
from rcmservo.sim.disturbances.disturbance import Disturbance
from rcmservo.sim.disturbances.disturbance_kinds import LIVE_KINDS
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
        """Add the disturbance to a schedule, or end those that act in it."""
        if self.starts is None:
            schedule.end(self.at)
        else:
            schedule.add(self.starts, self.at)


def parse_live_disturbance(text: str) -> Disturbance:
    """Return the disturbance of a text.

    Parameters
    ----------
    text : str
        Text as of `Disturbance.parse`.

    Raises
    ------
    BadInput
        If the text is invalid, or a laboratory in wall time cannot have its kind.
    """
    disturbance = Disturbance.parse(text)
    expected = "one of " + ", ".join(LIVE_KINDS)
    require(disturbance.kind in LIVE_KINDS, "disturbance", disturbance.kind, expected)
    return disturbance


def list_live_disturbances() -> list[dict[str, Any]]:
    """Return the kinds with their parameters as plain data, for the menu of the page."""
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
        for name, kind in LIVE_KINDS.items()
    ]
