"""A tick as one compiled function equals the tick made of its parts."""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Literal

import numpy as np
import pytest

from conftest import make_laboratory, mark_others_slow, snapshot
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.estimation.dlt import DltEstimator
from rcmservo.estimation.projection_rule import PAPER_PROJECTION_ESTIMATOR, ProjectionEstimator
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.numerics.structs import replace_fields
from rcmservo.safety.state_machine import Phase
from rcmservo.servo.servo import Servo
from rcmservo.servo.state import EstimatorMemory, State
from rcmservo.sim import Disturbance

Features = Literal["srd", "points"]


@dataclass(frozen=True)
class InterpretedEstimator(Estimator):
    """User-defined estimator that calls a built-in one."""

    name = "interpreted"
    built_in: Estimator = field(default_factory=ProjectionEstimator)

    @property
    def estimates_rcm(self) -> bool:
        return self.built_in.estimates_rcm

    @property
    def tolerates_lost_marker(self) -> bool:
        return self.built_in.tolerates_lost_marker

    def init(self) -> Any:
        return self.built_in.init()

    def update(self, memory: Any, tool: Tool, sample: Sample) -> Any:
        return self.built_in.update(memory, tool, sample)

    def jacobian(self, memory: Any, tool: Tool, sample: Sample) -> Floats:
        return self.built_in.jacobian(memory, tool, sample)

    def filtered_markers(self, memory: Any, tool: Tool, sample: Sample) -> Floats:
        return self.built_in.filtered_markers(memory, tool, sample)

    def markers_jacobian(self, memory: Any, tool: Tool, sample: Sample) -> Floats:
        return self.built_in.markers_jacobian(memory, tool, sample)

    def imaged_rcm(self, memory: Any) -> tuple[Floats, Floats] | None:
        return self.built_in.imaged_rcm(memory)


@lru_cache
def states(disturbance: str, estimator: Estimator, features: Features = "srd") -> list[State]:
    lab = make_laboratory(
        4, disturbances=[Disturbance.parse(disturbance)] if disturbance != "none" else []
    )
    law = SaturatedController(features=features)
    servo = Servo(lab.rig.settings.mechanism, lab.rig.settings.tool, estimator, law)
    lab.rig.begin()
    return [state for _, state in lab.run(servo, 7.0)]


def without_memory(state: State, estimates_rcm: bool) -> State:
    """Return the state without estimator memory, as only one of the two ticks stores the lines.

    The compiled tick needs no lines of eq. (16) for an estimator that computes the imaged RCM.
    """
    if not estimates_rcm:
        return state._replace(memory=EstimatorMemory(state.estimation.line_memory, None))
    estimate = replace_fields(state.stored.estimate, line_count=0)
    return state._replace(stored=replace_fields(state.stored, estimate=estimate), memory=())


DISTURBANCES = [
    "occlusion:at=3,for=0.3,marker=1",
    "none",
    "camera_pan:at=4",
    "gain:at=1.2,for=9,factor=0,axis=2",
]


def tolerated(estimator: Estimator) -> list[str]:
    """Return the disturbances that do not stop a servo with this estimator."""
    return ["none", DISTURBANCES[0]] if estimator.tolerates_lost_marker else ["none"]


@pytest.mark.parametrize("disturbance", mark_others_slow(DISTURBANCES))
@pytest.mark.parametrize(
    "estimator", [ProjectionEstimator(), PAPER_PROJECTION_ESTIMATOR, DltEstimator()]
)
def test_both_kinds_of_tick_give_equal_states_to_the_last_bit(
    disturbance: str, estimator: Estimator
) -> None:
    compiled_states = states(disturbance, estimator)
    python_states = states(disturbance, InterpretedEstimator(estimator))
    assert len(compiled_states) == 700 and any(
        state.phase is Phase.SERVO for state in compiled_states
    )
    causes = {state.cause for state in compiled_states}
    assert any(cause.stop_sentence for cause in causes) == (disturbance not in tolerated(estimator))
    for compiled, interpreted in zip(compiled_states, python_states, strict=True):
        assert snapshot(without_memory(compiled, estimator.estimates_rcm)) == snapshot(
            without_memory(interpreted, estimator.estimates_rcm)
        )


@pytest.mark.parametrize("estimator", [ProjectionEstimator(), DltEstimator()])
def test_both_kinds_of_tick_are_equal_on_marker_coordinates_and_differ_from_srd(
    estimator: Estimator,
) -> None:
    compiled_states = states("none", estimator, "points")
    python_states = states("none", InterpretedEstimator(estimator), "points")
    for compiled, interpreted in zip(compiled_states, python_states, strict=True):
        assert snapshot(without_memory(compiled, estimator.estimates_rcm)) == snapshot(
            without_memory(interpreted, estimator.estimates_rcm)
        )
    assert (
        compiled_states[-1].phase is Phase.SERVO and compiled_states[-1].decision.remaining_mm < 0.2
    )
    by_features = states("none", estimator)
    differences = [
        np.linalg.norm(a.v - b.v) for a, b in zip(compiled_states, by_features, strict=True)
    ]
    assert max(differences) > 1.0


class Halved(ProjectionEstimator):
    """User-defined estimator that derives from a built-in one."""

    def jacobian(self, memory: Any, tool: Tool, sample: Sample) -> Floats:
        return 0.5 * super().jacobian(memory, tool, sample)


def test_an_estimator_derived_from_a_compiled_one_is_called_in_python() -> None:
    built_in, derived = states("none", ProjectionEstimator()), states("none", Halved())
    first = next(k for k, state in enumerate(built_in) if np.any(state.J_hat))
    assert np.array_equal(derived[first].J_hat, 0.5 * built_in[first].J_hat)
