"""The detail of a cause names the joint, its value and its limit, or a setting to change."""

from dataclasses import replace

import numpy as np
import pytest

from conftest import TOOLS, make_laboratory
from rcmservo.control.exploration import Exploration
from rcmservo.estimation.flow_rule import FlowEstimator
from rcmservo.geometry.kinematics import PitchYawRcm
from rcmservo.safety.causes import Cause
from rcmservo.safety.checks.exploration import describe_missing_estimate
from rcmservo.safety.checks.facts import DetailFacts
from rcmservo.safety.state_machine import Phase
from rcmservo.servo.servo import Servo

JOINT_ERROR = np.array([0.0, 0.0, 500.0])


@pytest.mark.parametrize(
    "change,cause,words",
    [
        (
            lambda observation: replace(observation, q=observation.q + JOINT_ERROR),
            Cause.BEYOND_LIMIT,
            ("joint 3", "limits are"),
        ),
        (
            lambda observation: replace(observation, q=np.array([np.nan, *observation.q[1:]])),
            Cause.JOINTS_NOT_FINITE,
            ("joint 1", "nan"),
        ),
        (
            lambda observation: replace(observation, q=observation.q + np.array([0.0, 0.02, 0.0])),
            Cause.NOT_FOLLOWING,
            ("joint 2", "should be within"),
        ),
    ],
)
def test_a_fault_of_a_joint_names_joint_value_and_limits(change, cause, words):
    lab = make_laboratory()
    servo, before = lab.servo(), None
    if cause is Cause.NOT_FOLLOWING:
        *_, (_, before) = lab.run(servo, 0.3)
    for _, state in lab.run(servo, 0.3, before, change):
        if state.phase is Phase.FAULT:
            break
    assert state.cause is cause
    for word in words:
        assert word in state.text
    assert "mm" in state.text or "rad" in state.text


def test_an_unfinished_exploration_with_flow_names_gamma_and_the_difference_from_the_fit():
    lab = make_laboratory()
    exploration = replace(Servo(PitchYawRcm(), TOOLS["rigid"]).exploration, max_time=3.0)
    servo = lab.servo(exploration=exploration, estimator=FlowEstimator(gamma=1e-9))
    for _, state in lab.run(servo, 4.0):
        if state.phase is Phase.PAUSED:
            break
    assert state.cause is Cause.NOT_EXPLORED and "gamma" in state.text
    assert "the estimated Jacobian differs by 100%, instead of at most 30%, from" in state.text


@pytest.mark.parametrize(
    ("disagreement", "words"),
    [(np.nan, ""), (np.inf, "the frames do not determine the imaged RCM"), (0.5, "by 50%")],
)
@pytest.mark.parametrize("advice", ["", "turn it up"])
def test_a_failed_exploration_says_what_the_estimator_lacked(disagreement, words, advice):
    facts = dict.fromkeys(DetailFacts._fields) | {"exploration": Exploration(), "advice": advice}
    text = describe_missing_estimate(DetailFacts(**facts | {"disagreement": disagreement}))
    assert text.startswith(words or advice) or words in text
    assert text.endswith(advice) and bool(text) == bool(words or advice)
