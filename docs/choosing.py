"""How docs/how_to_choose.md is written: its sentences stand in how_to_choose.md.j2, and each figure
in them is looked up in studies/figures.json, which make_studies.py gathers from the studies.

In the template,

    {% call says(better("noise", "dlt", "projection-own", "random, 1 px")) %}
    At 1 px of noise `dlt` comes within a millimetre in {{ share("noise", "dlt", "random, 1 px") }}.
    {% endcall %}

is a sentence that stands only while the studies bear it. Where one of its claims no longer holds,
`render` raises Unborne with the sentence. Its studies are named after it.
"""

import json
import math
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined

DOCS = Path(__file__).parent
STUDIES = DOCS / "studies"
FIGURES = STUDIES / "figures.json"
TEMPLATE = "how_to_choose.md.j2"
PAGE = DOCS / "how_to_choose.md"
CAUSES = 2
"""Causes of stops that are told apart."""
WIDTH = 120
"""Characters of a line of the page."""

LESS_IS_BETTER = "time_s", "pose_mm"


class Unborne(Exception):
    """Sentences that the studies do not bear."""


class Column(NamedTuple):
    """A number of a method under a condition, as a table has it."""

    heading: str
    key: str
    form: str
    unit: str
    times: float = 1.0


COLUMNS = {
    "share": Column("within 1 mm", "success", ".1f", " %", 100.0),
    "time": Column("first after (median)", "time_median_s", ".2f", " s"),
    "time_95": Column("first after (95 %)", "time_95_s", ".2f", " s"),
    "error": Column("error at the end (median)", "pose_median_mm", ".3f", " mm"),
    "error_95": Column("error at the end (95 %)", "pose_95_mm", ".3f", " mm"),
    "ratio": Column("error over the bound (rms)", "ratio_rms", ".2f", ""),
    "unnoticed": Column("grew without a word (worst)", "unnoticed_worst_mm", ".1f", " mm"),
}
SECONDS = Column("", "", ".2f", " s")


def told(value: Any, column: Column) -> str:
    """A number, and its interval where it has one."""
    if not isinstance(value, list):
        return f"{_number(value, column)}{column.unit}"
    middle, low, high = value
    if middle is None:
        return "never" if column.unit == " s" else "–"
    ends = f"{_number(low, column)} to {_number(high, column)}"
    return f"{_number(middle, column)}{column.unit} ({ends})"


def _number(value: float | None, column: Column) -> str:
    """A number; None has no end, and of a time never comes."""
    if value is None:
        return "never" if column.unit == " s" else "∞"
    return format(column.times * value, column.form)


