"""Tasks of a moment, which the workers import without the experiments."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rcmservo.experiments.harness.tasks import Task


@dataclass(frozen=True)
class Counted:
    name: str


@dataclass(frozen=True)
class Setting:
    number: float = 1.0


def count(folder: Path, log: Path, name: str) -> Counted:
    """A task that tells how often it ran."""
    with log.open("a") as file:
        file.write(name + "\n")
    (folder / "made.txt").write_text(name)
    return Counted(name)


def fail(folder: Path) -> Counted:
    (folder / "half.txt").write_text("half")
    raise ValueError("this task fails")


def not_measured(folder: Path) -> Setting:
    return Setting(float("nan"))


def settled(folder: Path, settings: Setting) -> Counted:
    return Counted(repr(settings))


def counted(log: Path, *names: str) -> dict[str, list[Task]]:
    return {"some": [Task(name, partial(count, log=log, name=name)) for name in names]}
