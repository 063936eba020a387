"""Pieces of work that need no other, what they found, and the experiment that asks for them."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

from rcmservo.experiments.harness.claims import Chapter

Kind = TypeVar("Kind")
Settings = TypeVar("Settings")


@dataclass(frozen=True)
class Task:
    """A piece of work that needs no other."""

    name: str
    """Of its folder too; no other task of the experiment has it."""
    work: "partial[Any]"
    """Called with its folder, it fills that and gives what it found, a dataclass."""
    cost: float = 1.0
    """About how many seconds it takes; the long ones begin first."""


@dataclass(frozen=True)
class Result:
    """What a task left behind."""

    found: object
    """The dataclass that the task's work gave, read back from the folder."""
    folder: Path
    """It holds the task's record and pictures, where it made any."""


@dataclass(frozen=True)
class Results:
    """What all tasks of an experiment found."""

    made: Mapping[str, Result]
    """By the tasks' names."""

    def of(self, kind: type[Kind], task: str) -> Kind:
        """What one task found, which is of this kind."""
        found = self.made[task].found
        if not isinstance(found, kind):
            raise TypeError(f"{task} found a {type(found).__name__}, not a {kind.__name__}")
        return found

    def all(self, kind: type[Kind], prefix: str, numbers: Iterable[int]) -> list[Kind]:
        """What the tasks `prefix`-0, `prefix`-1, ... found."""
        return [self.of(kind, f"{prefix}-{number}") for number in numbers]

    def folder(self, task: str) -> Path:
        """The folder of one task."""
        return self.made[task].folder


@dataclass(frozen=True)
class Experiment(Generic[Settings]):
    """An experiment, from its settings to its chapter."""

    name: str
    """In folders, in links and after ``--only``."""
    title: str
    """The heading of its chapter."""
    about: str
    """What is tried, in sentences below the heading."""
    whole: Settings
    """The settings of a whole run."""
    quick: Settings
    """The settings of a reduced run."""
    tasks: Callable[[Settings], list[Task]]
    """The work that such settings ask for."""
    chapter: Callable[[Settings, Results], Chapter]
    """Claims and figures, from the settings and what the tasks found."""

    def settings(self, quick: bool) -> Settings:
        """The settings of a whole or a reduced run."""
        return self.quick if quick else self.whole
