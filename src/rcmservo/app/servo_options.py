"""The settings of the servo's boxes as options: the same for every command that makes a servo."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

import tyro

from rcmservo.config.rig_file import Lab
from rcmservo.method.controller import SaturatedController
from rcmservo.method.estimators.base import Estimator
from rcmservo.method.estimators.broyden import BroydenEstimator
from rcmservo.method.estimators.flow import FlowEstimator
from rcmservo.method.estimators.projection import PRINTED, ProjectionEstimator
from rcmservo.method.exploration import Exploration
from rcmservo.method.imaged_rcm import ImagedRcm
from rcmservo.servo.servo import Servo

EstimatorName = Literal["projection", "projection-printed", "flow", "broyden"]


@dataclass(frozen=True)
class ServoOptions:
    """What can be set of a servo on the command line."""

    controller: SaturatedController = field(default_factory=SaturatedController)
    exploration: Exploration = field(default_factory=Exploration)
    imaged_rcm: ImagedRcm = field(default_factory=ImagedRcm)
    projection: ProjectionEstimator = field(default_factory=ProjectionEstimator)
    flow: FlowEstimator = field(default_factory=FlowEstimator)
    broyden: BroydenEstimator = field(default_factory=BroydenEstimator)

    @property
    def estimators(self) -> dict[str, Estimator]:
        """The estimators by the names that the command line and the results use."""
        return {
            "projection": self.projection,
            "projection-printed": PRINTED,
            "flow": self.flow,
            "broyden": self.broyden,
        }

    def servo(self, estimator: EstimatorName, lab: Lab) -> Servo:
        """A servo with these settings for the arm of a laboratory."""
        return Servo(
            mechanism=lab.mechanism,
            tool=lab.tool,
            estimator=self.estimators[estimator],
            controller=self.controller,
            exploration=self.exploration,
            imaged_rcm=self.imaged_rcm,
            gate=lab.gate,
            thresholds=lab.thresholds,
        )


Boxes = Annotated[ServoOptions, tyro.conf.arg(name="")]
"""The field of a command's options that holds them; its name is no part of theirs."""
