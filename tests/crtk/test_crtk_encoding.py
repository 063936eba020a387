"""Encoding of messages for DDS, compared with Cyclone's serialisation, and damaged bytes."""

import contextlib
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcmservo.hardware.crtk import messages
from rcmservo.hardware.crtk.cdr import decode_message, encode_message
from rcmservo.hardware.crtk.ros2 import describe_type, import_cyclone
from rcmservo.recording.cdr import MalformedMessage

stamps = st.integers(0, 2**31 * 10**9 - 1)
texts = st.text(st.characters(blacklist_characters="\0", blacklist_categories=("Cs",)), max_size=9)
numbers = st.lists(st.floats(allow_nan=False), max_size=7).map(tuple)
joints = st.builds(
    messages.JointState, stamps, st.lists(texts, max_size=7).map(tuple), numbers, numbers, numbers
)
images = st.builds(
    messages.PlainImage,
    stamps,
    st.integers(0, 9),
    st.integers(0, 9),
    texts,
    st.integers(0, 1),
    st.integers(0, 99),
    st.binary(max_size=99),
)
states = st.builds(messages.OperatingState, stamps, texts, st.booleans(), st.booleans())
text_messages = st.builds(messages.StringStamped, stamps, texts)
three, four = (st.tuples(*[st.floats(allow_nan=False)] * count) for count in (3, 4))
poses = st.builds(messages.PoseStamped, stamps, st.tuples(three, four))
any_message = joints | images | states | text_messages | poses


def to_cyclone(idl_type: Any, value: Any) -> Any:
    """Convert a value to Cyclone's class."""
    if isinstance(value, tuple) and hasattr(idl_type, "__annotations__"):
        fields = zip(idl_type.__annotations__.values(), value, strict=True)
        return idl_type(*(to_cyclone(field, one) for field, one in fields))
    return list(value) if isinstance(value, tuple | bytes) else value


@given(any_message)
def test_the_bytes_equal_those_of_cyclone_and_can_be_decoded(message: messages.RosMessage) -> None:
    idl_type = describe_type(import_cyclone(), type(message))
    sec, nanosec = divmod(message.stamp, 10**9)
    header = idl_type.__annotations__["header"]
    time = header.__annotations__["stamp"]
    values = [getattr(message, name) for _, name in messages.message_fields(type(message))]
    types = list(idl_type.__annotations__.values())[1:]
    plain = [to_cyclone(one, value) for one, value in zip(types, values, strict=True)]
    expected = idl_type(header(time(sec, nanosec), ""), *plain).serialize(use_version_2=False)
    data = encode_message(message)
    assert data[: len(expected)] == expected
    assert len(data) % 4 == 0 and len(data) - len(expected) < 4
    assert decode_message(type(message), data) == message


@given(any_message, st.data())
def test_truncated_or_damaged_bytes_raise_an_error_or_give_another_message(
    message: messages.RosMessage, data: st.DataObject
) -> None:
    whole = encode_message(message)
    cut = whole[: data.draw(st.integers(0, len(whole)))]
    at, value = data.draw(st.integers(0, len(whole) - 1)), data.draw(st.integers(0, 255))
    damaged = whole[:at] + bytes([value]) + whole[at + 1 :]
    for bytes_ in (cut, damaged):
        with contextlib.suppress(MalformedMessage):
            assert isinstance(decode_message(type(message), bytes_), type(message))


def test_impossible_lengths_are_refused() -> None:
    huge = encode_message(messages.JointState(0))[:16] + b"\xff\xff\xff\xff" * 4
    with pytest.raises(MalformedMessage):
        decode_message(messages.JointState, huge)
