"""Report of the reproduction: one self-contained HTML file, claims.json and figures.json.

The first table has one row per sentence of the paper, with its cases in nested tables. A second
table holds the claims about rcmservo.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from rcmservo.config.atomic_files import write_atomically
from rcmservo.figures import charts
from rcmservo.paper.claims import FAILS, HOLDS, REMARK, SOFTWARE, VERDICTS, ClaimRow, claim_table
from rcmservo.paper.experiment import Experiment
from rcmservo.paper.plan import ReportFigure
from rcmservo.study.report.html import make_data_uri, render_template

CLAIMS, FIGURES, REPORT = "claims.json", "figures.json", "report.html"


class Chapter(NamedTuple):
    """Claims and figures of an experiment.

    Parameters
    ----------
    experiment : Experiment
        Experiment, with its texts and settings.
    rows : list[ClaimRow]
        Claims, in the order of the report.
    figures : list[ReportFigure]
        Figures, in the order of the report.
    """

    experiment: Experiment
    rows: list[ClaimRow]
    figures: list[ReportFigure]


def write(out: Path, chapters: list[Chapter], quick: bool, left_out: Mapping[str, str]) -> Path:
    """Write report.html, claims.json and figures.json into `out`; return the path of the report.

    `left_out` maps experiments without results to the reason.
    """
    rows = [row for chapter in chapters for row in chapter.rows]
    figures = {
        f"{chapter.experiment.name}/{drawn.name}": asdict(drawn.chart)
        for chapter in chapters
        for drawn in chapter.figures
        if drawn.chart is not None
    }
    for name, data, indent in (
        (CLAIMS, [asdict(row) for row in rows], 1),
        (FIGURES, figures, None),
    ):
        text = json.dumps(data, indent=indent, ensure_ascii=False, allow_nan=False)
        write_atomically(out / name, text + "\n")
    write_atomically(out / REPORT, _page(rows, chapters, quick, left_out))
    return out / REPORT


def _page(
    rows: list[ClaimRow], chapters: list[Chapter], quick: bool, left_out: Mapping[str, str]
) -> str:
    papers, software = first_page(rows)
    return render_template(
        "rcmservo.paper",
        papers=papers,
        software=software,
        counts=counts(judged.head for judged in papers),
        marks={HOLDS: "●", REMARK: "◐", FAILS: "○", None: "–"},
        traps=traps_met(rows),
        sections=[_section(chapter, quick) for chapter in chapters],
        version=version("rcmservo"),
        quick=quick,
        left_out=left_out,
    )


def _section(chapter: Chapter, quick: bool) -> dict[str, object]:
    """Return the variables of a chapter for the template."""
    one, settings = chapter.experiment, chapter.experiment.settings(quick)
    mode = " --quick" if quick else ""
    return {
        "name": one.name,
        "texts": one.texts,
        "command": f"rcmservo paper{mode} --only {one.name} --out DIR",
        "settings": {name: repr(value) for name, value in {**vars(settings), **one.fixed}.items()},
        "rows": chapter.rows,
        "figures": [_figure(one, drawn, vars(settings)) for drawn in chapter.figures],
    }


def _figure(
    one: Experiment, drawn: ReportFigure, settings: Mapping[str, object]
) -> dict[str, object]:
    """Return the variables of a figure for the template, with its images as embedded data."""
    images = [make_data_uri("image/png", path.read_bytes()) for path in drawn.pictures]
    if drawn.chart is not None:
        images.append(make_data_uri("image/svg+xml", charts.render_svg(drawn.chart).encode()))
    text = one.texts.figure[drawn.key or drawn.name]
    return {
        "name": drawn.name,
        "where": text.where,
        "caption": text.caption.format(**{**settings, **drawn.words}),
        "seeds": list(drawn.seeds),
        "images": images,
    }


def counts(rows: Iterable[ClaimRow]) -> dict[str | None, int]:
    """Return the number of rows with each verdict, and without one."""
    verdicts = [row.verdict for row in rows]
    return {verdict: verdicts.count(verdict) for verdict in (*VERDICTS, None)}


@dataclass(frozen=True)
class Trap:
    """A pitfall of the paper, and the claims that concern it.

    Parameters
    ----------
    name : str
        Key: T0, T1, ...
    words : str
        Description.
    rows : list[ClaimRow]
        Claims that concern the pitfall, in the order of the report.
    """

    name: str
    words: str
    rows: list[ClaimRow]

    @property
    def verdict(self) -> str:
        """Verdict: confirmed, refuted, or too few trials."""
        known = [row.trap_confirmed for row in self.rows if row.trap_confirmed is not None]
        if not known:
            return "too few trials"
        return "confirmed" if all(known) else "refuted"


def traps_met(rows: list[ClaimRow]) -> list[Trap]:
    """Return the pitfalls that claims concern, in their order."""
    traps = claim_table().trap.items()
    every = [Trap(name, words, [r for r in rows if r.trap == name]) for name, words in traps]
    return [trap for trap in every if trap.rows]


class Cases(NamedTuple):
    """Table of the cases of one claim.

    Parameters
    ----------
    claim : str
        Statement of the claim.
    rows : list[str]
        Labels of the rows, in the order of `cells`.
    columns : list[str]
        Labels of the columns; a single empty one if the rows alone distinguish the cases.
    cells : list[list[ClaimRow or None]]
        Claims by row and column.
    """

    claim: str
    rows: list[str]
    columns: list[str]
    cells: list[list[ClaimRow | None]]


class Judged(NamedTuple):
    """A row of the first page: a sentence of the paper, or a claim about rcmservo.

    Parameters
    ----------
    where : str
        Location in the paper; empty for a claim about rcmservo.
    words : str
        Wording of the paper, or statement of the claim.
    head : ClaimRow
        First claim, which is the nearest to the wording.
    others : list[ClaimRow]
        Other claims with a single case.
    cases : list[Cases]
        A table for each claim with several cases.
    """

    where: str
    words: str
    head: ClaimRow
    others: list[ClaimRow]
    cases: list[Cases]


def first_page(rows: list[ClaimRow]) -> tuple[list[Judged], list[Judged]]:
    """Return the rows of the paper's sentences, in its order, and of the claims about rcmservo."""
    papers = [
        _judged(sentence.where, sentence.words, some)
        for about, sentence in claim_table().sentence.items()
        if (some := [row for row in rows if row.about == about])
    ]
    own = [row for row in rows if row.about == SOFTWARE]
    return papers, [_judged("", words, same) for words, same in _by_wording(own).items()]


def _by_wording(rows: list[ClaimRow]) -> dict[str, list[ClaimRow]]:
    found: dict[str, list[ClaimRow]] = {}
    for row in rows:
        found.setdefault(row.claim, []).append(row)
    return found


def _judged(where: str, words: str, rows: list[ClaimRow]) -> Judged:
    """Return the row of one sentence from all of its claims."""
    head, wordings = rows[0], _by_wording(rows).values()
    singles = [same[0] for same in wordings if len(same) == 1 and same[0] is not head]
    return Judged(where, words, head, singles, [_cases(same) for same in wordings if len(same) > 1])


def _cases(rows: list[ClaimRow]) -> Cases:
    names, columns = (list(dict.fromkeys(row.case[i] for row in rows)) for i in (0, 1))
    by_case = {row.case: row for row in rows}
    cells = [[by_case.get((name, column)) for column in columns] for name in names]
    return Cases(rows[0].claim, names, columns, cells)
