"""Printing of a run's result."""

import json
from dataclasses import asdict

from rich.console import Console

from rcmservo.cli.terminal import build_two_column_table
from rcmservo.loop.run_result import RunResult
from rcmservo.recording.summary_text import format_title, list_result_rows

EXIT_NOT_SETTLED = 1
"""Exit code of a run that did not settle."""


def print_result(console: Console, result: RunResult, as_json: bool) -> int:
    """Print the result as a table, or as JSON on stdout; return the exit code of the command."""
    if as_json:
        print(json.dumps(asdict(result)))
    else:
        console.print(build_two_column_table(format_title(result), list_result_rows(result)))
        console.print(f"files in {result.folder}", soft_wrap=True)
    return 0 if result.settled else EXIT_NOT_SETTLED
