"""Run the studies that pages of the documentation cite, and write the pages from them.

    python docs/make_studies.py [NAME ...] [--render] [--workers N]

The pages are docs/how_to_choose.md, with the studies docs/studies/*.toml, and
docs/imperfect_arms.md, with docs/studies/imperfect_arms/*.toml. `rcmservo study` runs each study
into a folder under runs/studies; an interrupted study resumes. The numbers of a page are collected
in figures.json beside its studies, and it is written from them, unless they no longer support one
of its sentences. With names, only these studies and their pages are made; --render runs no study
and writes all pages from the present numbers.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
from choosing import COLUMNS, PAGES, StudyPage, round_numbers

ROOT = Path(__file__).parents[1]
RUNS = Path("runs/studies")
SUMMARY_KEYS = ["runs", "engine", "stops", *(column.key for column in COLUMNS.values())]
"""Numbers of a method under a condition that figures.json holds."""
COMPARISON_KEYS = "success", "time_s", "pose_mm"
"""Numbers of a paired comparison that figures.json holds."""


def main() -> None:
    """Run the studies, collect their numbers, and write the pages."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", help="names of studies; default: all")
    parser.add_argument("--render", action="store_true", help="only write the pages")
    parser.add_argument(
        "--workers", type=int, help="number of processes; default: one per processor"
    )
    options = parser.parse_args()
    for page in PAGES:
        names = [name for name in page.list_studies() if name in (options.names or [name])]
        if not (names or options.render):
            continue
        if not options.render:
            start = time.monotonic()
            for name in names:
                run(page, name, options.workers)
            write(page, collect_figures(page))
            print(f"studies of {page.name}: {time.monotonic() - start:.0f} s")
        page.path.write_text(page.render(), "utf-8")
        print(page.path.relative_to(ROOT))


def locate_study(page: StudyPage, name: str) -> Path:
    """Return the file of a study, from the root of the project."""
    return (page.studies / f"{name}.toml").relative_to(ROOT)


def locate_runs(page: StudyPage, name: str) -> Path:
    """Return the folder of a study's runs, from the root of the project."""
    return RUNS / locate_study(page, name).relative_to("docs/studies").with_suffix("")


def make_command(page: StudyPage, name: str) -> str:
    """Return the command that runs a study."""
    return f"rcmservo study {locate_study(page, name)} --out {locate_runs(page, name)}"


def run(page: StudyPage, name: str, workers: int | None) -> None:
    """Run a study, or its missing part."""
    print(make_command(page, name), flush=True)
    arguments = [sys.executable, "-m", *make_command(page, name).split()]
    arguments += ["--workers", str(workers)] if workers else []
    subprocess.run(arguments, cwd=ROOT, check=True)


def collect_figures(page: StudyPage) -> dict[str, Any]:
    """Return the numbers of the studies of a page with package, machine, versions and date."""
    folders = {name: ROOT / locate_runs(page, name) for name in page.list_studies()}
    summaries = {name: json.loads((f / "summary.json").read_text()) for name, f in folders.items()}
    packages = {summary["package"] for summary in summaries.values()}
    if len(packages) > 1:
        raise SystemExit(f"studies of more than one package: {', '.join(sorted(packages))}")
    first = pq.read_table(
        next(iter(folders.values())) / "runs.parquet", columns=["cpu", "versions"]
    )
    return {
        "package": packages.pop(),
        "machine": f"{os.cpu_count()} x {first['cpu'][0].as_py()}",
        "versions": first["versions"][0].as_py(),
        "date": f"{datetime.now(UTC):%Y-%m-%d}",
        "studies": {name: select_figures(page, name, one) for name, one in summaries.items()},
    }


def select_figures(page: StudyPage, name: str, summary: dict[str, Any]) -> dict[str, Any]:
    """Return the part of a study's summary that figures.json holds."""
    return {
        "question": read_question(ROOT / locate_study(page, name)),
        "command": make_command(page, name),
        "runs": summary["runs"],
        "rows": group_by_condition(summary["methods"], SUMMARY_KEYS),
        "beside": group_by_condition(summary["comparisons"], COMPARISON_KEYS),
    }


def read_question(study: Path) -> str:
    """Return the question of a study: the comment at the start of its file up to the first "?"."""
    lines = study.read_text("utf-8").splitlines()
    comment = " ".join(line.lstrip("# ") for line in lines if line.startswith("#"))
    if "?" not in comment:
        raise SystemExit(f"{study} has no question in its first comment")
    return comment.partition("?")[0] + "?"


def group_by_condition(rows: list[dict[str, Any]], keys: Any) -> dict[str, Any]:
    """Return the values of `keys` in the rows, by condition and method."""
    conditions: dict[str, Any] = {}
    for row in rows:
        selected = {key: flatten_interval(row[key]) for key in keys}
        conditions.setdefault(row["condition"], {})[row["method"]] = selected
    return conditions


def flatten_interval(value: Any) -> Any:
    """Return an interval as three numbers, and any other value unchanged."""
    return list(value.values()) if isinstance(value, dict) and "low" in value else value


def write(page: StudyPage, figures: dict[str, Any]) -> None:
    """Write figures.json with one interval per line, so that changes are readable."""
    text = json.dumps(round_numbers(figures), ensure_ascii=False, indent=1)
    text = re.sub(r"\[[^\[\]{}]*\]", lambda match: " ".join(match[0].split()), text)
    page.figures.write_text(text + "\n", "utf-8")


if __name__ == "__main__":
    main()
