"""The parameters that a kind of disturbance can have: a number, or one of a few words."""

import math
from dataclasses import dataclass

import numpy as np

from rcmservo.errors import require

Value = float | str


@dataclass(frozen=True)
class Number:
    """A parameter that is a number."""

    default: float
    """Where none is given."""

    low: float
    """The least that may be given."""

    high: float
    """The greatest that may be given."""

    likely: tuple[float, float]
    """The least and the greatest that chance draws."""

    unit: str = ""
    """Empty where there is none."""

    whole: bool = False
    """Whether only whole numbers will do."""

    def read(self, where: str, value: object) -> float:
        """The value as a number, if it is one within the bounds."""
        number = as_number(value)
        good = self.low <= number <= self.high and (not self.whole or number.is_integer())
        require(good, where, value, self.right)
        return number

    def draw(self, random: np.random.Generator) -> float:
        """A value by chance."""
        low, high = self.likely
        if self.whole:
            return float(random.integers(int(low), int(high) + 1))
        return float(f"{random.uniform(low, high):.3g}")

    @property
    def right(self) -> str:
        """The accepted values, in words."""
        kind = "a whole number" if self.whole else "a number"
        return f"{kind}{f' of {self.unit}' if self.unit else ''} from {self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class Choice:
    """A parameter that is one of a few words."""

    default: str
    """Where none is given."""

    words: tuple[str, ...]
    """All that may be given."""

    def read(self, where: str, value: object) -> str:
        """The value, if it is one of the words."""
        require(value in self.words, where, value, self.right)
        return str(value)

    def draw(self, random: np.random.Generator) -> str:
        """A word by chance."""
        return str(random.choice(self.words))

    @property
    def right(self) -> str:
        """The accepted values, in words."""
        return "one of " + ", ".join(self.words)


Parameter = Number | Choice


def as_number(value: object) -> float:
    """The value as a number; NaN where it is none."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return math.nan
    try:
        return float(value)
    except (ValueError, OverflowError):
        return math.nan


def written(value: Value) -> str:
    """The value as a person would write it."""
    return value if isinstance(value, str) else f"{value:.12g}"
