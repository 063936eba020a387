"""Errors that rcmservo raises on purpose. Subclasses carry the data of their message."""

from collections.abc import Generator, Iterable
from contextlib import contextmanager
from pathlib import PurePath


class RcmServoError(Exception):
    """Base class of all errors that rcmservo raises on purpose. The message is one sentence for the
    user.
    """


MAX_QUOTED_LENGTH = 200
"""Characters of foreign text that a message quotes."""


def one_line(text: object) -> str:
    """Return a text on one line, cut to the length that a message quotes."""
    line = " ".join(str(text).split())
    return line if len(line) <= MAX_QUOTED_LENGTH else line[: MAX_QUOTED_LENGTH - 3] + "..."


def quoted(value: object) -> str:
    """Return a value as a message quotes it."""
    try:
        return one_line(repr(str(value) if isinstance(value, PurePath) else value))
    except (ValueError, RecursionError):  # an integer of thousands of digits; deeply nested lists
        return f"a value of type {type(value).__name__} that is too large to print"


class BadInput(RcmServoError, ValueError):
    """Invalid value of a field, with the expected value.

    Parameters
    ----------
    field : str
        Name of the field or argument.
    value : object
        Its invalid value.
    right : str
        Noun phrase for the values that are valid.
    """

    def __init__(self, field: str, value: object, expected: str) -> None:
        super().__init__(f"{field} must be {expected}, got {quoted(value)}")
        self.field, self.value, self.right = field, value, expected


class UnusableFile(RcmServoError):
    """File or folder that cannot be read or written, with the reason."""

    def __init__(self, path: object, why: str) -> None:
        super().__init__(f"{path}: {why}")
        self.path, self.why = path, why


class Stopped(RcmServoError):
    """Work that was stopped by request before it was done."""


class NotInstalled(RcmServoError, ModuleNotFoundError):
    """Missing package, with the command that installs it as an extra of rcmservo."""

    def __init__(self, user: str, package: str | None, extra: str) -> None:
        command = f"pip install -e '.[{extra}]'"
        why = f"{user} needs {package}, which is not installed"
        super().__init__(f"{why}: run {command} in the clone of rcmservo")


@contextmanager
def needing(user: str, extra: str) -> Generator[None]:
    """Raise :class:`NotInstalled` if `user` imports a package that only the extra installs."""
    try:
        yield
    except NotInstalled:
        raise
    except ModuleNotFoundError as error:
        raise NotInstalled(user, error.name, extra) from error


def suggestion(word: object, names: Iterable[str]) -> str:
    """Return " (did you mean ...?)" with the name that is nearest to a word, or nothing."""
    from difflib import get_close_matches

    near = get_close_matches(str(word), list(names), 1)
    return f" (did you mean {near[0]}?)" if near else ""


def require(good: bool, field: str, value: object, right: str) -> None:
    """Raise :class:`BadInput` unless `good`. Write the condition so that NaN fails it."""
    if not good:
        raise BadInput(field, value, right)
