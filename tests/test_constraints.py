"""Limits of settings: values that a dataclass accepts or refuses, and its messages."""

import copy
import math
import pickle
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Literal, Protocol

import numpy as np
import pytest
from numpy.typing import NDArray

from rcmservo.config.strict_decoding import decode_settings
from rcmservo.constraints import (
    FRACTION,
    Checked,
    above,
    angles,
    at_least,
    at_most,
    between,
    finite,
    inside,
    matching,
    not_empty,
    not_negative,
    one_of,
    positive,
    three_positive,
)
from rcmservo.errors import BadInput


@dataclass(frozen=True)
class Inner:
    size: float = 1.0


@dataclass(frozen=True)
class Box(Checked, section="box"):
    gain: Annotated[float, positive("gain in 1/s")] = 8.0
    bounds: Annotated[
        tuple[float, float, float], three_positive("rad, px, px"), angles(math.pi, first=1)
    ] = (0.8, 50.0, 50.0)
    potential: Literal["continuous", "printed"] = "continuous"
    lines: Annotated[int, between(2, 1000, "a whole number of lines")] = 50
    flag: bool = False
    word: str = "word"
    width: Annotated[int | None, between(64, 8192, "a whole number of px")] = None
    inner: Inner = Inner()
    many: tuple[int, ...] = ()
    any_of: Sequence[str] = ()

    @cached_property
    def twice(self) -> float:
        return 2.0 * self.gain


@dataclass(frozen=True)
class Larger(Box):
    """User-defined box with one more field and one more rule."""

    fraction: Annotated[float, FRACTION] = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require(self.fraction < self.gain, "fraction", "below gain")


@pytest.mark.parametrize(
    ("invalid", "sentence"),
    [
        ({"gain": -1.0}, "box.gain must be a positive gain in 1/s, got -1.0"),
        ({"gain": "fast"}, "box.gain must be a positive gain in 1/s, got 'fast'"),
        ({"gain": True}, "box.gain must be a positive gain in 1/s, got True"),
        ({"gain": None}, "box.gain must be a positive gain in 1/s, got None"),
        ({"gain": math.nan}, "box.gain must be a positive gain in 1/s, got nan"),
        ({"gain": 10**400}, "box.gain must be a positive gain in 1/s, got 1000"),
        ({"gain": 1j}, "box.gain must be a positive gain in 1/s, got 1j"),
        ({"bounds": 3}, "box.bounds must be three positive numbers (rad, px, px), got 3"),
        ({"bounds": (1.0, 2.0)}, "box.bounds must be three positive numbers (rad, px, px)"),
        ({"bounds": ("a", 1.0, 2.0)}, "box.bounds must be three positive numbers (rad, px, px)"),
        ({"bounds": "abc"}, "box.bounds must be three positive numbers (rad, px, px)"),
        ({"bounds": np.array(3.0)}, "box.bounds must be three positive numbers (rad, px, px)"),
        (
            {"bounds": (45.0, 50.0, 50.0)},
            "box.bounds must be at most 3.142 rad where it is an angle (did you mean 0.7854 rad, "
            "which is 45 deg?), got (45.0, 50.0, 50.0)",
        ),
        ({"potential": "print"}, "box.potential must be 'continuous' or 'printed', got 'print'"),
        ({"potential": ["printed"]}, "box.potential must be 'continuous' or 'printed'"),
        ({"lines": 2.0}, "box.lines must be a whole number of lines from 2 to 1000, got 2.0"),
        ({"lines": 1}, "box.lines must be a whole number of lines from 2 to 1000, got 1"),
        ({"flag": 1}, "box.flag must be true or false, got 1"),
        ({"word": 1}, "box.word must be text, got 1"),
        ({"width": 63}, "box.width must be a whole number of px from 64 to 8192, got 63"),
        ({"width": "wide"}, "box.width must be a whole number of px from 64 to 8192, got 'wide'"),
        ({"inner": 3}, "box.inner must be an Inner, got 3"),
        ({"many": (1, "b")}, "box.many must be a list, each a whole number, got (1, 'b')"),
        ({"any_of": 3}, "box.any_of must be a Sequence, got 3"),
        ({"fraction": 2.0}, "box.fraction must be a fraction above 0 and at most 1, got 2.0"),
        ({"fraction": 0.9, "gain": 0.5}, "box.fraction must be below gain, got 0.9"),
    ],
)
def test_a_value_of_another_type_or_outside_its_limit_is_refused_in_one_sentence(invalid, sentence):
    with pytest.raises(BadInput) as refused:
        Larger(**invalid)
    assert str(refused.value).startswith(sentence)


