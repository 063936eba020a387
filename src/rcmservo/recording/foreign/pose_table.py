"""Reader of text tables with commas, semicolons or tabs between the columns.

Numbers may have decimal commas if commas do not separate the columns.
"""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rcmservo.errors import BadInput, UnusableFile
from rcmservo.interfaces import Floats

SEPARATORS = ",;\t"
"""Characters that may separate columns; the most frequent one in the first line does."""


@dataclass(frozen=True)
class TableRow:
    """Row of a table.

    Parameters
    ----------
    location : str
        File and row, for messages.
    cells : dict[str, str]
        Texts by column title.
    decimal : str
        Decimal separator of the numbers.
    """

    location: str
    cells: dict[str, str]
    decimal: str

    def numbers(self, columns: tuple[str, ...]) -> Floats:
        """Return the finite numbers of these columns, or raise ``BadInput``."""
        return np.array([self._parse_number(column) for column in columns])

    def numbers_or_none(self, columns: tuple[str, ...]) -> Floats:
        """Return the finite numbers of these columns, or NaN if all cells are empty."""
        if not any(self.cells[column] for column in columns):
            return np.full(len(columns), np.nan)
        return self.numbers(columns)

    def _parse_number(self, column: str) -> float:
        text = self.cells[column]
        try:
            value = float(text.replace(self.decimal, "."))
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise BadInput(f"{self.location}: {column}", text, "a finite number")
        return value


@dataclass(frozen=True)
class Table:
    """Table of a file.

    Parameters
    ----------
    path : Path
        File of the table.
    titles : list[str]
        Column titles from left to right.
    rows : list[TableRow]
        Rows below the titles, without empty ones.
    """

    path: Path
    titles: list[str]
    rows: list[TableRow]

    def require(self, columns: tuple[str, ...], purpose: str) -> None:
        """Raise ``UnusableFile`` if a column is missing; `purpose` is its use, for the message."""
        for column in columns:
            if column not in self.titles:
                raise UnusableFile(self.path, f"has no column {column}, which {purpose} needs")


def read_table(path: Path, key: str) -> Table:
    """Read a table. Messages identify its rows by the column `key`.

    Raises
    ------
    UnusableFile
        If the file cannot be read, repeats a title, or has a row with more cells than titles.
    """
    lines, separator = _read_lines(path)
    titles = lines[0] if lines else []
    for title in titles:
        if titles.count(title) > 1:
            raise UnusableFile(path, f"has two columns {title}")
    decimal = "." if separator == "," else ","
    return Table(path, titles, [_parse_row(path, key, titles, line, decimal) for line in lines[1:]])


def _parse_row(path: Path, key: str, titles: list[str], texts: list[str], decimal: str) -> TableRow:
    """Return the row with these texts; missing cells at its end are empty."""
    cells = dict(zip(titles, texts + [""] * len(titles), strict=False))
    location = f"{path}: {key} {cells.get(key, '')}"
    if len(texts) > len(titles):
        hint = "decimal commas need semicolons between columns"
        raise UnusableFile(location, f"has more cells than there are titles; {hint}")
    return TableRow(location, cells, decimal)


def _read_lines(path: Path) -> tuple[list[list[str]], str]:
    """Return the cells of all lines that are not empty, and the separator."""
    try:
        text = path.read_text("utf-8-sig").splitlines()
        separator = max(SEPARATORS, key=text[0].count) if text else ","
        lines = [[cell.strip() for cell in line] for line in csv.reader(text, delimiter=separator)]
    except OSError as error:
        raise UnusableFile(path, f"cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise UnusableFile(path, "is not a table of text in UTF-8") from error
    return [line for line in lines if any(line)], separator
