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
    """A piece of work: ``work(folder)`` fills the folder and gives what it found, a dataclass."""

    name: str
    work: "partial[Any]"
    cost: float = 1.0
    """About how many seconds it takes; the long ones begin first."""


@dataclass(frozen=True)
class Result:
    """What a task found, and the folder with its record and pictures."""

    found: object
    folder: Path


@dataclass(frozen=True)
class Results:
    """What all tasks of an experiment found, by their names."""

    made: Mapping[str, Result]

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
    """An experiment: its settings, whole and reduced, the tasks they make, and its chapter."""

    name: str
    title: str
    about: str
    whole: Settings
    quick: Settings
    tasks: Callable[[Settings], list[Task]]
    chapter: Callable[[Settings, Results], Chapter]

    def settings(self, quick: bool) -> Settings:
        """The settings of a whole or a reduced run."""
        return self.quick if quick else self.whole
