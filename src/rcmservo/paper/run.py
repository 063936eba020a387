"""Run of all experiments: tasks on all cores, then the claims, then the report.

Finished tasks are not repeated, so that a stopped run continues where it ended. The workers are
local processes. Workers of a study (`study/execution`) also run on a cluster, but they need dask
and return rows only, while a task here writes records and images into a folder.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from rcmservo.errors import BadInput
from rcmservo.paper import report
from rcmservo.paper.claims import ClaimRow, claim_table
from rcmservo.paper.experiment import Experiment, experiment_named
from rcmservo.paper.plan import NotMeasured, Results, Task
from rcmservo.paper.report import Chapter
from rcmservo.paper.store import Assignment, fingerprint

if TYPE_CHECKING:
    from rcmservo.paper.lab.methods import UserEstimatorMethod

Progress = Callable[[Task], None]
COMPARISON = "baselines"
"""Name of the experiment that compares methods."""


def select_experiments(
    only: str | None, user_method: "UserEstimatorMethod | None" = None
) -> dict[str, Experiment]:
    """Return the experiments to run: all of them, or the one named `only`.

    The comparison of methods includes `user_method`, a user-defined estimator, if there is one.

    Raises
    ------
    BadInput
        If `only` is not the name of an experiment.
    """
    names = list(claim_table().experiment)
    if only is not None and only not in names:
        raise BadInput("--only", only, "one of " + ", ".join(names))
    experiments = {name: experiment_named(name) for name in ([only] if only else names)}
    if user_method is not None and COMPARISON in experiments:
        comparison = replace(experiments[COMPARISON], added_settings={"own": user_method})
        experiments[COMPARISON] = comparison
    return experiments


class Written(NamedTuple):
    """A written report.

    Parameters
    ----------
    page : Path
        HTML file.
    rows : list[ClaimRow]
        Claims with verdicts, in the order of the report.
    left_out : Mapping[str, str]
        Experiments that are missing in the report, with the reason.
    """

    page: Path
    rows: list[ClaimRow]
    left_out: Mapping[str, str]


def run(
    out: Path, quick: bool, experiments: Mapping[str, Experiment], progress: Progress
) -> Written:
    """Run the unfinished tasks, and write the report into the prepared folder `out`."""
    plans = {name: experiment.plan(quick) for name, experiment in experiments.items()}
    results, left_out = run_all(plans, out, progress)
    chapters = list[Chapter]()
    for name, task_results in results.items():
        experiment = experiments[name]
        try:
            rows = experiment.rows(quick, task_results)
            figures = list(experiment.draw(experiment.settings(quick), task_results))
        except NotMeasured as error:
            left_out[name] = str(error)
        else:
            chapters.append(Chapter(experiment, rows, figures))
    page = report.write(out, chapters, quick, left_out)
    return Written(page, [row for chapter in chapters for row in chapter.rows], left_out)


def run_all(
    plans: Mapping[str, list[Task]], out: Path, progress: Progress
) -> tuple[dict[str, Results], dict[str, str]]:
    """Run the unfinished tasks of all experiments.

    A failed measurement excludes its experiment only. Tasks with the same work run once and share
    the result. Ctrl-C ends the workers; only the results of running tasks are lost.

    Parameters
    ----------
    plans
        Tasks by experiment.
    out
        Folder of the results.
    progress
        Function that is called with each finished task.

    Returns
    -------
    tuple[dict[str, Results], dict[str, str]]
        Results by experiment, and the reasons of failed experiments.
    """
    jobs = {
        experiment: [
            Assignment(task, out / experiment / task.name, fingerprint(task)) for task in tasks
        ]
        for experiment, tasks in plans.items()
    }
    unfinished: dict[str, list[Assignment]] = {}
    for job in chain(*jobs.values()):
        if job.is_finished:
            progress(job.task)
        else:
            unfinished.setdefault(job.fingerprint, []).append(job)
    by_cost = sorted(unfinished.values(), key=lambda equal_jobs: -equal_jobs[0].task.cost)
    failed = _run_in_processes(by_cost, progress)
    return {name: collect_results(jobs[name]) for name in plans if name not in failed}, failed


def collect_results(jobs: list[Assignment]) -> Results:
    """Return the results of finished tasks of one experiment."""
    folders = {job.task.name: job.folder for job in jobs}
    return Results({job.task.name: job.result for job in jobs}, folders)


def _run_in_processes(groups: list[list[Assignment]], progress: Progress) -> dict[str, str]:
    """Run groups of tasks with the same work; return the reasons of failed experiments."""
    failed: dict[str, str] = {}
    context = multiprocessing.get_context("spawn")
    cores = getattr(os, "process_cpu_count", os.cpu_count)() or 1
    workers = min(cores, len(groups) or 1)
    with ProcessPoolExecutor(workers, context, initializer=_become_worker) as pool:
        try:
            futures = {pool.submit(group[0].perform): group for group in groups}
            for future in as_completed(futures):
                performed, *others = group = futures[future]
                try:
                    future.result()
                    for job in others:
                        job.copy_from(performed)
                except NotMeasured as error:
                    for job in group:
                        failed.setdefault(job.folder.parent.name, str(error))
                for job in group:
                    progress(job.task)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.terminate()
            raise
    return failed


def _become_worker() -> None:
    """Ignore Ctrl-C, which the parent process handles, and end when the parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
