"""What can go wrong because of what a person gave us: one base class, subclasses that carry the
data."""

from collections.abc import Generator, Iterable
from contextlib import contextmanager
from pathlib import PurePath


class RcmServoError(Exception):
    """Any error that rcmservo raises on purpose; its message is one sentence for a person."""


LONGEST = 200
"""Characters of what others wrote that a message tells."""


def one_line(text: object) -> str:
    """A text as a message tells it: on one line, and not all of a long one."""
    line = " ".join(str(text).split())
    return line if len(line) <= LONGEST else line[: LONGEST - 3] + "..."


def told(value: object) -> str:
    """A value as a message tells it."""
    try:
        return one_line(repr(str(value) if isinstance(value, PurePath) else value))
    except (
        ValueError,
        RecursionError,
    ):  # a whole number of thousands of digits; a thousand nested lists
        return f"a value of type {type(value).__name__} that is too large to print"


class BadInput(RcmServoError, ValueError):
    """A value that cannot be used: which field, what it was, and what would be right."""

    def __init__(self, field: str, value: object, right: str) -> None:
        super().__init__(f"{field} must be {right}, got {told(value)}")
        self.field, self.value, self.right = field, value, right


class UnusableFile(RcmServoError):
    """A file or folder that cannot be read or written: which one, and why."""

    def __init__(self, path: object, why: str) -> None:
        super().__init__(f"{path}: {why}")
        self.path, self.why = path, why


class Stopped(RcmServoError):
    """Something that was told to end before it was done."""


class NotInstalled(RcmServoError, ModuleNotFoundError):
    """A package that is missing, and the command that installs it with an extra of rcmservo."""

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
    """Raise :class:`BadInput` unless `good`. Write the test so that NaN fails it."""
    if not good:
        raise BadInput(field, value, right)
