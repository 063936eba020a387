"""Result of a comparison of methods: the rows of all runs, their statistics, and every run again.

Runs are reproducible, so that only rows are stored: a run that is opened runs again.
"""

import html
import io
import tempfile
from dataclasses import asdict, astuple, dataclass, fields
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from rcmservo.errors import BadInput, require_extra, suggest_name
from rcmservo.figures import charts
from rcmservo.figures.charts import Bar, Figure, Panel, make_curve
from rcmservo.study.compiled_engine import CompiledEngine
from rcmservo.study.execution.chunk import run_engine
from rcmservo.study.execution.store import make_table
from rcmservo.study.report.report import make_figure
from rcmservo.study.report.summary import (
    Group,
    PairedComparison,
    Summary,
    compare_with_first,
    summarise,
)
from rcmservo.study.report.text import build_result_table, describe_comparison
from rcmservo.study.row import SUCCESS_MM, StudyRow, format_success, list_row_texts, make_row
from rcmservo.study.run_outcome import STOPPED_PHASES, StudyRun
from rcmservo.study.simulation_engine import SimulationEngine

if TYPE_CHECKING:
    from rcmservo.figures.charts import Canvas

TEXT_COLUMNS = 100
"""Width of a printed comparison in columns."""

NUMBERS_NOTE = (
    "medians of time and error, root mean square of error / bound, with 95 % confidence intervals"
)
"""Meaning of the numbers of a printed comparison."""

STOPPED_TONE = 5
"""Colour of the spans in which the tool is stopped: an index in the tones of charts."""


@dataclass(frozen=True)
class ComparedMethod:
    """Method of a comparison: everything that its runs depend on except the seed.

    Parameters
    ----------
    method : str
        Name of the method.
    simulation : CompiledEngine or SimulationEngine
        Servo, simulated laboratory and engine.
    engine : str
        Name of the engine.
    source : str
        SHA-256 of the user's module; empty for a built-in estimator.
    scenes : str
        Name of the distribution that scenes are drawn from.
    disturb : tuple[str, ...]
        Disturbances of every run: none.
    repetition : int
        Number of the noise sequence in each scene.
    """

    method: str
    simulation: CompiledEngine | SimulationEngine
    engine: str
    source: str
    scenes: str
    disturb: tuple[str, ...] = ()
    repetition: int = 0

    def run(self, seed: int) -> StudyRun:
        """Run one closed loop in the scene of a seed."""
        return run_engine(self.simulation, self, seed)

    def make_row(self, seed: int) -> StudyRow:
        """Run the scene of a seed and return its row."""
        return make_row(self, self.simulation.settings, self.run(seed))


@dataclass(frozen=True)
class ComparedRun:
    """Run of a comparison, which runs again when its course is needed.

    Parameters
    ----------
    row : StudyRow
        Numbers of the run.
    method : ComparedMethod
        Method that made it.
    """

    row: StudyRow
    method: ComparedMethod

    @property
    def seed(self) -> int:
        """Seed of the scene: that of ``rs.sim.Rig(seed)``."""
        return self.row.seed

    @property
    def error(self) -> float:
        """True pose error of marker 2, root mean square over the last second, mm."""
        return self.row.pose_error_mm

    @property
    def cause(self) -> str:
        """Reason why the run did not succeed, in one sentence; empty if it did."""
        return self.row.result.cause

    @cached_property
    def outcome(self) -> StudyRun:
        """True error (mm), phase and cause at every tick, from a second run of the same seed."""
        return self.method.run(self.seed)

    def plot(self) -> "Canvas":
        """Return a Matplotlib figure of the true error over time; stops are shaded."""
        return charts.draw_figure(self._figure)

    def show(self) -> Path:
        """Print the run, and draw its true error over time into a file.

        Returns
        -------
        Path
            PNG file in a new temporary folder; its path is printed too.
        """
        path = Path(tempfile.mkdtemp(prefix="rcmservo-")) / f"seed-{self.seed}.png"
        charts.save_figure(self._figure, path)
        print(f"{self}\nerror over time: {path}")
        return path

    @property
    def _figure(self) -> Figure:
        run = self.outcome
        time = np.arange(len(run.error)) / run.rate
        curves = [make_curve(self.row.method, time, run.error)]
        levels = [(f"success: {SUCCESS_MM:g} mm", SUCCESS_MM)]
        is_stopped = np.isin(run.phases, STOPPED_PHASES).astype(np.int8)
        edges = np.flatnonzero(np.diff(is_stopped, prepend=0, append=0)).reshape(-1, 2) / run.rate
        bands = [Bar(float(start), float(end), STOPPED_TONE) for start, end in edges]
        y = "true error of marker 2, mm"
        panel = Panel("time, s", y, curves, levels=levels, bands=bands, log_y=True)
        return Figure(self._title, [panel])

    @property
    def _title(self) -> str:
        return f"{self.row.method}, seed {self.seed}, {self.row.engine}"

    def __str__(self) -> str:
        texts = list_row_texts(self.row)
        width = max(len(title) for title, _ in texts)
        lines = (f"  {title:{width}}  {text}" for title, text in texts)
        return "\n".join([f"{self._title}: {format_success(self.row)}", *lines])

    def _repr_html_(self) -> str:
        return _format_html(str(self), self._figure)


