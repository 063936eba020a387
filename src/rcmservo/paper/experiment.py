"""Experiment of the paper: the functions of its module, and its texts in the table of claims."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, cast

from rcmservo.paper.claims import ClaimRow, ExperimentTexts, claim_table, judge
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, Task


@dataclass(frozen=True)
class Experiment:
    """An experiment, from its settings to its claims and figures.

    Parameters
    ----------
    name : str
        Name in folders, links, the table of claims, and the option ``--only``.
    tasks : Callable[[Settings], Iterable[Task]]
        Function that returns the tasks for some settings.
    measure : Callable[[Settings, Results], Iterable[Measurement]]
        Function that returns the measurements of the claims, in the order of the report.
    draw : Callable[[Settings, Results], Iterable[PaperFigure]]
        Function that returns the figures, in the order of the report.
    constants : Mapping[str, object]
        Constants of the module that are not texts, by name; the report lists them.
    added_settings : Mapping[str, object]
        Settings that the caller adds to those of the table.
    """

    name: str
    tasks: Callable[[Settings], Iterable[Task]]
    measure: Callable[[Settings, Results], Iterable[Measurement]]
    draw: Callable[[Settings, Results], Iterable[PaperFigure]]
    constants: Mapping[str, object] = field(default_factory=dict[str, object])
    added_settings: Mapping[str, object] = field(default_factory=dict[str, object])

    @property
    def texts(self) -> ExperimentTexts:
        """Texts and settings of the experiment in the table of claims."""
        return claim_table().experiment[self.name]

    def settings(self, quick: bool) -> Settings:
        """Return the settings of a full or a reduced run."""
        reduced = self.texts.quick if quick else {}
        return Settings(**{**self.texts.whole, **reduced, **self.added_settings})

    def plan(self, quick: bool) -> list[Task]:
        """Return the tasks of a full or a reduced run."""
        return list(self.tasks(self.settings(quick)))

    def rows(self, quick: bool, results: Results) -> list[ClaimRow]:
        """Return the claims with their verdicts."""
        settings = self.settings(quick)
        measurements = enumerate(self.measure(settings, results))
        return [judge(self.name, number, one, settings) for number, one in measurements]


def experiment_named(name: str) -> Experiment:
    """Return an experiment of the table: `imaged-rcm` is in the module `imaged_rcm_claims`."""
    module = import_module(f"rcmservo.paper.{name.replace('-', '_')}_claims")
    named = vars(module).items()
    constants = {key: value for key, value in named if key.isupper() and not _is_text(value)}
    return Experiment(name, module.tasks, module.measure, module.draw, constants)


def _is_text(value: Any) -> bool:
    """Report whether a constant is a text, or a collection of texts, such as labels."""
    if isinstance(value, Mapping):
        return all(_is_text(item) for item in cast(Mapping[Any, Any], value).values())
    if isinstance(value, tuple | list):
        return all(_is_text(item) for item in cast(Sequence[Any], value))
    return isinstance(value, str)
