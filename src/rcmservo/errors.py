"""Errors that rcmservo raises deliberately, with the data of their messages as attributes."""

from collections.abc import Generator, Iterable
from contextlib import contextmanager
from pathlib import PurePath
from typing import Any


class RcmServoError(Exception):
    """Base of all errors that rcmservo raises deliberately; the message is one sentence.

    Notes
    -----
    `BadInput` and `UnusableFile` are public names. The other derived errors, by their modules:

    - `rcmservo.loop`: ``NotEnabled`` in ``plant``, ``TeachingFailed`` in ``teach``.
    - `rcmservo.servo`: ``UnusableEstimator`` in ``user_estimator``.
    - `rcmservo.errors`: ``NotInstalled`` for a missing package, ``Stopped`` for a requested stop.
    - `rcmservo.sim`: ``Killed``, and ``NoScene`` in ``scene``.
    - `rcmservo.live`: ``NoAnswer`` in ``arm_datagrams``, ``NoFrames`` in ``servo_process``,
      ``NotReady`` in ``device_protocols``.
    - `rcmservo.hardware`: ``ConnectionLost`` and ``CommandRejected`` in ``galil.connection``,
      ``InvalidRecord`` in ``galil.data_record``, ``PortUnavailable`` in ``galil.emulator.server``,
      ``NoTransport`` in ``crtk.messages``, ``CameraLost`` in ``cameras.streamed_camera``,
      ``AravisError`` in ``cameras.aravis_library``.
    - `rcmservo.recording`: ``MalformedMessage`` in ``cdr``.
    - `rcmservo.testing`: ``ContractViolation``.
    - `rcmservo.study`: ``WorkLost`` in ``execution.workers``, ``PackageMismatch`` in
      ``execution.chunk``.
    - The commands: ``CheckAborted`` in `rcmservo.bringup.findings`, ``InvalidCommandLine`` in
      `rcmservo.cli.argument_parsing.parse`, ``NoPagePort`` in `rcmservo.page.web.access`,
      ``NotMeasured`` in `rcmservo.paper.plan`.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what a process sends to another one, for arguments other than the message."""
        return _restore_error, (type(self), self.args, self.__dict__)


def _restore_error(kind: type[RcmServoError], args: tuple[Any, ...], state: Any) -> RcmServoError:
    error = kind.__new__(kind, *args)
    error.__dict__.update(state)
    return error


MAX_QUOTED_CHARACTERS = 200
"""Largest number of characters of foreign text that a message quotes."""


def shorten_to_line(text: object) -> str:
    """Return a text on one line, cut to the length that a message quotes."""
    line = " ".join(str(text).split())
    return line if len(line) <= MAX_QUOTED_CHARACTERS else line[: MAX_QUOTED_CHARACTERS - 3] + "..."


def quote_value(value: object) -> str:
    """Return a value in the form in which a message quotes it."""
    try:
        return shorten_to_line(repr(str(value) if isinstance(value, PurePath) else value))
    except (ValueError, RecursionError):  # an integer of thousands of digits; deeply nested lists
        return f"a value of type {type(value).__name__} that is too large to print"


class BadInput(RcmServoError, ValueError):
    """Invalid value of a field, with the expected value.

    The parameters are also attributes of the error.

    Parameters
    ----------
    field : str
        Name of the field or argument.
    value : object
        Invalid value, of which the message quotes at most 200 characters.
    expected : str
        Noun phrase for the valid values.
    """

    def __init__(self, field: str, value: object, expected: str) -> None:
        super().__init__(f"{field} must be {expected}, got {quote_value(value)}")
        self.field, self.value, self.expected = field, value, expected


class UnusableFile(RcmServoError):
    """File or folder that cannot be read or written, with the reason.

    The parameters are also attributes of the error.

    Parameters
    ----------
    path : object
        Path of the file or folder.
    why : str
        Reason, as a clause that follows the path.
    """

    def __init__(self, path: object, why: str) -> None:
        super().__init__(f"{path}: {why}")
        self.path, self.why = path, why


class Stopped(RcmServoError):
    """Work that ended early because a stop was requested."""


class NotInstalled(RcmServoError, ModuleNotFoundError):
    """Missing package, with the command that installs it as an extra of rcmservo."""

    def __init__(self, user: str, package: str | None, extra: str) -> None:
        command = f"pip install -e '.[{extra}]'"
        reason = f"{user} needs {package}, which is not installed"
        super().__init__(f"{reason}: run {command} in the clone of rcmservo")


@contextmanager
def require_extra(user: str, extra: str) -> Generator[None]:
    """Raise :class:`NotInstalled` if `user` imports a package that only the extra installs."""
    try:
        yield
    except NotInstalled:
        raise
    except ModuleNotFoundError as error:
        raise NotInstalled(user, error.name, extra) from error


def suggest_name(word: object, names: Iterable[str]) -> str:
    """Return " (did you mean ...?)" with the name most similar to `word`, or an empty text."""
    from difflib import get_close_matches

    matches = get_close_matches(str(word), list(names), 1)
    return f" (did you mean {matches[0]}?)" if matches else ""


def require(condition: bool, field: str, value: object, expected: str) -> None:
    """Raise `BadInput` unless the condition holds; write the condition so that NaN fails it."""
    if not condition:
        raise BadInput(field, value, expected)
