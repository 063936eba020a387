"""Generator of the pages that cite studies, from their templates and the numbers of the studies.

The pages are docs/how_to_choose.md and docs/imperfect_arms.md. The template of a page holds the
sentences. Their numbers are read from figures.json in the folder of its studies, which
make_studies.py collects from the studies.

In the template,

    {% call says(better("noise", "dlt", "projection-own", "random, 1 px")) %}
    At 1 px of noise `dlt` comes within a millimetre in {{ share("noise", "dlt", "random, 1 px") }}.
    {% endcall %}

is a sentence that the studies must support. If one of its claims no longer holds, `render` raises
`UnsupportedClaim` with the sentence. The names of its studies follow the sentence on the page.
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
MAX_LISTED_CAUSES = 2
"""Number of causes of stops that are listed one by one."""
LINE_LENGTH = 120
"""Characters of a line of the page."""

LESS_IS_BETTER = "time_s", "pose_mm"
"""Differences that are negative for the better method."""


class StudyPage(NamedTuple):
    """Page of the documentation that cites the studies of a folder."""

    name: str
    studies: Path

    @property
    def path(self) -> Path:
        """Page itself."""
        return DOCS / f"{self.name}.md"

    @property
    def figures(self) -> Path:
        """Numbers of its studies."""
        return self.studies / "figures.json"

    def list_studies(self) -> list[str]:
        """Return the names of its studies."""
        return sorted(path.stem for path in self.studies.glob("*.toml"))

    def render(self) -> str:
        """Return its text by the present numbers."""
        return render(load(self.figures), DOCS, f"{self.name}.md.j2")


PAGES = (
    StudyPage("how_to_choose", DOCS / "studies"),
    StudyPage("imperfect_arms", DOCS / "studies/imperfect_arms"),
)
"""Pages that cite studies."""


class UnsupportedClaim(Exception):
    """Sentences that the studies do not support."""


class Column(NamedTuple):
    """Column of a table: heading, key in figures.json, format, unit and scale factor."""

    heading: str
    key: str
    form: str
    unit: str
    scale: float = 1.0


COLUMNS = {
    "share": Column("within 1 mm", "success", ".1f", " %", 100.0),
    "time": Column("time to 1 mm (median)", "time_median_s", ".2f", " s"),
    "time_95": Column("time to 1 mm (95 %)", "time_95_s", ".2f", " s"),
    "error": Column("pose error (median)", "pose_median_mm", ".3f", " mm"),
    "error_95": Column("pose error (95 %)", "pose_95_mm", ".3f", " mm"),
    "ratio": Column("error over the bound (rms)", "ratio_rms", ".2f", ""),
    "unnoticed": Column("unnoticed growth (largest)", "unnoticed_worst_mm", ".1f", " mm"),
}
SECONDS = Column("", "", ".2f", " s")


def format_estimate(value: Any, column: Column) -> str:
    """Return a number as text, with its interval if it has one."""
    if not isinstance(value, list):
        return f"{_format_number(value, column)}{column.unit}"
    middle, low, high = value
    if middle is None:
        return "never" if column.unit == " s" else "–"
    ends = f"{_format_number(low, column)} to {_format_number(high, column)}"
    return f"{_format_number(middle, column)}{column.unit} ({ends})"


def _format_number(value: float | None, column: Column) -> str:
    """Return a number as text; None is infinity, or "never" for a time."""
    if value is None:
        return "never" if column.unit == " s" else "∞"
    return format(column.scale * value, column.form)


@dataclass
class Page:
    """Numbers of the studies, and the claims of the page that they do not support."""

    studies: Mapping[str, Any]
    """Numbers of the studies by name, as in FIGURES."""
    used: list[str] = field(default_factory=list[str])
    """Studies that the present sentence cites."""
    unsupported: list[str] = field(default_factory=list[str])
    """Sentences with a claim that does not hold."""

    # Numbers.

    def row(self, study: str, method: str, condition: str) -> Any:
        """Return the numbers of a method under a condition."""
        return self._look_up("rows", study, method, condition)

    def beside(self, study: str, method: str, condition: str) -> Any:
        """Return the paired differences of a method to the first one of its study."""
        return self._look_up("beside", study, method, condition)

    def _look_up(self, kind: str, study: str, method: str, condition: str) -> Any:
        if study not in self.used:
            self.used.append(study)
        conditions = self.studies[study][kind]
        if method not in conditions.get(condition, {}):
            known = ", ".join(f"{m} in {c}" for c, methods in conditions.items() for m in methods)
            raise KeyError(f"{study} has no {method} in {condition}, but {known}")
        return conditions[condition][method]

    def number(self, name: str) -> Callable[[str, str, str], str]:
        """Return the function that formats the column `name` of a row."""
        column = COLUMNS[name]

        def format_column(study: str, method: str, condition: str) -> str:
            return format_estimate(self.row(study, method, condition)[column.key], column)

        return format_column

    def stops(self, study: str, method: str, condition: str) -> str:
        """Return the counts of the most frequent causes of first stops."""
        row = self.row(study, method, condition)
        counted = list(row["stops"].items())
        listed = [f"`{name}` {count}" for name, count in counted[:MAX_LISTED_CAUSES]]
        rest = sum(count for _, count in counted[MAX_LISTED_CAUSES:])
        listed += [f"others {rest}"] if rest else []
        return f"{', '.join(listed) or 'none'} of {row['runs']}"

    def unstopped(self, study: str, method: str, condition: str) -> str:
        """Return the number of runs without a stop."""
        row = self.row(study, method, condition)
        return f"{row['runs'] - sum(row['stops'].values())} of {row['runs']}"

    def lead(self, study: str, method: str, condition: str) -> str:
        """Return the difference of its success rate to that of the first method."""
        column = Column("", "", "+.1f", " % points", 100.0)
        return format_estimate(self.beside(study, method, condition)["success"], column)

    def later(self, study: str, method: str, condition: str) -> str:
        """Return the median delay, after the first method, of its arrival within 1 mm."""
        return format_estimate(self.beside(study, method, condition)["time_s"], SECONDS)

    def sooner(self, study: str, method: str, condition: str) -> str:
        """Return the median lead, before the first method, of its arrival within 1 mm."""
        middle, low, high = self.beside(study, method, condition)["time_s"]
        return format_estimate([-middle, -high, -low], SECONDS)

    # Claims.

    def better(self, study: str, method: str, condition: str, key: str = "success") -> bool:
        """Return True if a method is better than the first one of its study, with confidence."""
        return self._compare(study, method, condition, key) > 0

    def worse(self, study: str, method: str, condition: str, key: str = "success") -> bool:
        """Return True if a method is worse than the first one of its study, with confidence."""
        return self._compare(study, method, condition, key) < 0

    def alike(self, study: str, method: str, condition: str, key: str = "success") -> bool:
        """Return True if the study shows no difference of a method to the first one."""
        return self._compare(study, method, condition, key) == 0

    def _compare(self, study: str, method: str, condition: str, key: str) -> int:
        """Return 1 for a better, -1 for a worse method, 0 if the interval contains 0."""
        middle, low, high = self.beside(study, method, condition)[key]
        if middle is None:
            raise ValueError(f"{study}: {key} of {method} in {condition} is unknown")
        sign = (low is not None and low > 0.0) - (high is not None and high < 0.0)
        return -sign if key in LESS_IS_BETTER else sign

    def at_least(
        self, limit: float, study: str, method: str, condition: str, key: str = "success"
    ) -> bool:
        """Return True if the whole interval is at least `limit`."""
        low = self.row(study, method, condition)[key][1]
        return low is None or low >= limit

    def at_most(
        self, limit: float, study: str, method: str, condition: str, key: str = "success"
    ) -> bool:
        """Return True if the whole interval is at most `limit`."""
        high = self.row(study, method, condition)[key][2]
        return high is not None and high <= limit

    def below(self, one: Sequence[str], other: Sequence[str], key: str = "success") -> bool:
        """Return True if the interval of `one` (study, method, condition) is below that of `other`.

        This is stricter than a paired difference, and valid for rows that are not paired.
        """
        high, low = self.row(*one)[key][2], self.row(*other)[key][1]
        return high is not None and (low is None or high < low)

    def stopped_by(
        self, cause: str, fraction: float, study: str, method: str, condition: str
    ) -> bool:
        """Return True if this cause was the first stop of at least this fraction of the runs."""
        row = self.row(study, method, condition)
        return row["stops"].get(cause, 0) >= fraction * row["runs"]

    def runs_on(self, fraction: float, study: str, method: str, condition: str) -> bool:
        """Return True if at least this fraction of the runs never stopped."""
        row = self.row(study, method, condition)
        return row["runs"] - sum(row["stops"].values()) >= fraction * row["runs"]

    # Output.

    def says(self, *claims: bool, caller: Callable[[], str]) -> str:
        """Return a sentence with its studies, and note it if one of its claims does not hold."""
        sentence = " ".join(caller().split())
        if not all(claims):
            numbers = [i + 1 for i, holds in enumerate(claims) if not holds]
            self.unsupported.append(f"claim {', '.join(map(str, numbers))} of: {sentence}")
        return f"{sentence} {self._cite_studies()}\n"

    def table(
        self,
        study: str,
        columns: str = "share time error",
        methods: Sequence[str] = (),
        conditions: Sequence[str] = (),
        stops: bool = False,
    ) -> str:
        """Return a table of a study's numbers, or of those of some methods and conditions."""
        rows: Mapping[str, Any] = self.studies[study]["rows"]
        pairs = [
            (condition, method)
            for condition in conditions or rows
            for method in methods or rows[condition]
        ]
        keys = self._choose_keys(pairs)
        chosen = [COLUMNS[name] for name in columns.split()]
        head = [*keys, *(column.heading for column in chosen), *(["stops"] if stops else [])]
        lines = [head, ["---"] * len(head)]
        for condition, method in pairs:
            row = self.row(study, method, condition)
            names = [{"scenes": condition, "method": f"`{method}`"}[key] for key in keys]
            numbers = [format_estimate(row[column.key], column) for column in chosen]
            lines.append([*names, *numbers, *([self.stops(study, method, condition)] * stops)])
        body = "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
        return f"{body}\n\n{self._cite_studies()}"

    @staticmethod
    def _choose_keys(pairs: Iterable[tuple[str, str]]) -> list[str]:
        """Return the key columns that differ between the rows."""
        conditions, methods = (set(names) for names in zip(*pairs, strict=True))
        keys = ["scenes"] * (len(conditions) > 1) + ["method"] * (len(methods) > 1)
        return keys or ["method"]

    def _cite_studies(self) -> str:
        used, self.used = self.used, []
        return f"({', '.join(f'[{name}]' for name in used)})" if used else ""

    def names(self) -> dict[str, Callable[..., Any]]:
        """Return the functions that the template may call."""
        figures, output = "stops unstopped lead later sooner", "says table"
        claims = "better worse alike at_least at_most below stopped_by runs_on"
        methods = {name: getattr(self, name) for name in f"{figures} {claims} {output}".split()}
        return methods | {name: self.number(name) for name in COLUMNS}


