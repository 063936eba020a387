"""Messages as DDS carries them: against Cyclone's own serialisation, and whatever else may come."""

import contextlib
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcmservo.hardware.crtk import messages as m
from rcmservo.hardware.crtk.cdr import packed, unpacked
from rcmservo.hardware.crtk.ros2 import dds, shape
from rcmservo.record.cdr import MalformedMessage

stamps = st.integers(0, 2**31 * 10**9 - 1)
texts = st.text(st.characters(blacklist_characters="\0", blacklist_categories=("Cs",)), max_size=9)
numbers = st.lists(st.floats(allow_nan=False), max_size=7).map(tuple)
joints = st.builds(
    m.JointState, stamps, st.lists(texts, max_size=7).map(tuple), numbers, numbers, numbers
)
pictures = st.builds(
    m.PlainImage,
    stamps,
    st.integers(0, 9),
    st.integers(0, 9),
    texts,
    st.integers(0, 1),
    st.integers(0, 99),
    st.binary(max_size=99),
)
states = st.builds(m.OperatingState, stamps, texts, st.booleans(), st.booleans())
words = st.builds(m.StringStamped, stamps, texts)
three, four = (st.tuples(*[st.floats(allow_nan=False)] * count) for count in (3, 4))
poses = st.builds(m.PoseStamped, stamps, st.tuples(three, four))
messages = joints | pictures | states | words | poses


def theirs_of(form: Any, value: Any) -> Any:
    """A value as Cyclone's class for it has it."""
    if isinstance(value, tuple) and hasattr(form, "__annotations__"):
        parts = zip(form.__annotations__.values(), value, strict=True)
        return form(*(theirs_of(part, one) for part, one in parts))
    return list(value) if isinstance(value, tuple | bytes) else value


@given(messages)
def test_they_are_the_bytes_that_cyclone_makes(said: m.RosMessage) -> None:
    """And back again."""
    form = shape(dds(), type(said))
    sec, nanosec = divmod(said.stamp, 10**9)
    header = form.__annotations__["header"]
    time = header.__annotations__["stamp"]
    values = [getattr(said, name) for _, name in m.parts_of(type(said))]
    forms = list(form.__annotations__.values())[1:]
    plain = [theirs_of(part, value) for part, value in zip(forms, values, strict=True)]
    theirs = form(header(time(sec, nanosec), ""), *plain).serialize(use_version_2=False)
    ours = packed(said)
    assert ours[: len(theirs)] == theirs and len(ours) % 4 == 0 and len(ours) - len(theirs) < 4
    assert unpacked(type(said), ours) == said


@given(messages, st.data())
def test_what_is_cut_or_damaged_is_told_or_another_message(
    said: m.RosMessage, data: st.DataObject
) -> None:
    whole = packed(said)
    cut = whole[: data.draw(st.integers(0, len(whole)))]
    at, value = data.draw(st.integers(0, len(whole) - 1)), data.draw(st.integers(0, 255))
    damaged = whole[:at] + bytes([value]) + whole[at + 1 :]
    for bytes_ in (cut, damaged):
        with contextlib.suppress(MalformedMessage):
            assert isinstance(unpacked(type(said), bytes_), type(said))


def test_lengths_that_cannot_be_are_refused() -> None:
    huge = packed(m.JointState(0))[:16] + b"\xff\xff\xff\xff" * 4
    with pytest.raises(MalformedMessage):
        unpacked(m.JointState, huge)
