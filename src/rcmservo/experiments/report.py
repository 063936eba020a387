"""The report: one HTML file that opens offline, and claims.json beside it."""

import base64
import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from rcmservo import charts
from rcmservo.experiments.claims import FAILS, HOLDS, REMARK, Chapter, Experiment, Shown
from rcmservo.files import write_whole

CLAIMS, FIGURES, REPORT = "claims.json", "figures.json", "report.html"


def write(out: Path, chapters: Mapping[str, Chapter], experiments: Mapping[str, Experiment], quick: bool) -> Path:
    """Write the report, the claims and the figures' data; give the report's path."""
    rows = claim_rows(chapters)
    write_whole(out / CLAIMS, json.dumps(rows, indent=1, ensure_ascii=False) + "\n")
    write_whole(out / FIGURES, json.dumps(figure_data(chapters), ensure_ascii=False) + "\n")
    template = Environment(
        loader=PackageLoader("rcmservo.experiments", "."), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    ).get_template("report.html.j2")  # fmt: skip
    page = template.render(
        rows=rows,
        counts={verdict: sum(row["verdict"] == verdict for row in rows) for verdict in (HOLDS, REMARK, FAILS)},
        traps=_by_trap(rows),
        chapters=[_chapter(experiments[name], chapter, quick) for name, chapter in chapters.items()],
        version=version("rcmservo"),
        quick=quick,
    )
    write_whole(out / REPORT, page)
    return out / REPORT


def claim_rows(chapters: Mapping[str, Chapter]) -> list[dict[str, Any]]:
    """All claims as plain rows."""
    return [claim.row(name) for name, chapter in chapters.items() for claim in chapter.claims]


def figure_data(chapters: Mapping[str, Chapter]) -> dict[str, Any]:
    """The numbers of all charts, by experiment and figure."""
    return {
        f"{name}/{shown.name}": asdict(shown.chart)
        for name, chapter in chapters.items()
        for shown in chapter.figures
        if shown.chart is not None
    }


def _by_trap(rows: list[dict[str, Any]]) -> list[tuple[str, list[dict[str, Any]]]]:
    """The claims that meet a trap of the paper, in the traps' order."""
    names = {row["trap"] for row in rows if row["trap"]}
    ordered = sorted(names, key=lambda name: (not name[1:].isdigit(), int(name[1:]) if name[1:].isdigit() else 0))
    return [(name, [row for row in rows if row["trap"] == name]) for name in ordered]


def _chapter(experiment: Experiment, chapter: Chapter, quick: bool) -> dict[str, Any]:
    settings = experiment.quick if quick else experiment.whole
    mode = " --quick" if quick else ""
    return {
        "name": experiment.name,
        "title": experiment.title,
        "about": experiment.about,
        "command": f"rcmservo paper{mode} --only {experiment.name} --out DIR",
        "settings": [(f.name, repr(getattr(settings, f.name))) for f in fields(settings)],
        "claims": [claim.row(experiment.name) for claim in chapter.claims],
        "figures": [_figure(shown) for shown in chapter.figures],
    }


def _figure(shown: Shown) -> dict[str, Any]:
    images = [_embedded("image/png", path.read_bytes()) for path in shown.pictures]
    if shown.chart is not None:
        images.append(_embedded("image/svg+xml", charts.svg(shown.chart).encode()))
    return {"name": shown.name, "where": shown.where, "caption": shown.caption, "seeds": list(shown.seeds),
            "images": images}  # fmt: skip


def _embedded(kind: str, data: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
