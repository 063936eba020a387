"""The report: one HTML file that opens offline, and claims.json beside it."""

import base64
import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from rcmservo.config.files import write_whole
from rcmservo.experiments.harness.claims import FAILS, HOLDS, REMARK, Chapter, Shown
from rcmservo.experiments.harness.plain import built, plain
from rcmservo.experiments.harness.rows import ClaimRow, counts, first_page, rows_of
from rcmservo.experiments.harness.tasks import Experiment
from rcmservo.experiments.harness.traps import traps_met
from rcmservo.figures import charts
from rcmservo.figures.charts import Figure

CLAIMS, FIGURES, REPORT = "claims.json", "figures.json", "report.html"


@dataclass(frozen=True)
class Picture:
    """A figure as it stands in the page."""

    name: str
    """In links, after its section's name."""
    where: str
    """What of the paper it stands for, or another heading; its caption begins with it."""
    caption: str
    """What it shows, in sentences; it also stands in for an image that cannot be seen."""
    seeds: list[int]
    """Named beneath it; empty for a computation without chance."""
    images: list[str]
    """As data that the page embeds."""


@dataclass(frozen=True)
class Section:
    """A chapter as it stands in the page."""

    name: str
    """Its experiment's; links to its claims and figures begin with it."""
    title: str
    """Its heading."""
    about: str
    """What was tried, in sentences below the heading."""
    command: str
    """The command line that makes this chapter alone, DIR standing for a folder."""
    settings: list[tuple[str, str]]
    """Name and value of each field of the experiment's settings, as Python writes them."""
    rows: list[ClaimRow]
    """Its claims, in their order."""
    figures: list[Picture]
    """In their order, below the claims."""


def write(
    out: Path,
    chapters: Mapping[str, Chapter],
    experiments: Mapping[str, Experiment[Any]],
    quick: bool,
    left_out: Mapping[str, str],
) -> Path:
    """Write the report, the claims and the figures' data; give the report's path. What is
    `left_out`, and why, stands on its first lines."""
    rows = rows_of(chapters)
    write_whole(out / CLAIMS, json.dumps(plain(rows), indent=1, ensure_ascii=False) + "\n")
    figures = plain(figures_of(chapters))
    write_whole(out / FIGURES, json.dumps(figures, ensure_ascii=False) + "\n")
    sections = [_section(experiments[name], chapter, quick) for name, chapter in chapters.items()]
    write_whole(out / REPORT, _page(rows, sections, quick, left_out))
    return out / REPORT


def claims_in(out: Path) -> list[ClaimRow]:
    """The claims of a report that was written."""
    return built(list[ClaimRow], json.loads((out / CLAIMS).read_text()))


def figures_of(chapters: Mapping[str, Chapter]) -> dict[str, Figure]:
    """All charts, by experiment and figure."""
    return {
        f"{name}/{shown.name}": shown.chart
        for name, chapter in chapters.items()
        for shown in chapter.figures
        if shown.chart is not None
    }


def _page(
    rows: list[ClaimRow], sections: list[Section], quick: bool, left_out: Mapping[str, str]
) -> str:
    environment = Environment(
        loader=PackageLoader("rcmservo.experiments.harness", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    papers, ours = first_page(rows)
    return environment.get_template("report.html.j2").render(
        papers=papers,
        ours=ours,
        counts=counts(judged.head for judged in papers),
        marks={HOLDS: "●", REMARK: "◐", FAILS: "○", None: "–"},
        traps=traps_met(rows),
        sections=sections,
        version=version("rcmservo"),
        quick=quick,
        left_out=left_out,
    )


def _section(experiment: Experiment[Any], chapter: Chapter, quick: bool) -> Section:
    settings = experiment.settings(quick)
    mode = " --quick" if quick else ""
    return Section(
        name=experiment.name,
        title=experiment.title,
        about=experiment.about,
        command=f"rcmservo paper{mode} --only {experiment.name} --out DIR",
        settings=[(f.name, repr(getattr(settings, f.name))) for f in fields(settings)],
        rows=rows_of({experiment.name: chapter}),
        figures=[_picture(shown) for shown in chapter.figures],
    )


def _picture(shown: Shown) -> Picture:
    images = [_embedded("image/png", path.read_bytes()) for path in shown.pictures]
    if shown.chart is not None:
        images.append(_embedded("image/svg+xml", charts.svg(shown.chart).encode()))
    return Picture(shown.name, shown.where, shown.caption, list(shown.seeds), images)


def _embedded(kind: str, data: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
