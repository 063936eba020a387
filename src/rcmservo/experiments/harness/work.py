"""Many tasks on all cores, each with a folder of its own; what is done stays done, and a stopped
run goes on there."""

import hashlib
import json
import multiprocessing
import os
import re
import shutil
import signal
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import NamedTuple, get_type_hints

import rcmservo
from rcmservo.experiments.harness.claims import NotMeasured
from rcmservo.experiments.harness.plain import built, plain
from rcmservo.experiments.harness.tasks import Result, Results, Task

RESULT = "result.json"
PART = ".part"
OWN = "experiments"
"""Their folder: a result depends on those of its files alone that its own module uses."""
UNRELATED = ("app", "live", "offline")
"""Folders of the package that no result depends on."""


class Assignment(NamedTuple):
    """A task, and where its result goes."""

    task: Task
    """What is to be done."""
    folder: Path
    """Of its result, which is there whole or not at all."""
    mark: str
    """The fingerprint of all that its result depends on."""


class Findings(NamedTuple):
    """What came of the tasks, by experiment."""

    results: dict[str, Results]
    """Of those whose tasks have all been measured."""
    unmeasured: dict[str, str]
    """Of the others, in one sentence what could not be measured."""


def run_all(
    tasks: Mapping[str, list[Task]], out: Path, progress: Callable[[Task], None]
) -> Findings:
    """Run the tasks of every experiment; what is done is not repeated.

    A measurement that fails costs its own experiment, not the others. A task works in a
    folder whose name ends in .part and gets its own name when it is complete. At Ctrl-C the workers
    are ended and what they were at is lost, nothing else.
    """
    jobs = {
        experiment: [
            Assignment(task, out / experiment / task.name, fingerprint(task)) for task in some
        ]
        for experiment, some in tasks.items()
    }
    todo: list[Assignment] = []
    for job in (job for some in jobs.values() for job in some):
        if _finished(job):
            progress(job.task)
        else:
            todo.append(job)
    failed = _run(sorted(todo, key=lambda job: -job.task.cost), progress)
    results = {
        experiment: Results({job.task.name: Result(result_of(job), job.folder) for job in some})
        for experiment, some in jobs.items()
        if experiment not in failed
    }
    return Findings(results, failed)


def _run(todo: list[Assignment], progress: Callable[[Task], None]) -> dict[str, str]:
    """Run what is to be done; by experiment, what could not be measured."""
    failed: dict[str, str] = {}
    context = multiprocessing.get_context("spawn")
    workers = min(_cores(), max(len(todo), 1))
    with ProcessPoolExecutor(workers, context, initializer=_become_worker) as pool:
        try:
            futures = {pool.submit(perform, job): job for job in todo}
            for future in as_completed(futures):
                job = futures[future]
                try:
                    future.result()
                except NotMeasured as error:
                    failed.setdefault(job.folder.parent.name, str(error))
                progress(job.task)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.terminate()
            raise
    return failed


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _become_worker() -> None:
    """Leave Ctrl-C, which reaches every process of the terminal, to the first one, and end when
    that one has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_the_first, daemon=True).start()


def _end_with_the_first() -> None:
    first = multiprocessing.parent_process()
    if first is not None:
        first.join()
        os._exit(1)


def perform(job: Assignment) -> None:
    """Run one task into its folder, which is there whole or not at all."""
    part = job.folder.with_name(job.folder.name + PART)
    for old in (part, job.folder):
        shutil.rmtree(old, ignore_errors=True)
    part.mkdir(parents=True)
    found = plain(job.task.work(part), job.task.name)
    text = json.dumps({"fingerprint": job.mark, "values": found}, allow_nan=False)
    (part / RESULT).write_text(text)
    part.rename(job.folder)


def _finished(job: Assignment) -> bool:
    try:
        return json.loads((job.folder / RESULT).read_text())["fingerprint"] == job.mark
    except (OSError, ValueError, KeyError, TypeError):
        return False


def result_of(job: Assignment) -> object:
    """What a finished task found, as the type that its function gives."""
    values = json.loads((job.folder / RESULT).read_text())["values"]
    return built(get_type_hints(job.task.work.func)["return"], values)


def fingerprint(task: Task) -> str:
    """What a result depends on: the task's arguments, the package, and of the experiments those
    files that its own uses."""
    root, work = Path(rcmservo.__file__).parent, task.work
    text = hashlib.sha256(repr((work.func.__qualname__, sorted(work.keywords.items()))).encode())
    package = [
        path
        for path in root.rglob("*.py")
        if path.relative_to(root).parts[0] not in (OWN, *UNRELATED)
    ]
    own = root / work.func.__module__.partition(".")[2].replace(".", "/")
    for path in sorted([*package, *used(root, own.with_suffix(".py"))]):
        text.update(path.read_bytes())
    return text.hexdigest()


def used(root: Path, module: Path) -> set[Path]:
    """The files of the experiments that a module of theirs consists of: its own, and those that it
    imports."""
    found: set[Path] = set()
    todo = {module}
    while todo:
        path = todo.pop()
        if path.exists():
            found.add(path)
            names = re.findall(rf"^from rcmservo\.({OWN}[\w.]*) import", path.read_text(), re.M)
            todo |= {root / (name.replace(".", "/") + ".py") for name in names} - found
    return found
