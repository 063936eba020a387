"""Report of the reproduction: one self-contained HTML file, claims.json and figures.json.

The first table has one row per sentence of the paper, with its cases in nested tables. A second
table holds the claims about rcmservo.
"""

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from rcmservo.config.atomic_files import write_atomically
from rcmservo.figures import charts
from rcmservo.paper.claims import FAILS, HOLDS, REMARK, SOFTWARE, ClaimRow, claim_table
from rcmservo.paper.experiment import Experiment
from rcmservo.paper.plan import PaperFigure
from rcmservo.study.report.html import make_data_uri, render_template


class Chapter(NamedTuple):
    """Claims and figures of an experiment.

    Parameters
    ----------
    experiment : Experiment
        Experiment, with its texts and settings.
    rows : list[ClaimRow]
        Claims, in the order of the report.
    figures : list[PaperFigure]
        Figures, in the order of the report.
    """

    experiment: Experiment
    rows: list[ClaimRow]
    figures: list[PaperFigure]


def write(out: Path, chapters: list[Chapter], quick: bool, left_out: Mapping[str, str]) -> Path:
    """Write report.html, claims.json and figures.json into `out`; return the path of the report.

    `left_out` maps experiments without results to the reason.
    """
    rows = [row for chapter in chapters for row in chapter.rows]
    figures = {
        f"{chapter.experiment.name}/{figure.name}": asdict(figure.chart)
        for chapter in chapters
        for figure in chapter.figures
        if figure.chart is not None
    }
    claims = [asdict(row) for row in rows]
    for name, data, indent in (("claims.json", claims, 1), ("figures.json", figures, None)):
        text = json.dumps(data, indent=indent, ensure_ascii=False, allow_nan=False)
        write_atomically(out / name, text + "\n")
    page = out / "report.html"
    write_atomically(page, _render_page(rows, chapters, quick, left_out))
    return page


def _render_page(
    rows: list[ClaimRow], chapters: list[Chapter], quick: bool, left_out: Mapping[str, str]
) -> str:
    papers, software = first_page(rows)
    return render_template(
        "rcmservo.paper",
        papers=papers,
        software=software,
        counts=Counter(judged.head.verdict for judged in papers),
        marks={HOLDS: "●", REMARK: "◐", FAILS: "○", None: "–"},
        traps=list_traps(rows),
        sections=[_describe_chapter(chapter, quick) for chapter in chapters],
        version=version("rcmservo"),
        quick=quick,
        left_out=left_out,
    )


def _describe_chapter(chapter: Chapter, quick: bool) -> dict[str, object]:
    """Return the variables of a chapter for the template."""
    experiment, settings = chapter.experiment, vars(chapter.experiment.settings(quick))
    reported = {name: repr(value) for name, value in {**settings, **experiment.constants}.items()}
    mode = " --quick" if quick else ""
    return {
        "name": experiment.name,
        "texts": experiment.texts,
        "command": f"rcmservo paper{mode} --only {experiment.name} --out DIR",
        "settings": reported,
        "rows": chapter.rows,
        "figures": [_describe_figure(experiment, figure, settings) for figure in chapter.figures],
    }


def _describe_figure(
    experiment: Experiment, figure: PaperFigure, settings: Mapping[str, object]
) -> dict[str, object]:
    """Return the variables of a figure for the template, with its images as embedded data."""
    images = [make_data_uri("image/png", path.read_bytes()) for path in figure.pictures]
    if figure.chart is not None:
        images.append(make_data_uri("image/svg+xml", charts.render_svg(figure.chart).encode()))
    text = experiment.texts.figure[figure.key or figure.name]
    caption = text.caption.format(**{**settings, **figure.texts})
    seeds = list(figure.seeds)
    return dict(name=figure.name, where=text.where, caption=caption, seeds=seeds, images=images)


@dataclass(frozen=True)
class Trap:
    """A pitfall of the paper, and the claims that concern it.

    Parameters
    ----------
    name : str
        Key: T0, T1, ...
    description : str
        Sentence that describes the pitfall.
    rows : list[ClaimRow]
        Claims that concern the pitfall, in the order of the report.
    """

    name: str
    description: str
    rows: list[ClaimRow]

    @property
    def verdict(self) -> str:
        """Verdict: confirmed, refuted, or too few trials."""
        known = [row.trap_confirmed for row in self.rows if row.trap_confirmed is not None]
        return "too few trials" if not known else "confirmed" if all(known) else "refuted"


def list_traps(rows: list[ClaimRow]) -> list[Trap]:
    """Return the pitfalls that claims concern, in their order."""
    traps = [
        Trap(name, description, [row for row in rows if row.trap == name])
        for name, description in claim_table().trap.items()
    ]
    return [trap for trap in traps if trap.rows]


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
    wording : str
        Wording of the paper, or statement of the claim.
    head : ClaimRow
        First claim, which is the nearest to the wording.
    others : list[ClaimRow]
        Other claims with a single case.
    cases : list[Cases]
        A table for each claim with several cases.
    """

    where: str
    wording: str
    head: ClaimRow
    others: list[ClaimRow]
    cases: list[Cases]


def first_page(rows: list[ClaimRow]) -> tuple[list[Judged], list[Judged]]:
    """Return the rows of the paper's sentences, in its order, and of the claims about rcmservo."""
    papers = [
        _judge_sentence(sentence.where, sentence.wording, rows_of_sentence)
        for about, sentence in claim_table().sentence.items()
        if (rows_of_sentence := [row for row in rows if row.about == about])
    ]
    software = _group_by_statement([row for row in rows if row.about == SOFTWARE])
    return papers, [_judge_sentence("", group[0].claim, group) for group in software]


def _group_by_statement(rows: list[ClaimRow]) -> list[list[ClaimRow]]:
    groups: dict[str, list[ClaimRow]] = {}
    for row in rows:
        groups.setdefault(row.claim, []).append(row)
    return list(groups.values())


def _judge_sentence(where: str, wording: str, rows: list[ClaimRow]) -> Judged:
    """Return the row of one sentence from all of its claims."""
    head, groups = rows[0], _group_by_statement(rows)
    others = [group[0] for group in groups if len(group) == 1 and group[0] is not head]
    tables = [_tabulate_cases(group) for group in groups if len(group) > 1]
    return Judged(where, wording, head, others, tables)


def _tabulate_cases(rows: list[ClaimRow]) -> Cases:
    names, columns = (list(dict.fromkeys(row.case[i] for row in rows)) for i in (0, 1))
    by_case = {row.case: row for row in rows}
    cells = [[by_case.get((name, column)) for column in columns] for name in names]
    return Cases(rows[0].claim, names, columns, cells)
