"""All experiments of the paper from one command: tasks on all cores, then the chapters, then the
report."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from rcmservo.config.files import write_whole
from rcmservo.errors import BadInput, UnusableFile
from rcmservo.experiments import (
    baselines,
    camera_knowledge,
    coordinates,
    differentiation,
    estimator_time,
    imaged_rcm,
    imaged_rcm_slow,
    jacobian_accuracy,
    lemma_1,
    path_following,
    potential,
    proposition_1,
    proposition_2,
    regulation_flow,
    regulation_projection,
    relocation,
    showing,
    stability,
    tool_model,
)
from rcmservo.experiments.harness import report
from rcmservo.experiments.harness.claims import Chapter, NotMeasured
from rcmservo.experiments.harness.lab.methods import Own
from rcmservo.experiments.harness.tasks import Experiment, Task
from rcmservo.experiments.harness.work import run_all

MODULES = (
    regulation_projection,
    regulation_flow,
    showing,
    potential,
    lemma_1,
    proposition_1,
    proposition_2,
    stability,
    imaged_rcm,
    imaged_rcm_slow,
    relocation,
    jacobian_accuracy,
    camera_knowledge,
    baselines,
    path_following,
    tool_model,
    coordinates,
    differentiation,
    estimator_time,
)
EXPERIMENTS: dict[str, Experiment[Any]] = {
    module.EXPERIMENT.name: module.EXPERIMENT for module in MODULES
}
"""All experiments by name, in the order of the report."""

MODE = "paper.json"


def chosen(only: str | None, own: Own | None = None) -> dict[str, Experiment[Any]]:
    """The experiments to run: all, or the one of that name; with a user's `own` estimator among the
    methods that they compare."""
    every = EXPERIMENTS if own is None else {**EXPERIMENTS, "baselines": baselines.beside(own)}
    if only is None:
        return dict(every)
    if only not in every:
        raise BadInput("--only", only, "one of " + ", ".join(every))
    return {only: every[only]}


def tasks_of(experiments: Mapping[str, Experiment[Any]], quick: bool) -> dict[str, list[Task]]:
    """The tasks of every experiment."""
    return {name: one.tasks(one.settings(quick)) for name, one in experiments.items()}


class Written(NamedTuple):
    """A report that was written."""

    page: Path
    """The HTML file."""
    left_out: Mapping[str, str]
    """Experiments that are not in it, each with what could not be measured."""


def run(
    out: Path,
    quick: bool,
    experiments: Mapping[str, Experiment[Any]],
    progress: Callable[[Task], None],
) -> Written:
    """Run what is not done yet, and write the report into `out`, which was prepared."""
    done = run_all(tasks_of(experiments, quick), out, progress)
    found, left_out = dict[str, Chapter](), dict(done.unmeasured)
    for name, results in done.results.items():
        one = experiments[name]
        try:
            found[name] = one.chapter(one.settings(quick), results)
        except NotMeasured as error:
            left_out[name] = str(error)
    return Written(report.write(out, found, experiments, quick, left_out), left_out)


def prepare(out: Path, quick: bool) -> None:
    """Make the folder, or see that it is one of an earlier run of the same kind."""
    mode = "quick" if quick else "whole"
    try:
        out.mkdir(parents=True, exist_ok=True)
        if (out / MODE).exists():
            before = json.loads((out / MODE).read_text())["mode"]
            if before != mode:
                raise UnusableFile(
                    out, f"holds a {before} run and this is a {mode} one: name another folder"
                )
        elif any(out.iterdir()):
            raise UnusableFile(
                out, "is not empty and holds no earlier run of the paper: name a new folder"
            )
        else:
            write_whole(out / MODE, json.dumps({"mode": mode}) + "\n")
    except OSError as error:
        raise UnusableFile(out, f"cannot be used: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise UnusableFile(out / MODE, "is damaged: name a new folder") from error
