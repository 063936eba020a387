"""Run the studies that docs/how_to_choose.md cites, and write the page from them.

    python docs/make_studies.py [NAME ...] [--render] [--workers N]

Each docs/studies/NAME.toml is run by `rcmservo study` into runs/studies/NAME; an interrupted study
resumes. Their numbers are collected in docs/studies/figures.json, and the page is written from
them, unless they no longer support one of its sentences. With names, only these studies are run;
--render runs none and writes the page from the present numbers.
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
from choosing import COLUMNS, FIGURES, PAGE, STUDIES, load, render, round_numbers

ROOT = Path(__file__).parents[1]
RUNS = Path("runs/studies")
SUMMARY_KEYS = ["runs", "engine", "stops", *(column.key for column in COLUMNS.values())]
"""Numbers of a method under a condition that figures.json holds."""
COMPARISON_KEYS = "success", "time_s", "pose_mm"
"""Numbers of a paired comparison that figures.json holds."""


def main() -> None:
    """Run the studies, collect their numbers, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", help="names of studies; default: all")
    parser.add_argument("--render", action="store_true", help="only write the page")
    parser.add_argument(
        "--workers", type=int, help="number of processes; default: one per processor"
    )
    options = parser.parse_args()
    if not options.render:
        start = time.monotonic()
        for name in options.names or list_studies():
            run(name, options.workers)
        write(collect_figures())
        print(f"all studies: {time.monotonic() - start:.0f} s")
    PAGE.write_text(render(load()), "utf-8")
    print(PAGE.relative_to(ROOT))


def list_studies() -> list[str]:
    """Return the names of all studies."""
    return sorted(path.stem for path in STUDIES.glob("*.toml"))


def make_command(name: str) -> str:
    """Return the command that runs a study."""
    return f"rcmservo study docs/studies/{name}.toml --out {RUNS / name}"


def run(name: str, workers: int | None) -> None:
    """Run a study, or its missing part."""
    print(make_command(name), flush=True)
    arguments = [sys.executable, "-m", *make_command(name).split()]
    arguments += ["--workers", str(workers)] if workers else []
    subprocess.run(arguments, cwd=ROOT, check=True)


def collect_figures() -> dict[str, Any]:
    """Return the numbers of all studies with package, machine, versions and date."""
    folders = {name: ROOT / RUNS / name for name in list_studies()}
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
        "studies": {name: select_figures(name, summary) for name, summary in summaries.items()},
    }


def select_figures(name: str, summary: dict[str, Any]) -> dict[str, Any]:
    """Return the part of a study's summary that figures.json holds."""
    return {
        "question": read_question(name),
        "command": make_command(name),
        "runs": summary["runs"],
        "rows": group_by_condition(summary["methods"], SUMMARY_KEYS),
        "beside": group_by_condition(summary["comparisons"], COMPARISON_KEYS),
    }


def read_question(name: str) -> str:
    """Return the question of a study: the comment at the start of its file up to the first "?"."""
    lines = (STUDIES / f"{name}.toml").read_text("utf-8").splitlines()
    comment = " ".join(line.lstrip("# ") for line in lines if line.startswith("#"))
    if "?" not in comment:
        raise SystemExit(f"docs/studies/{name}.toml has no question in its first comment")
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


def write(figures: dict[str, Any]) -> None:
    """Write figures.json with one interval per line, so that changes are readable."""
    text = json.dumps(round_numbers(figures), ensure_ascii=False, indent=1)
    text = re.sub(r"\[[^\[\]{}]*\]", lambda match: " ".join(match[0].split()), text)
    FIGURES.write_text(text + "\n", "utf-8")


if __name__ == "__main__":
    main()
