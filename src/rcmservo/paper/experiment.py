"""An experiment: the functions of its module, with its row of the table of claims."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib import import_module

from rcmservo.paper.claims import ClaimRow, ExperimentTexts, claim_table, judge
from rcmservo.paper.plan import Drawn, Measurement, Results, Settings, Task


@dataclass(frozen=True)
class Experiment:
    """An experiment, from its settings to its claims and figures.

    Parameters
    ----------
    name : str
        Name in folders, links and the table of claims, and after ``--only``.
    tasks : Callable[[Settings], Iterable[Task]]
        Work that the settings ask for.
    measure : Callable[[Settings, Results], Iterable[Measurement]]
        Measurements of the claims, in the order of the report.
    draw : Callable[[Settings, Results], Iterable[Drawn]]
        Figures, in the order of the report.
    fixed : Mapping[str, object]
        Settings that are no plain numbers and the same in every run, for the report.
    added : Mapping[str, object]
        Settings that the caller adds to those of the table.
    """

    name: str
    tasks: Callable[[Settings], Iterable[Task]]
    measure: Callable[[Settings, Results], Iterable[Measurement]]
    draw: Callable[[Settings, Results], Iterable[Drawn]]
    fixed: Mapping[str, object] = field(default_factory=dict[str, object])
    added: Mapping[str, object] = field(default_factory=dict[str, object])

    @property
    def texts(self) -> ExperimentTexts:
        """Row of the table of claims."""
        return claim_table().experiment[self.name]

    def settings(self, quick: bool) -> Settings:
        """Return the settings of a whole or a reduced run."""
        return Settings(**vars(self.texts.settings(quick)), **self.added)

    def plan(self, quick: bool) -> list[Task]:
        """Return the tasks of a whole or a reduced run."""
        return list(self.tasks(self.settings(quick)))

    def rows(self, quick: bool, results: Results) -> list[ClaimRow]:
        """Return the judged claims."""
        settings = self.settings(quick)
        found = self.measure(settings, results)
        return [judge(self.name, i, one, settings) for i, one in enumerate(found)]


def experiment_named(name: str) -> Experiment:
    """Return an experiment of the table; its module is named like it."""
    module = import_module(f"rcmservo.paper.{name.replace('-', '_')}")
    return Experiment(name, module.tasks, module.measure, module.draw, getattr(module, "FIXED", {}))
