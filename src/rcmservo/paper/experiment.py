"""Experiment of the paper: the functions of its module, and its texts in the table of claims."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib import import_module

from rcmservo.paper.claims import ClaimRow, ExperimentTexts, claim_table, judge
from rcmservo.paper.plan import Measurement, ReportFigure, Results, Settings, Task


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
    draw : Callable[[Settings, Results], Iterable[ReportFigure]]
        Function that returns the figures, in the order of the report.
    fixed : Mapping[str, object]
        Settings that are the same in each run and not plain numbers, for the report.
    added : Mapping[str, object]
        Settings that the caller adds to those of the table.
    """

    name: str
    tasks: Callable[[Settings], Iterable[Task]]
    measure: Callable[[Settings, Results], Iterable[Measurement]]
    draw: Callable[[Settings, Results], Iterable[ReportFigure]]
    fixed: Mapping[str, object] = field(default_factory=dict[str, object])
    added: Mapping[str, object] = field(default_factory=dict[str, object])

    @property
    def texts(self) -> ExperimentTexts:
        """Texts and settings of the experiment in the table of claims."""
        return claim_table().experiment[self.name]

    def settings(self, quick: bool) -> Settings:
        """Return the settings of a full or a reduced run."""
        return Settings(**vars(self.texts.settings(quick)), **self.added)

    def plan(self, quick: bool) -> list[Task]:
        """Return the tasks of a full or a reduced run."""
        return list(self.tasks(self.settings(quick)))

    def rows(self, quick: bool, results: Results) -> list[ClaimRow]:
        """Return the claims with their verdicts."""
        settings = self.settings(quick)
        found = self.measure(settings, results)
        return [judge(self.name, i, one, settings) for i, one in enumerate(found)]


def experiment_named(name: str) -> Experiment:
    """Return an experiment of the table, from the module of the same name."""
    module = import_module(f"rcmservo.paper.{name.replace('-', '_')}")
    fixed: Mapping[str, object] = getattr(module, "fixed_settings", dict[str, object])()
    return Experiment(name, module.tasks, module.measure, module.draw, fixed)
