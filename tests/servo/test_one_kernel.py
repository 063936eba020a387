"""A tick as one compiled function is the tick of its parts."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from conftest import first_quick, frozen, laboratory
from rcmservo.guard.states import Phase
from rcmservo.interfaces import Floats
from rcmservo.method.estimators.base import Estimator, Sample
from rcmservo.method.estimators.dlt import DltEstimator
from rcmservo.method.estimators.projection import PRINTED, ProjectionEstimator
from rcmservo.method.tool import Tool
from rcmservo.servo.servo import Servo
from rcmservo.servo.state import State
from rcmservo.sim import Disturbance


@dataclass(frozen=True)
class InParts(Estimator):
    """A user's estimator, which does what the built-in one does."""

    name = "in-parts"
    same: Estimator = field(default_factory=ProjectionEstimator)

    def init(self) -> Any:
        return self.same.init()

    def update(self, memory: Any, tool: Tool, sample: Sample) -> Any:
        return self.same.update(memory, tool, sample)

    def jacobian(self, memory: Any, tool: Tool, sample: Sample) -> Floats:
        return self.same.jacobian(memory, tool, sample)

    def located(self, memory: Any, tool: Tool, sample: Sample) -> Floats:
        return self.same.located(memory, tool, sample)


def states(wrong: str, estimator: Estimator) -> list[State]:
    lab = laboratory(3, disturbances=[Disturbance.parse(wrong)] if wrong != "none" else [])
    servo = Servo(lab.rig.settings.mechanism, lab.rig.settings.tool, estimator)
    lab.rig.begin()
    return [state for _, state in lab.run(servo, 7.0)]


def but_memory(state: State) -> State:
    return state.but(learnt=state.learnt._replace(memory=None))


WRONG = ["marker_loss:at=3,for=0.3,marker=1", "none", "bump:at=4", "axis_stuck:at=3,for=9,axis=2"]


@pytest.mark.parametrize("wrong", first_quick(WRONG))
@pytest.mark.parametrize("estimator", [ProjectionEstimator(), PRINTED, DltEstimator()])
def test_both_routes_say_and_send_the_same_at_every_tick_to_the_last_bit(
    wrong: str, estimator: Estimator
) -> None:
    whole, parts = states(wrong, estimator), states(wrong, InParts(estimator))
    assert len(whole) == 700 and any(state.phase is Phase.SERVO for state in whole)
    assert any(state.cause.stopping for state in whole) == (wrong != "none")
    for one, other in zip(whole, parts, strict=True):
        assert frozen(but_memory(one)) == frozen(but_memory(other))


class Halved(ProjectionEstimator):
    """A user's own that derives from the built-in one."""

    def jacobian(self, memory: Any, tool: Tool, sample: Sample) -> Floats:
        return 0.5 * super().jacobian(memory, tool, sample)


def test_what_derives_from_a_compiled_estimator_is_called_as_it_is() -> None:
    ours, own = states("none", ProjectionEstimator()), states("none", Halved())
    first = next(k for k, state in enumerate(ours) if np.any(state.J_hat))
    assert np.array_equal(own[first].J_hat, 0.5 * ours[first].J_hat)
