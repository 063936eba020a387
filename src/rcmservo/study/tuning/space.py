"""What is searched: some of a method's settings, each with the values that it may have.

    [search]
    "controller.gain" = [2.0, 15.0]
    "exploration.leg" = { from = 0.05, to = 0.5, log = true }
    "controller.features" = ["srd", "points"]

Two numbers are a range, whole ones a range of whole ones; words are a choice.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, cast

from rcmservo.config.texts import is_table
from rcmservo.errors import BadInput, require, suggestion
from rcmservo.study.plan.method import StudyMethod

Values = Mapping[str, Any]
"""A value for every setting that is searched, by box.name."""


@dataclass(frozen=True)
class SearchAxis:
    """One setting, and the values that it may have.

    Parameters
    ----------
    name : str
        box.name.
    low : float
        The least.
    high : float
        The greatest.
    log : bool
        Whether a factor counts as much at either end.
    words : tuple[str, ...]
        What it may be, where it is no number.
    """

    name: str
    low: float = 0.0
    high: float = 0.0
    log: bool = False
    words: tuple[str, ...] = ()

    def has(self, value: Any) -> bool:
        """Whether it may have a value."""
        return value in self.words if self.words else self.low <= value <= self.high

    def suggested(self, trial: Any) -> Any:
        """A value, by the optimiser."""
        if self.words:
            return trial.suggest_categorical(self.name, list(self.words))
        if isinstance(self.low, int):
            return trial.suggest_int(self.name, self.low, self.high, log=self.log)
        return trial.suggest_float(self.name, self.low, self.high, log=self.log)


def axis_from(name: str, told: object, method: StudyMethod) -> SearchAxis:
    """The axis that a file describes, of a setting that the method has."""
    where = f'search."{name}"'
    usual = value_of(method, name)
    if is_table(told):
        known = {"from", "to", "log"}
        for key in told:
            require(key in known, f"{where}.{key}", told[key], "one of from, to, log")
        log = told.get("log", False)
        if not isinstance(log, bool):
            raise BadInput(f"{where}.log", log, "true or false")
        return _range(where, name, [told.get("from"), told.get("to")], log, usual)
    values = cast(list[Any], told) if isinstance(told, list) else []
    require(bool(values), where, cast(object, told), "two numbers, least first, or a list of words")
    if all(isinstance(value, str) for value in values):
        require(isinstance(usual, str), where, values, f"two numbers, as it is {usual!r} now")
        return SearchAxis(name, words=tuple(values))
    return _range(where, name, values, False, usual)


def _range(where: str, name: str, ends: list[Any], log: bool, usual: Any) -> SearchAxis:
    numbers = [x for x in ends if isinstance(x, int | float) and not isinstance(x, bool)]
    good = len(ends) == len(numbers) == 2 and -1e300 < numbers[0] < numbers[1] < 1e300
    require(good, where, ends, "two finite numbers, least first")
    require(numbers[0] > 0 or not log, where, ends, "positive numbers, where log = true")
    number = isinstance(usual, int | float) and not isinstance(usual, bool)
    require(number, where, ends, f"left out: it is {usual!r} now, which is no number")
    kind = int if isinstance(usual, int) else float
    if kind is int:
        whole = all(isinstance(x, int) for x in numbers)
        require(whole, where, ends, f"two whole numbers, as it is {usual} now")
    return SearchAxis(name, kind(numbers[0]), kind(numbers[1]), log)


def value_of(method: StudyMethod, name: str) -> Any:
    """The value that a setting has now."""
    box, _, key = name.partition(".")
    boxes = ", ".join(method.parts)
    require(box in method.parts, "search", name, f"box.name, with a box among {boxes}")
    names = [f.name for f in fields(method.parts[box])]
    hint = suggestion(name, [f"{box}.{one}" for one in names])
    right = f"a setting of {box}, one of {', '.join(names) or 'none'}{hint}"
    require(key in names, "search", name, right)
    return getattr(method.parts[box], key)


def with_values(method: StudyMethod, name: str, values: Values) -> StudyMethod:
    """The method with other values, under another name."""
    parts = dict(method.parts)
    for path, value in values.items():
        part, _, key = path.partition(".")
        parts[part] = replace(parts[part], **{key: value})
    return StudyMethod(name, parts)
