"""Progress reporting: a bar with rate and remaining time, or plain lines if it cannot be drawn."""

import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from rcmservo.cli.terminal import can_rewrite_lines

MIN_ELAPSED_S = 1e-3
"""Smallest elapsed time (s) in the rate, which avoids a division by zero."""


@contextmanager
def show_progress(
    console: Console, task_name: str, total: float, done: float = 0.0, unit: str = ""
) -> Generator[Callable[[float], None]]:
    """Report the progress of a task.

    Parameters
    ----------
    console : Console
        Console that shows the bar.
    task_name : str
        Name of the task.
    total : float
        Amount of work.
    done : float
        Amount that was completed before this run.
    unit : str
        Unit of the amount; if given, the rate is shown as well.

    Yields
    ------
    Callable
        Function that receives each completed amount.
    """
    rate = [TextColumn("{task.fields[rate]}", markup=False)] if unit else []
    columns = BarColumn(), TaskProgressColumn(), *rate, TimeRemainingColumn()
    name = TextColumn(task_name, markup=False)
    with Progress(name, *columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=total, rate="")
        bar.update(task, completed=done)
        printed_tenths, start_s, completed = int(10.0 * done / total), time.monotonic(), 0.0

        def advance(amount: float) -> None:
            nonlocal printed_tenths, completed
            completed += amount
            speed = completed / max(time.monotonic() - start_s, MIN_ELAPSED_S)
            rate_text = f"{speed:.0f} {unit}/s" if unit else ""
            bar.update(task, advance=amount, rate=rate_text)
            tenths = int(10.0 * bar.tasks[0].completed / total)
            if tenths > printed_tenths and not can_rewrite_lines(console):
                text = f"{task_name}: {10 * tenths} % is done"
                if unit and tenths < 10:
                    remaining_s = (total - done - completed) / speed
                    text += f", {rate_text}, about {remaining_s:.0f} s left"
                console.print(text, soft_wrap=True)
            printed_tenths = tenths

        yield advance


@contextmanager
def print_resume_hint(folder: Path, console: Console) -> Generator[None]:
    """Print after Ctrl-C how to resume."""
    try:
        yield
    except KeyboardInterrupt:
        hint = f"the results so far are saved; the same command with --out {folder} resumes there"
        console.print(hint, soft_wrap=True)
        raise
