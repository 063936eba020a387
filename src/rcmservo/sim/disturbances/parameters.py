"""Types of the parameters of a disturbance: a number in a range, or one of a few words."""

import math
from dataclasses import dataclass

import numpy as np

from rcmservo.errors import require

Value = float | str


@dataclass(frozen=True)
class Number:
    """Parameter that is a number.

    Parameters
    ----------
    default : float
        Default value.
    low : float
        Least accepted value.
    high : float
        Greatest accepted value.
    sampled_range : tuple[float, float]
        Least and greatest value of random disturbances.
    unit : str
        Unit, empty if there is none.
    is_whole : bool
        True if the value must be a whole number.
    """

    default: float

    low: float

    high: float

    sampled_range: tuple[float, float]

    unit: str = ""

    is_whole: bool = False

    def read(self, field: str, value: object) -> float:
        """Return the value as a number; raise `BadInput` for `field` if it is out of range."""
        number = to_number(value)
        valid = self.low <= number <= self.high and (not self.is_whole or number.is_integer())
        require(valid, field, value, self.expected)
        return number

    def sample(self, random: np.random.Generator) -> float:
        """Return a random value, rounded to three digits."""
        low, high = self.sampled_range
        if self.is_whole:
            return float(random.integers(int(low), int(high) + 1))
        return float(f"{random.uniform(low, high):.3g}")

    @property
    def expected(self) -> str:
        """Accepted values, in words."""
        kind = "a whole number" if self.is_whole else "a number"
        return f"{kind}{f' of {self.unit}' if self.unit else ''} from {self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class Choice:
    """Parameter that is one of a few words.

    Parameters
    ----------
    default : str
        Default value.
    words : tuple[str, ...]
        Accepted words.
    """

    default: str

    words: tuple[str, ...]

    def read(self, field: str, value: object) -> str:
        """Return the value; raise `BadInput` for `field` if it is none of the words."""
        require(value in self.words, field, value, self.expected)
        return str(value)

    def sample(self, random: np.random.Generator) -> str:
        """Return a random word."""
        return str(random.choice(self.words))

    @property
    def expected(self) -> str:
        """Accepted values, in words."""
        return "one of " + ", ".join(self.words)


Parameter = Number | Choice


def to_number(value: object) -> float:
    """Return the value as a number, NaN if it is none."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return math.nan
    try:
        return float(value)
    except (ValueError, OverflowError):
        return math.nan


def format_value(value: Value) -> str:
    """Return the value as text."""
    return value if isinstance(value, str) else f"{value:.12g}"
