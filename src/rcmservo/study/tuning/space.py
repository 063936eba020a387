"""Search space: settings of a method with the values that a search may give them.

    [search]
    "controller.gain" = [2.0, 15.0]
    "exploration.leg_time" = { from = 0.05, to = 0.5, log = true }
    "controller.features" = ["srd", "points"]

Two numbers are a range, of integers if the setting is an integer. Strings are a set of choices.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, cast

from rcmservo.config.toml_json_parsing import is_table
from rcmservo.errors import require, suggest_name
from rcmservo.study.plan.method import StudyMethod

Values = Mapping[str, Any]
"""Value of every varied setting, by part.name."""


@dataclass(frozen=True)
class SearchAxis:
    """Setting to vary, and its range or choices.

    Parameters
    ----------
    name : str
        Name of the setting, part.name.
    low : float
        Smallest value.
    high : float
        Largest value.
    log : bool
        Sample on a logarithmic scale.
    choices : tuple[str, ...]
        Values of a setting that is not a number.
    """

    name: str
    low: float = 0.0
    high: float = 0.0
    log: bool = False
    choices: tuple[str, ...] = ()

    def contains(self, value: Any) -> bool:
        """Return True if the search may give the setting this value."""
        return value in self.choices if self.choices else self.low <= value <= self.high

    def suggest(self, trial: Any) -> Any:
        """Return the value that Optuna suggests for a trial."""
        if self.choices:
            return trial.suggest_categorical(self.name, list(self.choices))
        if isinstance(self.low, int):
            return trial.suggest_int(self.name, self.low, self.high, log=self.log)
        return trial.suggest_float(self.name, self.low, self.high, log=self.log)


def parse_axis(name: str, entry: object, method: StudyMethod) -> SearchAxis:
    """Return the axis that an entry of [search] describes for a setting of a method.

    Raises
    ------
    BadInput
        If the method has no such setting, or the entry does not fit its type.
    """
    field, present = f'search."{name}"', get_setting(method, name)
    if is_table(entry):
        for key, value in entry.items():
            is_known = key in ("from", "to", "log")
            require(is_known, f"{field}.{key}", value, "one of from, to, log")
        log = entry.get("log", False)
        require(isinstance(log, bool), f"{field}.log", log, "true or false")
        return _parse_range(field, name, [entry.get("from"), entry.get("to")], log, present)
    values = cast(list[Any], entry) if isinstance(entry, list) else []
    expected = "two numbers, least first, or a list of words"
    require(bool(values), field, cast(object, entry), expected)
    if all(isinstance(value, str) for value in values):
        require(isinstance(present, str), field, values, f"two numbers, as it is {present!r} now")
        return SearchAxis(name, choices=tuple(values))
    return _parse_range(field, name, values, False, present)


def _parse_range(field: str, name: str, ends: list[Any], log: bool, present: Any) -> SearchAxis:
    """Return the axis of a number between two ends; raise `BadInput` if they do not fit it.

    `field` is the name for error messages, `present` the value of the setting now.
    """
    numbers = [end for end in ends if _is_number(end)]
    is_range = len(ends) == len(numbers) == 2 and -1e300 < numbers[0] < numbers[1] < 1e300
    require(is_range, field, ends, "two finite numbers, least first")
    require(numbers[0] > 0 or not log, field, ends, "positive numbers, for log = true")
    expected = f"left out: it is {present!r} now, which is not a number"
    require(_is_number(present), field, ends, expected)
    kind = int if isinstance(present, int) else float
    if kind is int:
        is_integer = all(isinstance(number, int) for number in numbers)
        require(is_integer, field, ends, f"two whole numbers, as it is {present} now")
    return SearchAxis(name, kind(numbers[0]), kind(numbers[1]), log)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def get_setting(method: StudyMethod, name: str) -> Any:
    """Return the value of a setting, part.name, of a method."""
    part, _, key = name.partition(".")
    parts = ", ".join(method.parts)
    require(part in method.parts, "search", name, f"part.name, with a part among {parts}")
    names = [f.name for f in fields(method.parts[part])]
    hint = suggest_name(name, [f"{part}.{setting}" for setting in names])
    expected = f"a setting of {part}, one of {', '.join(names) or 'none'}{hint}"
    require(key in names, "search", name, expected)
    return getattr(method.parts[part], key)


def replace_settings(method: StudyMethod, name: str, values: Values) -> StudyMethod:
    """Return the method with other values, under another name."""
    parts = dict(method.parts)
    for path, value in values.items():
        part, _, key = path.partition(".")
        parts[part] = replace(parts[part], **{key: value})
    return StudyMethod(name, parts)
