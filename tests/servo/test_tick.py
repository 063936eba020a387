"""A tick as one compiled function is the tick of its parts."""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pytest

from conftest import first_quick, frozen, laboratory
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.estimation.dlt import DltEstimator
from rcmservo.estimation.projection_rule import PRINTED, ProjectionEstimator
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.numerics.structs import changed
from rcmservo.safety.state_machine import Phase
from rcmservo.servo.servo import Servo
from rcmservo.servo.state import EstimatorMemory, State
from rcmservo.sim import Disturbance

Features = Literal["srd", "points"]


@dataclass(frozen=True)
class InParts(Estimator):
    """A user's estimator, which does what the built-in one does."""

    name = "in-parts"
    same: Estimator = field(default_factory=ProjectionEstimator)

    @property
    def places_rcm(self) -> bool:
        return self.same.places_rcm

    @property
    def spares_marker(self) -> bool:
        return self.same.spares_marker

    def init(self) -> Any:
        return self.same.init()

    def update(self, memory: Any, tool: Tool, sample: Sample) -> Any:
        return self.same.update(memory, tool, sample)

    def jacobian(self, memory: Any, tool: Tool, sample: Sample) -> Floats:
        return self.same.jacobian(memory, tool, sample)

    def located(self, memory: Any, tool: Tool, sample: Sample) -> Floats:
        return self.same.located(memory, tool, sample)

    def motion(self, memory: Any, tool: Tool, sample: Sample) -> Floats:
        return self.same.motion(memory, tool, sample)

    def imaged_rcm(self, memory: Any) -> tuple[Floats, Floats] | None:
        return self.same.imaged_rcm(memory)


def states(wrong: str, estimator: Estimator, features: Features = "srd") -> list[State]:
    lab = laboratory(4, disturbances=[Disturbance.parse(wrong)] if wrong != "none" else [])
    law = SaturatedController(features=features)
    servo = Servo(lab.rig.settings.mechanism, lab.rig.settings.tool, estimator, law)
    lab.rig.begin()
    return [state for _, state in lab.run(servo, 7.0)]


def but_memory(state: State, placed: bool) -> State:
    """Where a fit places the imaged RCM, nobody asks for the lines of eq. (16): only the parts keep
    them.
    """
    learnt = state.learnt._replace(memory=None)
    if placed:
        learnt = learnt._replace(estimate=changed(learnt.estimate, line_count=0))
    memory = () if placed else EstimatorMemory(learnt.lines, None)
    return state.with_changes(estimation=learnt)._replace(memory=memory)


WRONG = [
    "occlusion:at=3,for=0.3,marker=1",
    "none",
    "camera_pan:at=4",
    "gain:at=1.2,for=9,factor=0,axis=2",
]


def harmless(estimator: Estimator) -> list[str]:
    """What does not stop it."""
    return ["none", WRONG[0]] if estimator.spares_marker else ["none"]


@pytest.mark.parametrize("wrong", first_quick(WRONG))
@pytest.mark.parametrize("estimator", [ProjectionEstimator(), PRINTED, DltEstimator()])
def test_both_routes_say_and_send_the_same_at_every_tick_to_the_last_bit(
    wrong: str, estimator: Estimator
) -> None:
    whole, parts = states(wrong, estimator), states(wrong, InParts(estimator))
    assert len(whole) == 700 and any(state.phase is Phase.SERVO for state in whole)
    told = {state.cause for state in whole}
    assert any(cause.stopping for cause in told) == (wrong not in harmless(estimator))
    for one, other in zip(whole, parts, strict=True):
        placed = estimator.places_rcm
        assert frozen(but_memory(one, placed)) == frozen(but_memory(other, placed))


@pytest.mark.parametrize("estimator", [ProjectionEstimator(), DltEstimator()])
def test_both_routes_go_one_way_on_the_markers_coordinates_too_and_it_is_another_one(
    estimator: Estimator,
) -> None:
    whole, parts = states("none", estimator, "points"), states("none", InParts(estimator), "points")
    for one, other in zip(whole, parts, strict=True):
        placed = estimator.places_rcm
        assert frozen(but_memory(one, placed)) == frozen(but_memory(other, placed))
    assert whole[-1].phase is Phase.SERVO and whole[-1].decision.left < 0.2
    by_features = states("none", estimator)
    gap = [np.linalg.norm(a.v - b.v) for a, b in zip(whole, by_features, strict=True)]
    assert max(gap) > 1.0


class Halved(ProjectionEstimator):
    """A user's own that derives from the built-in one."""

    def jacobian(self, memory: Any, tool: Tool, sample: Sample) -> Floats:
        return 0.5 * super().jacobian(memory, tool, sample)


def test_what_derives_from_a_compiled_estimator_is_called_as_it_is() -> None:
    ours, own = states("none", ProjectionEstimator()), states("none", Halved())
    first = next(k for k, state in enumerate(ours) if np.any(state.J_hat))
    assert np.array_equal(own[first].J_hat, 0.5 * ours[first].J_hat)
