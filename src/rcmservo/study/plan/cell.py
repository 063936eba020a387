"""Cell of a study: one method in one distribution of scenes under one set of conditions.

A cell is plain text, which can be sent to another machine and compared with the cell of earlier
results.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

from rcmservo.config import toml_json_parsing
from rcmservo.config.servo_json import rebuild_servo
from rcmservo.errors import require
from rcmservo.servo.servo import Servo
from rcmservo.sim import Disturbance
from rcmservo.study.compiled_engine import CompiledEngine
from rcmservo.study.plan.conditions import AUTO, COMPILED, MUJOCO, PICTURES
from rcmservo.study.plan.distribution import Distribution
from rcmservo.study.plan.method import UserEstimators
from rcmservo.study.simulation_engine import SimulationEngine


@dataclass(frozen=True)
class Cell:
    """All inputs of the runs of a cell except their seeds.

    Parameters
    ----------
    method : str
        Name of the method in the study.
    servo : Mapping[str, Any]
        Servo in the notation of records, for the mid-range values of the scenes.
    source : str
        SHA-256 of the user's module in hexadecimal; empty for a built-in estimator.
    condition : str
        Label of scenes, noise, latency and disturbances.
    scenes : str
        Name of the distribution.
    tables : Mapping[str, Any]
        Sections of the distribution.
    vary : Mapping[str, Any]
        Ranges of the distribution.
    disturb : tuple[str, ...]
        Disturbances of every run, in the notation of `--disturb`.
    repetition : int
        Number of the noise sequence of each scene, from 0.
    engine : str
        One of ENGINES.
    duration : float
        Length of each closed loop, s.
    teaching_frames : int
        Number of frames whose mean is the target.
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
    teaching_frames: int

    @cached_property
    def text(self) -> str:
        """The cell as one line of JSON; different cells have different lines."""
        return json.dumps(asdict(self), sort_keys=True)

    @cached_property
    def distribution(self) -> Distribution:
        return Distribution(self.scenes, dict(self.tables), dict(self.vary))

    def rebuild_servo(self, user_estimators: UserEstimators) -> Servo:
        """Return the servo, with the user-defined estimators by name."""
        return rebuild_servo(dict(self.servo), user_estimators)

    def make_engine(self, seed: int, servo: Servo) -> CompiledEngine | SimulationEngine:
        """Return the engine that runs the servo of this cell in the laboratory of a seed.

        The servo is reused if its mechanism and tool are those of the laboratory.
        """
        lab, settings = self.distribution.draw(seed)
        fits_lab = (servo.mechanism, servo.tool) == (lab.mechanism, lab.tool)
        servo = servo if fits_lab else replace(servo, mechanism=lab.mechanism, tool=lab.tool)
        lengths = self.duration, self.teaching_frames
        if self.engine == COMPILED:
            return CompiledEngine(servo, settings, *lengths)
        disturbances, has_pictures = map(Disturbance.read, self.disturb), self.engine == PICTURES
        return SimulationEngine(
            servo, settings, *lengths, tuple(disturbances), has_pictures, lab.markers
        )


def parse_cell(text: str) -> Cell:
    """Return the cell of a line that `Cell.text` returned."""
    table: dict[str, Any] = toml_json_parsing.parse_json(text)
    table["disturb"] = tuple(table["disturb"])
    return Cell(**table)


def choose_engine(
    servos: Iterable[Servo], has_disturbances: bool = False, requested: str = AUTO
) -> str:
    """Return the engine of all runs of a study, so that its methods meet the same plant.

    Parameters
    ----------
    servos : Iterable[Servo]
        Servos of the compared methods.
    has_disturbances : bool
        True if any run has disturbances.
    requested : str
        One of ENGINES, or "auto" for the compiled one if it supports every run, otherwise MuJoCo.

    Raises
    ------
    BadInput
        If the compiled engine is requested but does not support every run.
    """
    is_supported = all(servo.kernel is not None for servo in servos) and not has_disturbances
    if requested == AUTO:
        return COMPILED if is_supported else MUJOCO
    expected = (
        "auto, mujoco or pictures: the compiled engine supports neither disturbances nor "
        "estimators in Python"
    )
    require(is_supported or requested != COMPILED, "engine", requested, expected)
    return requested
