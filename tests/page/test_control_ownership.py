"""Control of the arm by one browser, and validation of its messages."""

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rcmservo as rs
from rcmservo.page.control_ownership import (
    HOLDER_TIMEOUT_NS,
    MAX_JOG_AGE_NS,
    MAX_MESSAGE_AGE_NS,
    ControlOwnership,
    MessageRefused,
    interpret_message,
)
from rcmservo.page.messages import (
    Enable,
    Go,
    Heartbeat,
    JogJoints,
    JogMarker,
    ReleaseJog,
    TeachPose,
)

NOW = 10**12
POSES = {"above": rs.Target(np.array([[1.0, 2.0], [3.0, 4.0]]), np.zeros(3))}


def interpret(message: Any, name: str = "a", control: ControlOwnership | None = None) -> Any:
    text = message if isinstance(message, str) else json.dumps({"at": NOW - 1} | message)
    return interpret_message(text, name, control or ControlOwnership("a"), POSES.get, NOW)


def test_each_message_is_decoded_to_its_request() -> None:
    assert interpret({"do": "beat"}) == Heartbeat() and interpret({"do": "enable"}) == Enable()
    assert interpret({"do": "pause"}) is rs.Request.PAUSE
    assert interpret({"do": "clear"}) is rs.Request.CLEAR
    assert interpret({"do": "jog", "rates": [1, 0, -2.5], "press": 3}) == JogJoints(
        (1.0, 0.0, -2.5), 3
    )
    jog = {"do": "jog", "velocity": [0, 5.5, 0], "press": 4, "speed_scale": 0.25}
    assert interpret(jog) == JogMarker((0.0, 5.5, 0.0), 4, 0.25)
    assert interpret({"do": "teach", "name": "left of it"}) == TeachPose("left of it")
    go = interpret({"do": "go", "name": "above"})
    assert isinstance(go, Go) and go.target is POSES["above"]


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        ("{", "not JSON"),
        ("[]", "not a JSON object"),
        ("[" * 1500, "not JSON"),
        (" " * 3000, "longer than 2000 characters"),
        ({"do": "fly"}, "unknown action"),
        ({}, "unknown action"),
        ({"do": ["jog"]}, "unknown action"),
        ({"do": "resume", "at": NOW - MAX_MESSAGE_AGE_NS - 1}, "too old"),
        ({"do": "resume", "at": NOW + 1}, "too old"),
        ({"do": "resume", "at": float(NOW)}, "too old"),
        ({"do": "resume", "at": None}, "too old"),
        ({"do": "jog", "rates": [1, 2], "press": 1}, "rates"),
        ({"do": "jog", "rates": [1, 2, float("nan")], "press": 1}, "rates"),
        ({"do": "jog", "rates": [1, 2, "3"], "press": 1}, "rates"),
        ({"do": "jog", "rates": [1, 2, 10**400], "press": 1}, "rates"),
        ({"do": "jog", "rates": [1, 2, 3]}, "press"),
        ({"do": "jog", "rates": [1, 2, 3], "press": 2**63}, "press"),
        ({"do": "jog", "rates": [1, 2, 3], "press": -1}, "press"),
        ({"do": "jog", "rates": [1, 2, 3], "press": 1, "speed_scale": 1.5}, "speed_scale"),
        ({"do": "jog", "rates": [1, 2, 3], "press": 1, "speed_scale": 0}, "speed_scale"),
        ({"do": "jog", "velocity": [1, 2], "press": 1}, "velocity"),
        ({"do": "jog", "velocity": [1, 2, 1e300], "press": 1}, "velocity"),
        ({"do": "jog", "velocity": [1, 2, 3], "rates": [1, 2, 3], "press": 1}, "velocity"),
        ({"do": "go", "name": "nowhere"}, "no pose"),
        ({"do": "teach", "name": ""}, "name"),
        ({"do": "teach", "name": "x" * 41}, "name"),
        ({"do": "teach", "name": "a\nb"}, "name"),
        ({"do": "teach", "name": " a"}, "name"),
        ({"do": "teach", "name": 3}, "name"),
        ({"do": "teach", "name": "a", "more": 1}, "more"),
    ],
)
def test_an_invalid_or_old_message_is_refused_with_a_reason(message: Any, reason: str) -> None:
    with pytest.raises(MessageRefused, match=reason):
        interpret(message)


@given(st.text(max_size=100) | st.binary(max_size=50).map(lambda data: data.decode("latin-1")))
def test_random_text_is_refused_and_raises_nothing_else(text: str) -> None:
    with pytest.raises(MessageRefused):
        interpret(text)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=10,
)


@given(
    st.fixed_dictionaries(
        {"do": st.sampled_from(["jog", "teach", "go", "beat", "enable"])},
        optional={"rates": json_values, "press": json_values, "name": json_values},
    )
)
def test_a_random_message_is_decoded_or_refused(message: dict[str, Any]) -> None:
    try:
        request = interpret(message)
    except MessageRefused:
        return
    assert isinstance(request, Heartbeat | Enable | JogJoints | JogMarker | TeachPose | Go)
    if isinstance(request, JogJoints):
        assert np.isfinite(request.rates).all()


def test_one_browser_has_control_and_hands_it_over_on_request() -> None:
    control = ControlOwnership()
    a, b = control.join(NOW), control.join(NOW)
    assert control.holder == a != b
    with pytest.raises(MessageRefused, match="another browser has control"):
        interpret({"do": "enable"}, b, control)
    assert interpret({"do": "request_control"}, b, control) is None and control.holder == a
    interpret({"do": "hand_over"}, b, control)
    assert control.holder == a
    interpret({"do": "hand_over"}, a, control)
    assert control.holder == b and not control.requester
    control.request(a, NOW)
    control.leave(b, NOW)
    assert control.holder == a
    control.leave(a, NOW)
    assert not control.holder
    interpret({"do": "request_control"}, "c", control)
    assert control.holder == "c"


def test_only_a_silent_browser_loses_control_on_request() -> None:
    control = ControlOwnership()
    control.join(NOW - 2 * HOLDER_TIMEOUT_NS)
    interpret({"do": "request_control"}, "b", control)
    assert control.holder == "b"
    interpret({"do": "beat"}, "b", control)
    control.request("c", NOW + HOLDER_TIMEOUT_NS)
    assert control.holder == "b" and control.requester == "c"


def test_a_late_heartbeat_is_ignored_without_a_refusal() -> None:
    control = ControlOwnership()
    control.join(NOW - 2 * HOLDER_TIMEOUT_NS)
    before = control.last_message_ns
    assert (
        interpret({"do": "beat", "at": NOW - MAX_MESSAGE_AGE_NS - 1}, control.holder, control)
        is None
    )
    assert control.last_message_ns == before
    assert interpret({"do": "beat"}, control.holder, control) == Heartbeat()
    assert control.last_message_ns == NOW


def test_a_jog_expires_sooner_than_other_messages_and_a_release_never() -> None:
    old = {"at": NOW - MAX_JOG_AGE_NS - 1}
    assert interpret({"do": "beat"} | old) == Heartbeat()
    with pytest.raises(MessageRefused, match="too old"):
        interpret({"do": "jog", "rates": [1, 0, 0], "press": 1} | old)
    assert interpret({"do": "release", "at": 0}) == ReleaseJog()
    with pytest.raises(MessageRefused, match="another browser"):
        interpret({"do": "release"}, "b")
