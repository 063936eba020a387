"""The command line: which command is asked for, and how it ends."""

import sys
from collections.abc import Callable
from typing import Annotated, Any

from tyro.conf import subcommand

from rcmservo.app.export import ExportOptions, export
from rcmservo.app.live import LiveOptions, live
from rcmservo.app.paper import PaperOptions, paper
from rcmservo.app.parse import parse
from rcmservo.app.replay import ReplayOptions, recompute_run, recorded, replay
from rcmservo.app.run import RunOptions, run
from rcmservo.app.show import ShowOptions, show
from rcmservo.errors import RcmServoError
from rcmservo.record import reader

BAD_INPUT, INTERRUPTED = 2, 130
"""Exit codes beside 0, and 1 where a run did not settle."""

Command = (
    Annotated[RunOptions, subcommand("run")]
    | Annotated[LiveOptions, subcommand("live")]
    | Annotated[ReplayOptions, subcommand("replay")]
    | Annotated[ShowOptions, subcommand("show")]
    | Annotated[ExportOptions, subcommand("export")]
    | Annotated[PaperOptions, subcommand("paper")]
)

COMMANDS: dict[type[Any], Callable[[Any], int]] = {
    RunOptions: run,
    LiveOptions: live,
    ReplayOptions: replay,
    ShowOptions: show,
    ExportOptions: export,
    PaperOptions: paper,
}
"""What each command does."""


def main(arguments: list[str] | None = None) -> int:
    """Do what the arguments ask for, and return the exit code."""
    try:
        command = parse(Command, arguments)
        if isinstance(command, ReplayOptions) and reader.file_of(command.path).is_file():
            then = reader.read(command.path)
            usual = recorded(command, then)
            return recompute_run(parse(Command, arguments, usual), usual, then)
        return COMMANDS[type(command)](command)
    except RcmServoError as error:
        return _fail(str(error))
    except OSError as error:
        return _fail(f"{error.filename or 'output'}: cannot be used: {error.strerror}")
    except KeyboardInterrupt:
        print("rcmservo: stopped by Ctrl-C", file=sys.stderr)
        return INTERRUPTED


def _fail(sentence: str) -> int:
    print(f"rcmservo: {sentence}", file=sys.stderr)
    return BAD_INPUT
