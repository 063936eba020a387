"""Settings and shared context of the compiled functions of a tick."""

from dataclasses import dataclass
from typing import NamedTuple

from rcmservo.control.exploration import Exploration
from rcmservo.control.feature_vectors import FeatureParameters
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.geometry.imaged_rcm import ImagedRcm
from rcmservo.geometry.kinematics import RcmStruct
from rcmservo.geometry.tool import ToolStruct
from rcmservo.numerics.jit import compiled
from rcmservo.safety.gate import Gate
from rcmservo.safety.monitor_state import ObservationRow
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.setpoint import SetpointRow
from rcmservo.servo.state import StoredState


@dataclass(frozen=True)
class KernelParameters:
    """Settings of the parts of a servo as one row for compiled functions; no tick changes them.

    Parameters
    ----------
    rcm : RcmStruct
        Mechanism, with marker 1 as the point on its tool.
    tool : ToolStruct
        Position of marker 2 on the tool.
    controller : SaturatedController
        Controller.
    features : FeatureParameters
        Feature vector that the controller acts on.
    needs_markers_jacobian : bool
        True if the features need ∂m/∂p₁ from the estimator.
    uses_paper_potential : bool
        True for the potential exactly as in the paper's eq. (32).
    imaged_rcm : ImagedRcm
        Settings of eq. (16).
    uses_paper_rcm : bool
        True for the paper's eq. (16) without changes.
    estimates_rcm : bool
        True if the estimator computes the imaged RCM.
    tolerates_lost_marker : bool
        True if the estimator continues while one marker is lost.
    gate : Gate
        Bounds on every command.
    thresholds : Thresholds
        Thresholds of the checks.
    exploration : Exploration
        Settings of the exploration.
    period : int
        Time from tick to tick, ns.
    """

    rcm: RcmStruct
    tool: ToolStruct
    controller: SaturatedController
    features: FeatureParameters
    needs_markers_jacobian: bool
    uses_paper_potential: bool
    imaged_rcm: ImagedRcm
    uses_paper_rcm: bool
    estimates_rcm: bool
    tolerates_lost_marker: bool
    gate: Gate
    thresholds: Thresholds
    exploration: Exploration
    period: int


class TickContext(NamedTuple):
    """State, inputs and settings of a tick, shared by its compiled functions.

    The estimator's own memory is not part of it.

    Parameters
    ----------
    stored : StoredState
        State, which the tick overwrites.
    observation : ObservationRow
        Observation of this tick; a part of the state.
    setpoint : SetpointRow
        Target and request of this tick; a part of the state.
    parameters : KernelParameters
        Settings.
    """

    stored: StoredState
    observation: ObservationRow
    setpoint: SetpointRow
    parameters: KernelParameters


@compiled
def make_rcm_struct(parameters: KernelParameters) -> RcmStruct:
    """Return the mechanism with marker 1 as a tuple."""
    rcm, lower, upper = parameters.rcm, parameters.rcm.lower, parameters.rcm.upper
    lower_tuple, upper_tuple = (lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2])
    return RcmStruct(rcm.kind, rcm.zero, lower_tuple, upper_tuple)


@compiled
def make_tool_struct(parameters: KernelParameters) -> ToolStruct:
    """Return the position of marker 2 on the tool as a tuple."""
    return ToolStruct(parameters.tool.kind, parameters.tool.value)
