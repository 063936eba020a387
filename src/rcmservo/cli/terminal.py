"""Printing on the terminal: plain text without cropping, with replacements on an ASCII terminal."""

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
    from rich.table import Table

ASCII_REPLACEMENTS = str.maketrans(
    {
        "°": "deg",
        "±": "+-",
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
"""ASCII text for symbols that ASCII does not have."""

FILE_COLUMNS = 1000
"""Width of a pipe or a file in columns: so large that no line of a table is folded."""


def open_console(stderr: bool = False) -> "Console":
    """Return the console on which a command prints. It interprets no text as markup."""
    from rich.console import Console

    is_terminal = (sys.stderr if stderr else sys.stdout).isatty()
    width = None if is_terminal or "COLUMNS" in os.environ else FILE_COLUMNS
    return Console(stderr=stderr, markup=False, highlight=False, emoji=False, width=width)


def can_rewrite_lines(console: "Console") -> bool:
    """Return True if the console can rewrite a line, so that it can show live progress."""
    return console.is_terminal and not console.is_dumb_terminal


def use_ascii_fallback() -> None:
    """Print an ASCII replacement from now on for each symbol that the output cannot encode."""
    # no warning of Matplotlib about its cache if the home folder is not writable
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    codecs.register_error("plain", _replace_for_ascii)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="plain")


def _replace_for_ascii(error: UnicodeError) -> tuple[str, int]:
    """Handle an encoding error by replacing the symbols."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end].translate(ASCII_REPLACEMENTS)
    return "".join(map(_find_ascii_letter, text)), error.end


def _find_ascii_letter(symbol: str) -> str:
    """Return a letter without its accents, or the name of a Greek letter."""
    words = unicodedata.name(symbol, "").split()
    if words[:1] == ["GREEK"]:
        return words[-1].capitalize() if "CAPITAL" in words else words[-1].lower()
    return unicodedata.normalize("NFKD", symbol).encode("ascii", "ignore").decode() or "?"


def open_status_line(out: "Console") -> "Live":
    """Return a line of status, which a command rewrites while it runs."""
    from rich.live import Live
    from rich.text import Text

    return Live(Text(""), console=out, refresh_per_second=8, transient=True)


def format_quantity(value: float | None, unit: str, digits: int) -> str:
    """Return a number with its unit, or a dash for None."""
    return "–" if value is None else f"{value:.{digits}f} {unit}"


def build_two_column_table(title: str, rows: list[tuple[str, str]]) -> "Table":
    """Return a table of names and values. Long values are folded, never cropped."""
    from rich.table import Column, Table

    columns = Column(overflow="fold"), Column(overflow="fold")
    table = Table(*columns, title=title, show_header=False)
    for row in rows:
        table.add_row(*row)
    return table
