"""Decoding of tables: the settings bit for bit, or one error that names the field."""

import json
from dataclasses import dataclass, field
from typing import Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

import rcmservo as rs
from rcmservo.config import toml_json_parsing
from rcmservo.config.strict_decoding import decode_settings


@dataclass(frozen=True)
class Inner:
    """Settings within settings."""

    size: float = 1.0

    def __post_init__(self) -> None:
        if self.size < 0.0:
            raise rs.BadInput("size", self.size, "a length")


@dataclass(frozen=True)
class Outer:
    """One field of every kind."""

    real: float
    whole: int = 1
    word: str = "a"
    mode: Literal["fast", "slow"] = "fast"
    three: tuple[float, float, float] = (0.0, 0.0, 0.0)
    optional: tuple[float, float] | None = None
    flag: bool = False
    inner: Inner = field(default_factory=Inner)


finite = st.floats(allow_nan=False, allow_infinity=False)


@given(finite, st.integers(-(2**70), 2**70), st.tuples(finite, finite, finite), st.text(max_size=9))
def test_every_number_survives_bit_for_bit(
    real: float, whole: int, three: tuple[float, float, float], word: str
) -> None:
    if not word.isprintable():
        word = "a"
    table = {"real": real, "whole": whole, "three": list(three), "word": word}
    made = decode_settings(Outer, table, "box")
    assert made == Outer(real, whole, word, three=three)
    assert [x.hex() for x in (made.real, *made.three)] == [x.hex() for x in (real, *three)]


def test_an_integer_is_accepted_as_a_float_but_no_float_as_an_integer() -> None:
    made = decode_settings(Outer, {"real": 3, "three": [1, 2, 3]}, "box")
    assert (type(made.real), made.three) == (float, (1.0, 2.0, 3.0))
    with pytest.raises(rs.BadInput, match=r"box\.whole must be a whole number, got 3\.0"):
        decode_settings(Outer, {"real": 1.0, "whole": 3.0}, "box")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"wole": 2}, "box.wole must be left out or one of real, whole, "),
        ({"wole": 2}, "(did you mean whole?), got 2"),
        ({"real": float("nan")}, "box.real must be a finite number, got nan"),
        ({"real": 10**400}, "box.real must be a finite number"),
        ({"real": True}, "box.real must be a finite number, got True"),
        ({"real": "1.0"}, "box.real must be a finite number, got '1.0'"),
        ({"whole": True}, "box.whole must be a whole number, got True"),
        ({"flag": 1}, "box.flag must be true or false, got 1"),
        ({"word": 1}, "box.word must be text, got 1"),
        ({"mode": "slwo"}, "box.mode must be 'fast' or 'slow', got 'slwo'"),
        ({"three": 1.0}, "box.three must be a list, got 1.0"),
        ({"three": [1.0, 2.0]}, "box.three[2] must be given, got [1.0, 2.0]"),
        (
            {"three": [1.0, 2.0, 3.0, 4.0]},
            "box.three must be a list of 3, got [1.0, 2.0, 3.0, 4.0]",
        ),
        ({"three": [1.0, None, 3.0]}, "box.three[1] must be a finite number, got None"),
        ({"inner": {"sise": 1.0}}, "box.inner.sise must be left out or one of size (did you mean"),
        ({"inner": {"size": -1.0}}, "box.inner.size must be a length, got -1.0"),
        ({"inner": 7}, "box.inner must be a table of settings, got 7"),
        ({"word": "\ud800"}, "box must be plain text and numbers"),
    ],
)
def test_an_invalid_value_is_reported_with_the_path_of_its_key(change: Any, sentence: str) -> None:
    with pytest.raises(rs.BadInput) as refused:
        decode_settings(Outer, {"real": 1.0, **change}, "box")
    assert sentence in str(refused.value)


def test_a_setting_without_a_default_must_be_given() -> None:
    with pytest.raises(rs.BadInput, match=r"box\.real must be given, got None"):
        decode_settings(Outer, {}, "box")


def test_an_error_of_the_dataclass_is_reported_once_with_the_path_in_the_file() -> None:
    with pytest.raises(rs.BadInput, match=r"^servo\.tool\.spacing must be "):
        decode_settings(rs.RigidTool, {"spacing": -3.0}, "servo.tool")


def test_json_with_a_repeated_key_or_no_finite_number_is_refused() -> None:
    for text in ('{"a": 1, "a": 1}', '{"a": NaN}', '{"a": -Infinity}', '{"a": 1e999}'):
        assert json.loads(text)
        with pytest.raises(toml_json_parsing.InvalidText):
            toml_json_parsing.parse_json(text)
