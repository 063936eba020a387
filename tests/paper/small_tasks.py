"""Short tasks, which workers import without the experiments."""

from functools import partial
from pathlib import Path

from rcmservo.paper.plan import Task, TaskResult


def count(folder: Path, log: Path, name: str) -> TaskResult:
    """Task that logs each run."""
    with log.open("a") as file:
        file.write(name + "\n")
    (folder / "made.txt").write_text(name)
    return {"name": name}


def fail(folder: Path) -> TaskResult:
    (folder / "half.txt").write_text("half")
    raise ValueError("this task fails")


def not_measured() -> TaskResult:
    return {"number": float("nan")}


def settled(settings: object) -> TaskResult:
    return {"name": repr(settings)}


def counted(log: Path, *names: str) -> dict[str, list[Task]]:
    work = {name: partial(count, log=log, name=name) for name in names}
    return {"some": [Task(name, one, in_folder=True) for name, one in work.items()]}
