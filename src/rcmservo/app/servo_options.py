"""The settings of the servo's boxes as options: the same for every command that makes a servo."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Annotated, ClassVar

import tyro

from rcmservo.config.kinds import ESTIMATORS, PRESETS
from rcmservo.config.rig_file import Lab
from rcmservo.errors import BadInput
from rcmservo.method.controller import SaturatedController
from rcmservo.method.estimators.affine import AffineEstimator
from rcmservo.method.estimators.base import Estimator
from rcmservo.method.estimators.broyden import BroydenEstimator
from rcmservo.method.estimators.correntropy import CorrentropyEstimator
from rcmservo.method.estimators.dlt import DltEstimator
from rcmservo.method.estimators.flow import FlowEstimator
from rcmservo.method.estimators.kalman import KalmanEstimator
from rcmservo.method.estimators.nflow import NormalisedFlowEstimator
from rcmservo.method.estimators.projection import ProjectionEstimator
from rcmservo.method.estimators.rls import RlsEstimator
from rcmservo.method.exploration import Exploration
from rcmservo.method.imaged_rcm import ImagedRcm
from rcmservo.servo.servo import Servo
from rcmservo.servo.user_estimator import examine

NAMES = (*ESTIMATORS, *PRESETS)
ESTIMATOR_METAVAR = "NAME"
"""What the help calls the name of an estimator; it lists the names of such an option."""
ESTIMATOR = tyro.conf.arg(metavar=ESTIMATOR_METAVAR, help_behavior_hint="")
EstimatorName = Annotated[str, ESTIMATOR]
"""An estimator by its name, or a user's own by that of its class."""
OptionalEstimator = Annotated[str | None, ESTIMATOR]


@dataclass(frozen=True)
class ServoOptions:
    """What can be set of a servo on the command line."""

    OWN: ClassVar[Mapping[str, str]] = {}
    """The fields that hold users' own estimators, by the estimators' names."""

    controller: SaturatedController = field(default_factory=SaturatedController)
    """The law (31) with the saturated potential (32)."""
    exploration: Exploration = field(default_factory=Exploration)
    """How the tool moves while nothing is known yet."""
    imaged_rcm: ImagedRcm = field(default_factory=ImagedRcm)
    """How the imaged RCM is computed: eq. (16) over the most telling lines, then refined; or as
    printed."""
    projection: ProjectionEstimator = field(default_factory=ProjectionEstimator)
    """Ĵ through the projection parameters, rule (21)."""
    dlt: DltEstimator = field(default_factory=DltEstimator)
    """Ĵ through the whole projection, fitted to all frames."""
    affine: AffineEstimator = field(default_factory=AffineEstimator)
    """Ĵ by the markers' places and apparent sizes, which a tracker of pictures tells."""
    flow: FlowEstimator = field(default_factory=FlowEstimator)
    """Ĵ from flow, rule (28)."""
    broyden: BroydenEstimator = field(default_factory=BroydenEstimator)
    """Ĵ by Broyden's rank-1 update."""
    nflow: NormalisedFlowEstimator = field(default_factory=NormalisedFlowEstimator)
    """Ĵ from flow, rule (28) with the speed divided out."""
    rls: RlsEstimator = field(default_factory=RlsEstimator)
    """Ĵ by recursive least squares with forgetting."""
    kalman: KalmanEstimator = field(default_factory=KalmanEstimator)
    """Ĵ by Kalman's filter on its rows."""
    correntropy: CorrentropyEstimator = field(default_factory=CorrentropyEstimator)
    """Ĵ by Kalman's filter with maximum correntropy, against outliers."""

    @property
    def estimators(self) -> dict[str, Estimator]:
        """The estimators by the names that the command line and the results use."""
        fields = {name: name for name in ESTIMATORS} | dict(self.OWN)
        return {name: getattr(self, group) for name, group in fields.items()} | dict(PRESETS)

    def estimator(self, name: str) -> Estimator:
        """The estimator of this name."""
        if name in self.estimators:
            return self.estimators[name]
        near = get_close_matches(name, self.estimators, 1)
        hint = f" (did you mean {near[0]}?)" if near else ""
        right = f"one of {', '.join(NAMES)}, or module:class such as mylab.rls:RLS{hint}"
        raise BadInput("--estimator", name, right)

    def servo(self, name: str, lab: Lab) -> Servo:
        """A servo for a laboratory, with the estimator of this name, which is tried if it is a
        user's own."""
        estimator = self.estimator(name)
        examine(estimator, lab.tool)
        try:
            return Servo(
                mechanism=lab.mechanism,
                tool=lab.tool,
                estimator=estimator,
                controller=self.controller,
                exploration=self.exploration,
                imaged_rcm=self.imaged_rcm,
                gate=lab.gate,
                thresholds=lab.thresholds,
            )
        except BadInput as error:
            box, _, setting = error.field.partition(".")
            typed = hasattr(self, box)
            name = f"--{box}.{setting}".replace("_", "-") if typed else error.field
            raise BadInput(name, error.value, error.right) from error


Boxes = Annotated[ServoOptions, tyro.conf.arg(name="")]
"""The field of a command's options that holds them; its name is no part of theirs."""
