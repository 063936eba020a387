"""Progress reporting: a bar with rate and remaining time, or plain lines if it cannot be drawn."""

import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from rcmservo.cli.terminal import can_rewrite_lines


@contextmanager
def show_progress(
    out: Console, words: str, total: float, done: float = 0.0, unit: str = ""
) -> Generator[Callable[[float], None]]:
    """Report the progress of a task.

    Parameters
    ----------
    out : Console
        Console that shows the bar.
    words : str
        Name of the task.
    total : float
        Amount of work.
    done : float
        Amount that was completed before.
    unit : str
        Unit of the amount; if given, the rate is shown as well.

    Yields
    ------
    Callable
        Function that receives each completed amount.
    """
    rate = [TextColumn("{task.fields[rate]}", markup=False)] if unit else []
    columns = BarColumn(), TaskProgressColumn(), *rate, TimeRemainingColumn()
    with Progress(TextColumn(words, markup=False), *columns, console=out, transient=True) as bar:
        task = bar.add_task("", total=total, rate="")
        bar.update(task, completed=done)
        tenths, start, completed = int(10.0 * done / total), time.monotonic(), 0.0

        def advance(amount: float) -> None:
            nonlocal tenths, completed
            completed += amount
            speed = completed / max(time.monotonic() - start, 1e-3)
            rate_text = f"{speed:.0f} {unit}/s" if unit else ""
            bar.update(task, advance=amount, rate=rate_text)
            now = int(10.0 * bar.tasks[0].completed / total)
            if now > tenths and not can_rewrite_lines(out):
                left = (total - done - completed) / speed
                remaining = f", {rate_text}, about {left:.0f} s left" if unit and now < 10 else ""
                out.print(f"{words}: {10 * now} % is done{remaining}", soft_wrap=True)
            tenths = now

        yield advance


@contextmanager
def print_resume_hint(folder: Path, out: Console) -> Generator[None]:
    """Print after Ctrl-C how to resume."""
    try:
        yield
    except KeyboardInterrupt:
        words = f"the results so far are saved; the same command with --out {folder} resumes there"
        out.print(words, soft_wrap=True)
        raise
