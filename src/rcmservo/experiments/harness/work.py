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
from typing import Any

import rcmservo
from rcmservo.experiments.harness.claims import Result, Task

RESULT = "result.json"
PART = ".part"
OWN = "experiments"
"""Their folder: a result depends on those of its files alone that its own module uses."""
UNRELATED = ("cli", "charts")
"""Files of the package that no result depends on."""


def run_all(
    tasks: Mapping[str, list[Task]], out: Path, progress: Callable[[Task], None]
) -> dict[str, dict[str, Result]]:
    """Run the tasks of every experiment and give their results by experiment and task; what is done
    is not repeated.

    A task works in a folder whose name ends in .part and gets its own name when it is complete. At
    Ctrl-C the workers are ended and what they were at is lost, nothing else.
    """
    todo: list[tuple[Task, Path, str]] = []
    for experiment, some in tasks.items():
        for task in some:
            folder, mark = out / experiment / task.name, fingerprint(task)
            if _finished(folder, mark):
                progress(task)
            else:
                todo.append((task, folder, mark))
    todo.sort(key=lambda one: -one[0].cost)
    _run(todo, progress)
    return {
        experiment: {
            task.name: Result(
                _read(out / experiment / task.name)["values"], out / experiment / task.name
            )
            for task in some
        }
        for experiment, some in tasks.items()
    }


def _run(todo: list[tuple[Task, Path, str]], progress: Callable[[Task], None]) -> None:
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(
        min(cores, max(len(todo), 1)), context, initializer=_become_worker
    ) as pool:
        try:
            futures = {pool.submit(perform, *one): one[0] for one in todo}
            for future in as_completed(futures):
                future.result()
                progress(futures[future])
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.terminate()
            raise


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


def perform(task: Task, folder: Path, mark: str) -> None:
    """Run one task into its folder, which is there whole or not at all."""
    part = folder.with_name(folder.name + PART)
    for old in (part, folder):
        shutil.rmtree(old, ignore_errors=True)
    part.mkdir(parents=True)
    values = task.function(part, **task.arguments)
    (part / RESULT).write_text(json.dumps({"fingerprint": mark, "values": values}))
    part.rename(folder)


def _finished(folder: Path, mark: str) -> bool:
    try:
        return _read(folder)["fingerprint"] == mark
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _read(folder: Path) -> dict[str, Any]:
    return json.loads((folder / RESULT).read_text())


def fingerprint(task: Task) -> str:
    """What a result depends on: the task's arguments, the package, and of the experiments those
    that its own uses."""
    root = Path(rcmservo.__file__).parent
    text = hashlib.sha256(
        repr((task.function.__qualname__, sorted(task.arguments.items()))).encode()
    )
    package = [
        path
        for path in root.rglob("*.py")
        if OWN not in path.relative_to(root).parts[:1] and path.stem not in UNRELATED
    ]
    own = root / task.function.__module__.partition(".")[2].replace(".", "/")
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
