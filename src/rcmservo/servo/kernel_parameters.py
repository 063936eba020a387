"""Settings of the compiled functions of a tick, and all that these functions share."""

from dataclasses import dataclass
from typing import NamedTuple

from rcmservo.control.exploration import Exploration
from rcmservo.control.feature_vectors import FeatureParameters
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.geometry.imaged_rcm import ImagedRcm
from rcmservo.geometry.kinematics import Rcm
from rcmservo.geometry.tool import Shaft
from rcmservo.numerics.jit import compiled
from rcmservo.safety.gate import Gate
from rcmservo.safety.monitor_state import ObservationRow
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.setpoint import SetpointRow
from rcmservo.servo.state import Stored


@dataclass(frozen=True)
class KernelParameters:
    """Settings of a servo's parts, which no tick changes. Compiled functions take them as one
    row.

    Parameters
    ----------
    rcm : Rcm
        Mechanism, with marker 1 as the point on its tool.
    tool : Shaft
        Position of marker 2 on the tool.
    controller : SaturatedController
        Control law.
    features : FeatureParameters
        Feature vector that the law acts on.
    needs_motion : bool
        Whether the estimator must estimate ∂m/∂p₁ for it.
    printed_potential : bool
        Whether the potential (32) is as printed.
    imaged_rcm : ImagedRcm
        Solution of eq. (16).
    printed_rcm : bool
        Whether eq. (16) is as printed.
    places_rcm : bool
        Whether the estimator gives the imaged RCM.
    spares_marker : bool
        Whether the estimator goes on while one marker is lost.
    gate : Gate
        Bounds on every command.
    thresholds : Thresholds
        Values from which on something is a fault.
    exploration : Exploration
        First motion.
    period : int
        Time from tick to tick, ns.
    """

    rcm: Rcm
    tool: Shaft
    controller: SaturatedController
    features: FeatureParameters
    needs_motion: bool
    printed_potential: bool
    imaged_rcm: ImagedRcm
    printed_rcm: bool
    places_rcm: bool
    spares_marker: bool
    gate: Gate
    thresholds: Thresholds
    exploration: Exploration
    period: int


class TickContext(NamedTuple):
    """All that the compiled parts of a tick read and write, but for the estimator's own memory.

    Parameters
    ----------
    stored : Stored
        State, which the tick writes over.
    observation : ObservationRow
        What the plant read, in the state too.
    setpoint : SetpointRow
        Target and request, in the state too.
    parameters : KernelParameters
        Settings.
    """

    stored: Stored
    observation: ObservationRow
    setpoint: SetpointRow
    parameters: KernelParameters


@compiled
def rcm_of(parameters: KernelParameters) -> Rcm:
    """Return the mechanism and marker 1."""
    known = parameters.rcm
    lower, upper = known.lower, known.upper
    low, high = (lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2])
    return Rcm(known.kind, known.zero, low, high)


@compiled
def shaft_of(parameters: KernelParameters) -> Shaft:
    """Return where the markers are on the tool."""
    return Shaft(parameters.tool.kind, parameters.tool.value)