def render(figures: Mapping[str, Any], folder: Path, template: str) -> str:
    """Render a page.

    Raises
    ------
    UnsupportedClaim
        If the studies do not support a sentence, or a number is outside `says`.
    """
    page = Page(figures["studies"])
    environment = Environment(
        loader=FileSystemLoader(folder),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    text = environment.get_template(template).render(**page.names(), **figures)
    if page.unsupported:
        raise UnsupportedClaim("the studies no longer support\n" + "\n".join(page.unsupported))
    if page.used:
        raise UnsupportedClaim(f"numbers of {', '.join(page.used)} are outside a call of says()")
    return wrap_paragraphs(text)


def wrap_paragraphs(text: str) -> str:
    """Return the text with its paragraphs in lines of LINE_LENGTH characters."""
    blocks = [block.strip("\n") for block in text.split("\n\n")]
    return "\n\n".join(_wrap_block(block) for block in blocks if block) + "\n"


def _wrap_block(block: str) -> str:
    """Wrap a paragraph, or a list item by item; leave tables, headings and code unchanged."""
    if block.startswith(("|", "#", "```", "<", "[", "    ")):
        return block
    if block.startswith("- "):
        return "\n".join(_fill(item, "  ") for item in block.split("\n"))
    return _fill(" ".join(block.split()))


def _fill(line: str, indent: str = "") -> str:
    return textwrap.fill(
        line, LINE_LENGTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def load(path: Path) -> dict[str, Any]:
    """Read a figures.json."""
    return json.loads(path.read_text("utf-8"))


def round_numbers(value: Any) -> Any:
    """Return a value for figures.json: numbers with five digits, None for infinite ones."""
    if isinstance(value, float):
        return float(f"{value:.5g}") if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: round_numbers(one) for key, one in value.items()}
    return [round_numbers(one) for one in value] if isinstance(value, list) else value
