"""A table of text as others write it: commas, semicolons or tabs between its columns, and decimal
commas where the columns leave the comma free."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rcmservo.errors import BadInput, UnusableFile
from rcmservo.interfaces import Floats

SEPARATORS = ",;\t"


@dataclass(frozen=True)
class TableRow:
    """One row of a table."""

    place: str
    """Where it stands, as messages tell it."""
    cells: dict[str, str]
    """Its texts by the titles of their columns."""
    decimal: str
    """What stands before the decimals of its numbers."""

    def numbers(self, columns: tuple[str, ...]) -> Floats:
        """The finite numbers in these columns."""
        return np.array([self._number(column) for column in columns])

    def numbers_or_none(self, columns: tuple[str, ...]) -> Floats:
        """The finite numbers in these columns, or NaN where all of them are empty."""
        if not any(self.cells[column] for column in columns):
            return np.full(len(columns), np.nan)
        return self.numbers(columns)

    def _number(self, column: str) -> float:
        text = self.cells[column]
        try:
            value = float(text.replace(self.decimal, "."))
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise BadInput(f"{self.place}: {column}", text, "a finite number")
        return value


@dataclass(frozen=True)
class Table:
    """A table as it was read."""

    path: Path
    """Its file."""
    titles: list[str]
    """Those of its columns, from left to right."""
    rows: list[TableRow]
    """Every row below the titles that is not empty."""

    def require(self, columns: tuple[str, ...], needs: str) -> None:
        """Refuse a table without one of the columns; `needs` says who needs them."""
        for column in columns:
            if column not in self.titles:
                raise UnusableFile(self.path, f"has no column {column}, which {needs} needs")


def read_table(path: Path, key: str) -> Table:
    """Read the table in a file. Messages tell its rows apart by the column `key`."""
    lines, separator = _lines(path)
    titles = lines[0] if lines else []
    for title in titles:
        if titles.count(title) > 1:
            raise UnusableFile(path, f"has two columns {title}")
    decimal = "." if separator == "," else ","
    return Table(path, titles, [_row(path, key, titles, line, decimal) for line in lines[1:]])


def _row(path: Path, key: str, titles: list[str], line: list[str], decimal: str) -> TableRow:
    cells = dict(zip(titles, line + [""] * len(titles), strict=False))
    place = f"{path}: {key} {cells.get(key, '')}"
    if len(line) > len(titles):
        why = "has more cells than there are titles; decimal commas need semicolons between columns"
        raise UnusableFile(place, why)
    return TableRow(place, cells, decimal)


def _lines(path: Path) -> tuple[list[list[str]], str]:
    """The cells of all lines that are not empty, and what separates them."""
    try:
        text = path.read_text("utf-8-sig").splitlines()
        separator = max(SEPARATORS, key=text[0].count) if text else ","
        lines = [[cell.strip() for cell in line] for line in csv.reader(text, delimiter=separator)]
    except OSError as error:
        raise UnusableFile(path, f"cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise UnusableFile(path, "is not a table of text in UTF-8") from error
    return [line for line in lines if any(line)], separator
