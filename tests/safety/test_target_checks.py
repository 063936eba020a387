"""An invalid target is refused where it enters, and nothing moves."""

import copy
import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rcmservo as rs
from conftest import Laboratory, make_laboratory, snapshot
from rcmservo.loop.operator import OperatorRequest
from rcmservo.sim import Rig

POINTS, Q = np.array([[320.0, 240.0], [350.0, 260.0]]), np.array([0.5, 0.1, 100.0])

UNMADE: dict[str, dict[str, Any]] = {
    "not a number": {"points": [[np.nan, 1.0], [2.0, 3.0]]},
    "infinite": {"points": [[np.inf, 1.0], [2.0, 3.0]]},
    "one marker": {"points": POINTS[0]},
    "text": {"points": "here"},
    "a ragged list": {"points": [[1.0, 2.0], [3.0]]},
    "two joints": {"q": Q[:2]},
    "a number as joints": {"q": 0.0},
    "one size": {"sizes": [3.0]},
    "a time in seconds": {"taught_at": 1.5},
}
"""Arguments of which no target is made."""

REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "at 1e8 px": ({"points": POINTS + 1e8}, "target.points must be pixels within"),
    "coincident": ({"points": POINTS[[0, 0]]}, "target.points must be two markers at least 2 px"),
    "beyond a joint limit": (
        {"q": Q + np.array([2.0, 0, 0])},
        "target.q[0] must be theta within its limits",
    ),
    "insertion in m": (
        {"q": Q * np.array([1, 1, 1e-3])},
        "target.q[2] must be rho within its limits",
    ),
    "one joint unknown": (
        {"q": Q * np.array([1, np.nan, 1])},
        "target.q[1] must be phi within its limits",
    ),
}
"""Changes of a taught target that no servo accepts, and the beginning of the sentence."""


@pytest.mark.parametrize("kind", UNMADE)
def test_no_target_is_made_of_other_arrays_than_its_own(kind: str) -> None:
    (name,) = UNMADE[kind]
    with pytest.raises(rs.BadInput, match=rf"^target\.{name} must be "):
        rs.Target(**{"points": POINTS, "q": Q} | UNMADE[kind])


@given(st.sampled_from([pickle.dumps, copy.deepcopy, replace, list]), st.booleans())
def test_targets_are_compared_by_their_numbers(how: Callable[..., Any], known: bool) -> None:
    target = rs.Target(POINTS, Q if known else np.full(3, np.nan), 5)
    made = how(target) if how is not list else rs.Target(POINTS.tolist(), target.q.tolist(), 5)
    again = pickle.loads(made) if how is pickle.dumps else made
    assert again == target and hash(again) == hash(target) and again.points is not target.points
    for other in ({"points": POINTS + 1e-9}, {"q": Q + 1e-9}, {"taught_at": 6}, {"sizes": [3, 3]}):
        assert replace(target, **other) != target


def test_a_copy_of_the_target_starts_no_new_approach(lab: Laboratory) -> None:
    servo = lab.servo()
    states = [state for _, state in lab.run(servo, 3.0)]
    assert states[-1].phase is rs.Phase.SERVO
    lab = make_laboratory()
    state, copied = servo.init(), []
    lab.plant.reset()
    lab.plant.enable()
    for _ in states:
        lab.plant.clock.wait_until(lab.plant.clock.now() + servo.period)
        state = servo.step(state, lab.plant.read(), copy.deepcopy(lab.target))
        lab.plant.send(state.command)
        copied.append(state)
    assert copied[-1].phase is rs.Phase.SERVO
    assert [state.phase for state in copied].count(rs.Phase.ACQUIRE) < len(states) // 2


def enter_at_start(lab: Laboratory, target: rs.Target) -> None:
    next(iter(rs.servo_ticks(lab.plant, lab.servo(), target, 1.0)))


def enter_in_run(lab: Laboratory, target: rs.Target) -> None:
    rs.run(lab.rig, rs.Servo(), target, 1.0)


def enter_during_motion(lab: Laboratory, target: rs.Target) -> None:
    def ask(tick: rs.Tick) -> OperatorRequest:
        return target

    for tick in rs.servo_ticks(lab.plant, lab.servo(), lab.target, 1.0, operator=ask):
        assert tick.state.target == lab.target


@pytest.mark.parametrize("enter", [enter_at_start, enter_in_run, enter_during_motion])
@pytest.mark.parametrize("kind", REFUSED)
def test_an_invalid_target_moves_nothing(
    lab: Laboratory, kind: str, enter: Callable[[Laboratory, rs.Target], None]
) -> None:
    change, sentence = REFUSED[kind]
    before = lab.rig.arm.measure().q.copy()
    with pytest.raises(rs.BadInput) as refused:
        enter(lab, replace(lab.target, **change))
    assert str(refused.value).startswith(sentence)
    assert (lab.rig.arm.measure().q == before).all() and not lab.rig.arm.measure().enabled


def test_a_target_without_joints_is_accepted_and_the_result_says_so(lab: Laboratory) -> None:
    result = rs.run(lab.rig, rs.Servo(), replace(lab.target, q=np.full(3, np.nan)))
    assert "by the image alone: the target has no joints" in str(result)
    assert result.remark == rs.Cause.TARGET_UNCHECKED.value


def test_a_target_outside_the_image_of_the_camera_is_refused() -> None:
    rig = Rig(seed=1)
    target = rig.teach(2)
    outside = replace(target, points=target.points + np.array([640.0, 0.0]))
    with pytest.raises(rs.BadInput, match=r"target\.points\[0\] must be within the image of 640 x"):
        rs.run(rig, rs.Servo(), outside, 1.0)
    assert snapshot(outside) != snapshot(target) and not rig.arm.measure().enabled