@dataclass(frozen=True, eq=False)
class MethodComparison:
    """Methods compared in the same simulated scenes with the same noise: the result of `compare`.

    ``print`` shows a table, each number with its 95 % confidence interval, and the differences of
    every method from the first one. A notebook shows the curves too.

    Parameters
    ----------
    methods : tuple of ComparedMethod
        Methods; the others are compared with the first.
    rows : tuple of StudyRow
        Numbers of every run, method by method, in the order of the seeds.
    requested : int
        Number of scenes requested; fewer have rows if Ctrl-C ended the comparison early.
    """

    methods: tuple[ComparedMethod, ...]
    rows: tuple[StudyRow, ...]
    requested: int

    @property
    def seeds(self) -> list[int]:
        """Seeds of the scenes that all methods have run in."""
        return [row.seed for row in self.rows[: self._count]]

    @property
    def engine(self) -> str:
        """Engine of all runs: ``compiled`` (compiled plant) or ``mujoco`` (full simulator)."""
        return self.methods[0].engine

    @cached_property
    def summaries(self) -> list[Summary]:
        """Numbers of every method, with 95 % confidence intervals."""
        return [summarise(group) for group in self._groups]

    @cached_property
    def differences(self) -> list[PairedComparison]:
        """Differences of every further method from the first one, over pairs of runs."""
        return list(compare_with_first(self._groups))

    def to_pandas(self) -> Any:
        """Return the rows as a pandas ``DataFrame``; `StudyRow` describes its columns.

        Raises
        ------
        NotInstalled
            If pandas is not installed; the class is in `rcmservo.errors`.
        """
        with require_extra("to_pandas", "pandas"):
            pandas = import_module("pandas")
        return pandas.DataFrame([asdict(row) for row in self.rows], columns=_list_columns())

    def plot(self) -> "Canvas":
        """Return a Matplotlib figure: distributions of time to 1 mm and pose error, by method.

        ``study.plot().savefig("study.png")`` saves it.
        """
        return charts.draw_figure(self._figure)

    def run(self, name: str, seed: int) -> ComparedRun:
        """Return the run of a method in the scene of a seed.

        Raises
        ------
        BadInput
            If the comparison has no such method or seed.
        """
        if seed not in self.seeds:
            raise BadInput("seed", seed, f"one of the {self._count} seeds of the comparison")
        method, rows = self._find(name)
        return ComparedRun(rows[self.seeds.index(seed)], method)

    def worst(self, name: str) -> ComparedRun:
        """Return the run of a method with the largest pose error.

        Raises
        ------
        BadInput
            If the comparison has no such method.
        """
        method, rows = self._find(name)
        errors = np.nan_to_num([row.pose_error_mm for row in rows], nan=np.inf)
        return ComparedRun(rows[int(np.argmax(errors))], method)

    @property
    def _count(self) -> int:
        """Number of scenes that all methods have run in."""
        return len(self.rows) // len(self.methods)

    @cached_property
    def _groups(self) -> list[Group]:
        table, n = make_table([astuple(row) for row in self.rows]), self._count
        firsts = range(0, len(self.rows), n)
        return [
            Group(method.method, method.scenes, [first], table.slice(first, n))
            for method, first in zip(self.methods, firsts, strict=True)
        ]

    def _find(self, name: str) -> tuple[ComparedMethod, tuple[StudyRow, ...]]:
        """Return a method and its rows by name."""
        names = [method.method for method in self.methods]
        if name not in names:
            hint = suggest_name(name, names)
            raise BadInput("name", name, f"one of {', '.join(names)}{hint}")
        i = names.index(name)
        return self.methods[i], self.rows[i * self._count : (i + 1) * self._count]

    @property
    def _figure(self) -> Figure:
        return make_figure(self._groups, self.methods[0].simulation.duration)

    def __str__(self) -> str:
        duration_s = self.methods[0].simulation.duration
        scenes = "1 scene" if self._count == 1 else f"{self._count} scenes"
        title = f"{scenes}, {duration_s:g} s each, all methods on the {self.engine} engine"
        if self._count < self.requested:
            title += (
                f"; Ctrl-C ended the comparison before the other {self.requested - self._count}"
            )
        text = io.StringIO()
        console = Console(file=text, width=TEXT_COLUMNS, markup=False, highlight=False, emoji=False)
        console.print(build_result_table(self.summaries))
        sentences = map(describe_comparison, self.differences)
        return "\n".join([title, NUMBERS_NOTE, text.getvalue().rstrip("\n"), *sentences])

    def _repr_html_(self) -> str:
        return _format_html(str(self), self._figure)


def _list_columns() -> list[str]:
    return [f.name for f in fields(StudyRow)]


def _format_html(text: str, figure: Figure) -> str:
    """Return a text and a figure as HTML, for a notebook."""
    return f"<pre>{html.escape(text)}</pre>{charts.render_svg(figure)}"
