"""What is said beside a cause names the joint, its value and its limit, or what a person may
change.
"""

from dataclasses import replace

import numpy as np
import pytest

from conftest import TOOLS, laboratory
from rcmservo.estimation.flow_rule import FlowEstimator
from rcmservo.geometry.kinematics import PitchYawRcm
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Phase
from rcmservo.servo.servo import Servo

OFF = np.array([0.0, 0.0, 500.0])


@pytest.mark.parametrize(
    "change,cause,words",
    [
        (lambda seen: replace(seen, q=seen.q + OFF), Cause.BEYOND_LIMIT, ("joint 3", "limits are")),
        (
            lambda seen: replace(seen, q=np.array([np.nan, *seen.q[1:]])),
            Cause.JOINTS_NOT_FINITE,
            ("joint 1", "nan"),
        ),
        (
            lambda seen: replace(seen, q=seen.q + np.array([0.0, 0.02, 0.0])),
            Cause.NOT_FOLLOWING,
            ("joint 2", "should be within"),
        ),
    ],
)
def test_a_fault_of_a_joint_names_it_its_value_and_what_would_be_right(change, cause, words):
    lab = laboratory()
    servo, before = lab.servo(), None
    if cause is Cause.NOT_FOLLOWING:
        *_, (_, before) = lab.run(servo, 0.3)
    for _, state in lab.run(servo, 0.3, before, change):
        if state.phase is Phase.FAULT:
            break
    assert state.cause is cause
    for word in words:
        assert word in state.words
    assert "mm" in state.words or "rad" in state.words


def test_an_exploration_that_flow_cannot_end_names_gamma():
    lab = laboratory()
    tour = replace(Servo(PitchYawRcm(), TOOLS["rigid"]).exploration, max_time=3.0)
    servo = lab.servo(exploration=tour, estimator=FlowEstimator(gamma=1e-9))
    for _, state in lab.run(servo, 4.0):
        if state.phase is Phase.PAUSED:
            break
    assert state.cause is Cause.NOT_EXPLORED and "gamma" in state.words
