"""The command line as settings; what is wrong with it as one sentence."""

import contextlib
import io
import re
from typing import Any

import tyro

from rcmservo.errors import RcmServoError


class Unparsed(RcmServoError):
    """A command line that does not say what to do."""


def parse(kind: Any, arguments: list[str] | None, default: Any = tyro.MISSING) -> Any:
    """The command line as settings. What is wrong with it comes as one sentence instead of tyro's
    boxes."""
    errors = io.StringIO()
    try:
        with contextlib.redirect_stderr(errors):
            return tyro.cli(kind, prog="rcmservo", args=arguments, default=default)
    except SystemExit as stop:
        if not stop.code:
            raise
        raise Unparsed(_sentence(errors.getvalue())) from None


def _sentence(box: str) -> str:
    """The first part of a boxed error, without its title, and the option that was probably
    meant."""
    parts: list[list[str]] = [[]]
    for line in (line.strip("│╰╯ ") for line in box.splitlines()[1:]):
        if line.strip("─-"):
            parts[-1].append(line)
        elif line and parts[-1]:
            parts.append([])
    words = re.sub(r"Error parsing \S*__tyro\S+: ", "", " ".join(parts[0])).rstrip(".")
    near = next(
        (part[1].split()[0] for part in parts if part and part[0].startswith("Perhaps you meant")),
        None,
    )
    hint = f" (did you mean {near}?)" if near else ""
    return f"{words[:1].lower()}{words[1:]}{hint}; see rcmservo --help"
