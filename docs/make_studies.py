"""Run the studies that docs/how_to_choose.md stands on, and write the page from them.

    python docs/make_studies.py [NAME ...] [--render] [--workers N]

Every docs/studies/NAME.toml is run by `rcmservo study` into runs/studies/NAME, and goes on where it
stopped. Their numbers are gathered in docs/studies/figures.json, and the page is written with them;
it is not where they no longer bear one of its sentences. With names, those studies alone are run
anew; --render runs none, and writes the page from the figures as they are.
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
from choosing import COLUMNS, FIGURES, PAGE, STUDIES, load, render, rounded

ROOT = Path(__file__).parents[1]
RUNS = Path("runs/studies")
KEPT = ["runs", "engine", "stops", *(column.key for column in COLUMNS.values())]
"""Of the numbers of a method under a condition."""
COMPARED = "success", "time_s", "pose_mm"


def main() -> None:
    """Run, gather, render."""
    asked = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    asked.add_argument("names", nargs="*", help="studies; all of them by default")
    asked.add_argument("--render", action="store_true", help="only write the page")
    asked.add_argument("--workers", type=int, help="processes; one for each processor")
    options = asked.parse_args()
    if not options.render:
        began = time.monotonic()
        for name in options.names or names():
            run(name, options.workers)
        write(gathered())
        print(f"all studies: {time.monotonic() - began:.0f} s")
    PAGE.write_text(render(load()), "utf-8")
    print(PAGE.relative_to(ROOT))


def names() -> list[str]:
    """Of all studies."""
    return sorted(path.stem for path in STUDIES.glob("*.toml"))


def command(name: str) -> str:
    """What makes a study."""
    return f"rcmservo study docs/studies/{name}.toml --out {RUNS / name}"


def run(name: str, workers: int | None) -> None:
    """Make a study, or what is left of it."""
    print(command(name), flush=True)
    words = [sys.executable, "-m", *command(name).split()]
    words += ["--workers", str(workers)] if workers else []
    subprocess.run(words, cwd=ROOT, check=True)


def gathered() -> dict[str, Any]:
    """The figures of all studies, and what they were made with."""
    folders = {name: ROOT / RUNS / name for name in names()}
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
        "studies": {name: told(name, summary) for name, summary in summaries.items()},
    }


def told(name: str, summary: dict[str, Any]) -> dict[str, Any]:
    """What is kept of a study's summary."""
    return {
        "question": question(name),
        "command": command(name),
        "runs": summary["runs"],
        "rows": by_condition(summary["methods"], KEPT),
        "beside": by_condition(summary["comparisons"], COMPARED),
    }


def question(name: str) -> str:
    """What a study asks: the sentences at the head of its file up to the question mark."""
    lines = (STUDIES / f"{name}.toml").read_text("utf-8").splitlines()
    words = " ".join(line.lstrip("# ") for line in lines if line.startswith("#"))
    return words.partition("?")[0] + "?"


def by_condition(rows: list[dict[str, Any]], keys: Any) -> dict[str, Any]:
    """Rows by condition and method, with some of their numbers."""
    found: dict[str, Any] = {}
    for row in rows:
        kept = {key: ends(row[key]) for key in keys}
        found.setdefault(row["condition"], {})[row["method"]] = kept
    return found


def ends(value: Any) -> Any:
    """An interval as three numbers."""
    return list(value.values()) if isinstance(value, dict) and "low" in value else value


def write(figures: dict[str, Any]) -> None:
    """Keep the figures: an interval a line, so that changes can be read."""
    text = json.dumps(rounded(figures), ensure_ascii=False, indent=1)
    text = re.sub(r"\[[^\[\]{}]*\]", lambda one: " ".join(one[0].split()), text)
    FIGURES.write_text(text + "\n", "utf-8")


if __name__ == "__main__":
    main()