@pytest.mark.parametrize(
    "valid",
    [
        {"gain": 3},
        {"gain": np.float64(3.0)},
        {"gain": np.float32(3.0)},
        {"gain": np.int64(3)},
        {"lines": np.int64(3)},
        {"flag": np.True_},
        {"bounds": [0.8, 50, 50]},
        {"bounds": np.array([0.8, 50.0, 50.0])},
        {"width": 640},
        {"many": (1, 2, 3, 4)},
    ],
)
def test_numbers_of_numpy_and_lists_are_accepted_unchanged(valid):
    (name,) = valid
    assert getattr(Box(**valid), name) is valid[name]


@pytest.mark.parametrize(
    ("limit", "inner", "outer", "words"),
    [
        (not_negative("time in s"), [0.0, 1e9], [-1e-9, math.inf], "a time in s that is not neg"),
        (finite("length"), [-1e9, 0.0], [math.inf, -math.inf], "a finite length"),
        (between(0.1, 1e6, unit="σ"), [0.1, 1e6], [0.09, 2e6], "a number from 0.1 to 1e6 σ"),
        (above(1.0), [1.1, 1e300], [1.0, math.inf], "a number above 1"),
        (above(0.0, 0.5), [0.1, 0.5], [0.0, 0.51], "a number above 0 and at most 0.5"),
        (inside(0.0, 2.0), [0.1, 1.9], [0.0, 2.0], "a number above 0 and below 2"),
        (at_least(1e-9, "px"), [1e-9, 1.0], [0.0, math.inf], "at least 1e-9 px"),
        (at_most(1073740800, "mm"), [-math.inf, 10], [math.inf], "at most 1073740800 mm"),
    ],
)
def test_a_limit_names_its_ends_and_includes_or_excludes_them(limit, inner, outer, words):
    assert all(map(limit.holds, inner))
    assert not any(map(limit.holds, [*outer, math.nan]))
    assert limit.expected.startswith(words)


def test_each_angle_is_limited_and_may_not_be_nan():
    limit = angles(1.0, first=2)
    assert limit.holds((-1.0, 1.0, 5.0))
    assert not limit.holds((0.1, -1.1, 0.0))
    assert not limit.holds((0.1, math.nan, 0.0))


def test_texts_are_limited_by_choices_patterns_and_blanks():
    assert one_of(("red", "blue")).holds("red")
    assert not one_of(("red", "blue")).holds("green")
    assert one_of(("red", "blue")).hint("blu") == "red, blue (did you mean blue?)"
    assert repr(one_of(("red", "blue"))) == "<one of red, blue>"
    assert matching(r"\w+(/\w+)*", "a topic").holds("PSM1/image")
    assert not matching(r"\w+(/\w+)*", "a topic").holds("/PSM1")
    assert not_empty("a name").holds("x")
    assert not any(map(not_empty("a name").holds, [" ", (), []]))


def test_a_checked_class_stays_a_plain_frozen_dataclass():
    box = Larger(gain=4.0)
    assert box.twice == 8.0
    assert pickle.loads(pickle.dumps(box)) == box == copy.deepcopy(box)
    assert hash(box) == hash(Larger(gain=4.0))
    assert replace(box, gain=5.0).gain == 5.0
    with pytest.raises(BadInput, match=r"box\.gain"):
        replace(box, gain=-5.0)


def test_files_are_checked_by_the_same_annotations():
    assert (
        decode_settings(Larger, {"gain": 3.0, "bounds": [0.5, 1.0, 1.0]}, "servo.box").gain == 3.0
    )
    with pytest.raises(BadInput, match=r"^servo\.box\.gain must be a positive gain in 1/s, got -1"):
        decode_settings(Larger, {"gain": -1.0}, "servo.box")


class Named(Protocol):
    name: str


def test_values_of_unrecognisable_types_pass_and_nested_annotations_count():
    @dataclass(frozen=True)
    class Open(Checked):
        anything: Any = None
        named: Named | None = None
        array: NDArray[np.float64] | None = None
        either: Annotated[int, "words"] | None = None

    assert Open(anything=3, named="x", array=[1.0], either=2).either == 2
    with pytest.raises(BadInput, match=r"^either must be a whole number or left out, got 'x'$"):
        Open(either="x")


def test_an_argument_of_another_type_is_refused_too():
    with pytest.raises(BadInput, match=r"^rate must be a positive frequency in Hz, got 'fast'$"):
        positive("frequency in Hz").require("rate", "fast")


def test_a_local_class_whose_annotations_cannot_be_resolved_is_not_checked():
    @dataclass(frozen=True)
    class Local(Box):
        other: "Unknown" = 3  # noqa: F821

    assert Local(gain=-1.0).other == 3
