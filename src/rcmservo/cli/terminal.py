"""How the commands print: text as it is, nothing cropped, and readable where only ASCII is."""

import codecs
import io
import logging
import os
import sys
import unicodedata
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.live import Live

ASCII_REPLACEMENTS = str.maketrans(
    {
        "°": "deg",
        "∞": "inf",
        "…": "...",
        "–": "-",
        "−": "-",
        "─": "-",
        "│": "|",
        "‖": "|",
        **dict.fromkeys("╭╮╰╯", "+"),
    }
)
"""What stands for signs that ASCII does not have."""

FILE_COLUMNS = 1000
"""Columns where nobody looks: in a pipe or a file a line is as long as it is."""


def console(stderr: bool = False) -> "Console":
    """Where a command prints. Nothing in a text is taken for markup."""
    from rich.console import Console

    shown = (sys.stderr if stderr else sys.stdout).isatty()
    width = None if shown or "COLUMNS" in os.environ else FILE_COLUMNS
    return Console(stderr=stderr, markup=False, highlight=False, emoji=False, width=width)


def can_rewrite_lines(console: "Console") -> bool:
    """Whether a line can be written over, so that what goes on is seen while it does."""
    return console.is_terminal and not console.is_dumb_terminal


def use_ascii_fallback() -> None:
    """From now on, print something that ASCII has for a sign that the output cannot show."""
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # no word of a cache without a home
    codecs.register_error("plain", _replace_for_ascii)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="plain")


def _replace_for_ascii(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end].translate(ASCII_REPLACEMENTS)
    return "".join(map(_ascii_letter, text)), error.end


def _ascii_letter(sign: str) -> str:
    """A letter without its accents, or the name of a Greek one."""
    words = unicodedata.name(sign, "").split()
    if words[:1] == ["GREEK"]:
        return words[-1].capitalize() if "CAPITAL" in words else words[-1].lower()
    return unicodedata.normalize("NFKD", sign).encode("ascii", "ignore").decode() or "?"


def status_line(out: "Console") -> "Live":
    """Return a line that is written over while a command goes on."""
    from rich.live import Live
    from rich.text import Text

    return Live(Text(""), console=out, refresh_per_second=8, transient=True)


def format_quantity(value: float | None, name: str, digits: int) -> str:
    """A number with its unit, or a dash where there is none."""
    return "–" if value is None else f"{value:.{digits}f} {name}"