@dataclass
class Page:
    """The studies' figures, and what the page says of them so far."""

    studies: Mapping[str, Any]
    """As FIGURES has them."""
    used: list[str] = field(default_factory=list[str])
    """Studies that the present sentence looked into."""
    unborne: list[str] = field(default_factory=list[str])
    """Sentences whose claims do not hold."""

    # What is looked up.

    def row(self, study: str, method: str, condition: str) -> Any:
        """The numbers of a method under a condition."""
        return self._of("rows", study, method, condition)

    def beside(self, study: str, method: str, condition: str) -> Any:
        """The differences of a method to the first one of its study, in the same scenes with the
        same noise.
        """
        return self._of("beside", study, method, condition)

    def _of(self, what: str, study: str, method: str, condition: str) -> Any:
        if study not in self.used:
            self.used.append(study)
        conditions = self.studies[study][what]
        if method not in conditions.get(condition, {}):
            known = ", ".join(f"{m} in {c}" for c, methods in conditions.items() for m in methods)
            raise KeyError(f"{study} has no {method} in {condition}, but {known}")
        return conditions[condition][method]

    def number(self, name: str) -> Callable[[str, str, str], str]:
        """What looks up one column."""
        column = COLUMNS[name]

        def look(study: str, method: str, condition: str) -> str:
            return told(self.row(study, method, condition)[column.key], column)

        return look

    def stops(self, study: str, method: str, condition: str) -> str:
        """How often which cause stopped it first, the most frequent ones."""
        row = self.row(study, method, condition)
        counted = list(row["stops"].items())
        told = [f"`{name}` {count}" for name, count in counted[:CAUSES]]
        rest = sum(count for _, count in counted[CAUSES:])
        told += [f"others {rest}"] if rest else []
        return f"{', '.join(told) or 'none'} of {row['runs']}"

    def unstopped(self, study: str, method: str, condition: str) -> str:
        """How many of its runs never stopped."""
        row = self.row(study, method, condition)
        return f"{row['runs'] - sum(row['stops'].values())} of {row['runs']}"

    def lead(self, study: str, method: str, condition: str) -> str:
        """The difference of its share to that of the first method."""
        column = Column("", "", "+.1f", " % points", 100.0)
        return told(self.beside(study, method, condition)["success"], column)

    def later(self, study: str, method: str, condition: str) -> str:
        """How much later than the first method it comes within a millimetre, the median."""
        return told(self.beside(study, method, condition)["time_s"], SECONDS)

    def sooner(self, study: str, method: str, condition: str) -> str:
        """How much sooner."""
        middle, low, high = self.beside(study, method, condition)["time_s"]
        return told([-middle, -high, -low], SECONDS)

    # What is claimed.

    def better(self, study: str, method: str, condition: str, what: str = "success") -> bool:
        """Whether a method is told apart from the first one of its study, and is the better."""
        return self._side(study, method, condition, what) > 0

    def worse(self, study: str, method: str, condition: str, what: str = "success") -> bool:
        """Whether it is told apart, and is the worse."""
        return self._side(study, method, condition, what) < 0

    def alike(self, study: str, method: str, condition: str, what: str = "success") -> bool:
        """Whether the study does not tell it apart from the first method."""
        return self._side(study, method, condition, what) == 0

    def _side(self, study: str, method: str, condition: str, what: str) -> int:
        middle, low, high = self.beside(study, method, condition)[what]
        if middle is None:
            raise ValueError(f"{study}: nothing is known of {method} in {condition}, by {what}")
        sign = (low is not None and low > 0.0) - (high is not None and high < 0.0)
        return -sign if what in LESS_IS_BETTER else sign

    def at_least(
        self, limit: float, study: str, method: str, condition: str, key: str = "success"
    ) -> bool:
        """Whether all of the interval is at least so much."""
        low = self.row(study, method, condition)[key][1]
        return low is None or low >= limit

    def at_most(
        self, limit: float, study: str, method: str, condition: str, key: str = "success"
    ) -> bool:
        """Whether all of the interval is at most so much."""
        high = self.row(study, method, condition)[key][2]
        return high is not None and high <= limit

    def below(self, one: Sequence[str], other: Sequence[str], key: str = "success") -> bool:
        """Whether the interval of `one` (study, method, condition) ends below where that of the
        `other` begins: stricter than a paired difference, and for rows that are no pairs.
        """
        high, low = self.row(*one)[key][2], self.row(*other)[key][1]
        return high is not None and (low is None or high < low)

    def stopped_by(self, cause: str, share: float, study: str, method: str, condition: str) -> bool:
        """Whether at least this share of the runs stopped by this cause first."""
        row = self.row(study, method, condition)
        return row["stops"].get(cause, 0) >= share * row["runs"]

    def runs_on(self, share: float, study: str, method: str, condition: str) -> bool:
        """Whether at least this share of the runs never stopped."""
        row = self.row(study, method, condition)
        return row["runs"] - sum(row["stops"].values()) >= share * row["runs"]

    # What is written.

    def says(self, *claims: bool, caller: Callable[[], str]) -> str:
        """A sentence that stands on claims, and the studies that it is of."""
        sentence = " ".join(caller().split())
        if not all(claims):
            which = [i + 1 for i, holds in enumerate(claims) if not holds]
            self.unborne.append(f"claim {', '.join(map(str, which))} of: {sentence}")
        return f"{sentence} {self._sources()}\n"

    def table(
        self,
        study: str,
        columns: str = "share time error",
        methods: Sequence[str] = (),
        conditions: Sequence[str] = (),
        stops: bool = False,
    ) -> str:
        """A study's numbers, or those of some methods and conditions, as a table."""
        rows: Mapping[str, Any] = self.studies[study]["rows"]
        shown = [
            (condition, method)
            for condition in conditions or rows
            for method in methods or rows[condition]
        ]
        keys = self._keys(shown)
        chosen = [COLUMNS[name] for name in columns.split()]
        head = [*keys, *(column.heading for column in chosen), *(["stops"] if stops else [])]
        lines = [head, ["---"] * len(head)]
        for condition, method in shown:
            row = self.row(study, method, condition)
            names = [{"scenes": condition, "method": f"`{method}`"}[key] for key in keys]
            numbers = [told(row[column.key], column) for column in chosen]
            lines.append([*names, *numbers, *([self.stops(study, method, condition)] * stops)])
        body = "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
        return f"{body}\n\n{self._sources()}"

    @staticmethod
    def _keys(shown: Iterable[tuple[str, str]]) -> list[str]:
        """What tells the rows apart."""
        conditions, methods = (set(names) for names in zip(*shown, strict=True))
        keys = ["scenes"] * (len(conditions) > 1) + ["method"] * (len(methods) > 1)
        return keys or ["method"]

    def _sources(self) -> str:
        used, self.used = self.used, []
        return f"({', '.join(f'[{name}]' for name in used)})" if used else ""

    def names(self) -> dict[str, Callable[..., Any]]:
        """All that the template may call."""
        figures, written = "stops unstopped lead later sooner", "says table"
        claims = "better worse alike at_least at_most below stopped_by runs_on"
        own = {name: getattr(self, name) for name in f"{figures} {claims} {written}".split()}
        return own | {name: self.number(name) for name in COLUMNS}


def render(figures: Mapping[str, Any], folder: Path = DOCS, template: str = TEMPLATE) -> str:
    """The page, if its figures bear every sentence."""
    page = Page(figures["studies"])
    environment = Environment(
        loader=FileSystemLoader(folder),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    text = environment.get_template(template).render(**page.names(), **figures)
    if page.unborne:
        raise Unborne("the studies no longer bear\n" + "\n".join(page.unborne))
    if page.used:
        raise Unborne(f"figures of {', '.join(page.used)} stand outside any sentence that says()")
    return wrapped(text)


def wrapped(text: str) -> str:
    """The same with its paragraphs in lines of WIDTH."""
    blocks = [block.strip("\n") for block in text.split("\n\n")]
    return "\n\n".join(_wrapped(block) for block in blocks if block) + "\n"


def _wrapped(block: str) -> str:
    """One block: tables, headings and the like as they are, a list item by item."""
    if block.startswith(("|", "#", "```", "<", "[", "    ")):
        return block
    if block.startswith("- "):
        return "\n".join(_filled(item, "  ") for item in block.split("\n"))
    return _filled(" ".join(block.split()))


def _filled(line: str, indent: str = "") -> str:
    return textwrap.fill(
        line, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def load(path: Path = FIGURES) -> dict[str, Any]:
    """The figures as they were gathered."""
    return json.loads(path.read_text("utf-8"))


def rounded(value: Any) -> Any:
    """Numbers as they are kept: to five digits."""
    if isinstance(value, float):
        return float(f"{value:.5g}") if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: rounded(one) for key, one in value.items()}
    return [rounded(one) for one in value] if isinstance(value, list) else value
