"""The report: one HTML file that opens offline, and claims.json beside it."""

import base64
import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from rcmservo.config.files import write_whole
from rcmservo.experiments.harness.claims import FAILS, HOLDS, REMARK, Chapter, Experiment, Shown
from rcmservo.figures import charts

CLAIMS, FIGURES, REPORT = "claims.json", "figures.json", "report.html"


TRAPS = {
    "T0": "errata: as printed, the gradient of (32) drops from b to b/2",
    "T1": "nothing can be inverted at Ĵ(0) = 0, â(0) = 0; and success does not show that Ĵ is "
    "right",
    "T2": "λ is not constant on a real tool",
    "T3": "singular poses: judge the scaled condition, not the determinant",
    "T4": "spherical coordinates are singular at θ = 0",
    "T5": "the gains fit mm and px: k = 0.1 with b = 10 is 1 px/s",
    "T6": "the printed Γ is a slow solver",
    "T7": "γ = 0.001 learns by 1 − exp(−γ v L): hardly at 1 mm/s",
    "T8": "the last H lines of a slow motion are almost one line",
    "T9": "six observations are neither needed nor enough: coplanar ones have rank 8",
    "T10": "a wrong zero of ρ breaks c₁₄ = c₂₄ = 0",
    "T11": "the angle wraps",
    "T12": "60 frames/s in a 100 Hz loop: repeated frames bias ẏ",
    "T13": "pixel noise is large against 1 px/s",
    "T14": "a ball's centroid is not its centre's image",
    "T15": "(33) assumes J Ĵ⁻¹ = I; stability needs its symmetric part positive definite",
    "T16": "ambiguities: which marker, which m, how 4 mm was measured",
    "T17": "what 4 mm means: a few mm of pose per pixel",
}
"""The traps of the project's critical reading of the paper, in a few words."""


def write(
    out: Path, chapters: Mapping[str, Chapter], experiments: Mapping[str, Experiment], quick: bool
) -> Path:
    """Write the report, the claims and the figures' data; give the report's path."""
    rows = claim_rows(chapters)
    write_whole(out / CLAIMS, json.dumps(rows, indent=1, ensure_ascii=False) + "\n")
    write_whole(out / FIGURES, json.dumps(figure_data(chapters), ensure_ascii=False) + "\n")
    template = Environment(
        loader=PackageLoader("rcmservo.experiments", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    ).get_template("report.html.j2")
    page = template.render(
        rows=rows,
        counts={
            verdict: sum(row["verdict"] == verdict for row in rows)
            for verdict in (HOLDS, REMARK, FAILS)
        },
        traps=_by_trap(rows),
        chapters=[
            _chapter(experiments[name], chapter, quick) for name, chapter in chapters.items()
        ],
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


def _by_trap(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The claims that meet a trap of the paper, by trap, and whether every one of them confirms
    it."""
    met = {name: [row for row in rows if row["trap"] == name] for name in TRAPS}
    return [
        {
            "name": name,
            "words": TRAPS[name],
            "rows": some,
            "confirmed": all(row["trap_confirmed"] for row in some),
        }
        for name, some in met.items()
        if some
    ]


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
    return {
        "name": shown.name,
        "where": shown.where,
        "caption": shown.caption,
        "seeds": list(shown.seeds),
        "images": images,
    }


def _embedded(kind: str, data: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
