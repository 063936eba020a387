"""How far a long work is: a bar with its rate and the time left, or lasting lines where no bar can
be seen.
"""

import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from rcmservo.cli.terminal import can_rewrite_lines


@contextmanager
def progress(
    out: Console, words: str, total: float, done: float = 0.0, unit: str = ""
) -> Generator[Callable[[float], None]]:
    """Tell how far the work is; gives what is to be called with every piece of it that was done.

    `done` of it was there before. With a `unit` the rate is told too.
    """
    rate = [TextColumn("{task.fields[rate]}", markup=False)] if unit else []
    columns = BarColumn(), TaskProgressColumn(), *rate, TimeRemainingColumn()
    with Progress(TextColumn(words, markup=False), *columns, console=out, transient=True) as bar:
        task = bar.add_task("", total=total, rate="")
        bar.update(task, completed=done)
        tenths, began, made = int(10.0 * done / total), time.monotonic(), 0.0

        def advance(amount: float) -> None:
            nonlocal tenths, made
            made += amount
            pace = made / max(time.monotonic() - began, 1e-3)
            told = f"{pace:.0f} {unit}/s" if unit else ""
            bar.update(task, advance=amount, rate=told)
            now = int(10.0 * bar.tasks[0].completed / total)
            if now > tenths and not can_rewrite_lines(out):
                left = (total - done - made) / pace
                more = f", {told}, about {left:.0f} s left" if unit and now < 10 else ""
                out.print(f"{words}: {10 * now} % is done{more}", soft_wrap=True)
            tenths = now

        yield advance


@contextmanager
def resume_hint(folder: Path, out: Console) -> Generator[None]:
    """After Ctrl-C, say how to go on."""
    try:
        yield
    except KeyboardInterrupt:
        words = f"what is done is kept; the same command with --out {folder} goes on there"
        out.print(words, soft_wrap=True)
        raise
