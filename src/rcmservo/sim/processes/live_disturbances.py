"""Trouble that comes while a simulated laboratory runs: what its processes are told of it, and the
menu that it is chosen from."""

from dataclasses import dataclass
from typing import Any

from rcmservo.errors import require
from rcmservo.sim.disturbances.disturbance import Disturbance
from rcmservo.sim.disturbances.kinds import IN_RUNS_ONLY, KINDS
from rcmservo.sim.disturbances.parameters import Number
from rcmservo.sim.disturbances.schedule import Schedule


@dataclass(frozen=True)
class Mischief:
    """What is told to each of the processes, which all count alike."""

    at: int
    """ns of the wall clock."""
    begins: Disturbance | None
    """What begins then; None: all that acts ends."""

    def befalls(self, schedule: Schedule) -> None:
        """Write it into a schedule."""
        if self.begins is None:
            schedule.end(self.at)
        else:
            schedule.add(self.begins, self.at)


def chosen(text: str) -> Disturbance:
    """The disturbance that a person has written, if a laboratory that runs can suffer it."""
    disturbance = Disturbance.parse(text)
    good = [kind for kind in KINDS if kind not in IN_RUNS_ONLY]
    require(disturbance.kind in good, "trouble", disturbance.kind, "one of " + ", ".join(good))
    return disturbance


def menu() -> list[dict[str, Any]]:
    """What there is to choose from, as plain data."""
    return [
        {
            "kind": name,
            "does": kind.does,
            "lasts": kind.lasts is not None,
            "parameters": [
                {
                    "name": key,
                    "default": one.default,
                    "right": one.right,
                    "unit": one.unit if isinstance(one, Number) else "",
                }
                for key, one in kind.parameters.items()
            ],
        }
        for name, kind in KINDS.items()
        if name not in IN_RUNS_ONLY
    ]
