"""A cell of a study: one method, in one distribution of scenes, under one set of conditions. It is
plain text, so that it can be sent to another machine, and so that what was computed of it can be
known again.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

from rcmservo.config import texts
from rcmservo.config.servo_json import rebuild
from rcmservo.errors import require
from rcmservo.servo.servo import Servo
from rcmservo.sim import Disturbance
from rcmservo.study.batch import Study
from rcmservo.study.plan.conditions import AUTO, COMPILED, MUJOCO, PICTURES
from rcmservo.study.plan.distribution import Distribution
from rcmservo.study.plan.method import Own
from rcmservo.study.simulation_engine import Laboratory


@dataclass(frozen=True)
class Cell:
    """All that the runs of a cell depend on, but for their seeds.

    Parameters
    ----------
    method : str
        Its name in the study.
    servo : Mapping[str, Any]
        The servo, as records tell it, in the middle of the scenes' ranges.
    source : str
        SHA-256 of the user's own module, in hexadecimal; empty for ours.
    condition : str
        Scenes, noise, latency and disturbances, in words.
    scenes : str
        The distribution's name.
    tables : Mapping[str, Any]
        Its sections.
    vary : Mapping[str, Any]
        Its ranges.
    disturb : tuple[str, ...]
        What goes wrong in every run, as `--disturb` has it.
    repetition : int
        Which noise of each scene.
    engine : str
        One of ENGINES.
    duration : float
        Length of each closed loop, s.
    shown : int
        Frames that the target is shown for.
    """

    method: str
    servo: Mapping[str, Any]
    source: str
    condition: str
    scenes: str
    tables: Mapping[str, Any]
    vary: Mapping[str, Any]
    disturb: tuple[str, ...]
    repetition: int
    engine: str
    duration: float
    shown: int

    @cached_property
    def text(self) -> str:
        """The cell in one line, which tells it from every other."""
        return json.dumps(asdict(self), sort_keys=True)

    @cached_property
    def distribution(self) -> Distribution:
        return Distribution(self.scenes, dict(self.tables), dict(self.vary))

    def rebuilt(self, own: Own) -> Servo:
        """The servo, with users' own estimators by their names."""
        return rebuild(dict(self.servo), own)

    def engine_for(self, seed: int, servo: Servo) -> Study | Laboratory:
        """What makes the run of a seed, with the cell's servo."""
        lab, settings = self.distribution.laboratory(seed)
        known = (servo.mechanism, servo.tool) == (lab.mechanism, lab.tool)
        servo = servo if known else replace(servo, mechanism=lab.mechanism, tool=lab.tool)
        if self.engine == COMPILED:
            return Study(servo, settings, self.duration, self.shown)
        wrong = tuple(map(Disturbance.read, self.disturb))
        pictures = self.engine == PICTURES
        shown = self.duration, self.shown
        return Laboratory(servo, settings, *shown, wrong, pictures, lab.markers)


def cell_from(text: str) -> Cell:
    """The cell of a line that `text` gave."""
    table: dict[str, Any] = texts.from_json(text)
    table["disturb"] = tuple(table["disturb"])
    return Cell(**table)


def engine_of(servo: Servo, disturb: tuple[str, ...], wanted: str) -> str:
    """The engine for a servo: the one that is `wanted`, or with "auto" the compiled one where that
    can do it.
    """
    compiled = servo.kernel is not None and not disturb
    if wanted == AUTO:
        return COMPILED if compiled else MUJOCO
    right = "auto, mujoco or pictures: neither disturbances nor estimators in Python are compiled"
    require(compiled or wanted != COMPILED, "engine", wanted, right)
    return wanted
