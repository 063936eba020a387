"""The command line: which command is asked for, and how it ends."""

import sys
from collections.abc import Callable
from typing import Any

from rcmservo import __version__
from rcmservo.app.export import ExportOptions, export
from rcmservo.app.lab.emulate import EmulateOptions, emulate
from rcmservo.app.lab.markers import MarkersOptions, markers
from rcmservo.app.lab.rig_check import RigOptions, rig_check
from rcmservo.app.lab.serve import ServeOptions, serve
from rcmservo.app.live import LiveOptions, live
from rcmservo.app.own_options import with_own
from rcmservo.app.paper import PaperOptions, paper
from rcmservo.app.parse import parse
from rcmservo.app.replay import ReplayOptions, recompute_run, recorded, replay
from rcmservo.app.run import RunOptions, run
from rcmservo.app.show import ShowOptions, show
from rcmservo.app.studies.study import StudyOptions, study
from rcmservo.app.studies.tune import TuneOptions, tune
from rcmservo.app.terminal import print_plainly
from rcmservo.errors import BadInput, RcmServoError
from rcmservo.live.lab import Stopped
from rcmservo.record import reader

BAD_INPUT, ENDED = 2, 1
"""Exit codes: of what cannot be done, and of what was told to end before it was done. Others are 0,
and 1 where a run did not settle."""

COMMANDS: dict[str, tuple[type[Any], Callable[[Any], int]]] = {
    "run": (RunOptions, run),
    "live": (LiveOptions, live),
    "serve": (ServeOptions, serve),
    "replay": (ReplayOptions, replay),
    "show": (ShowOptions, show),
    "export": (ExportOptions, export),
    "paper": (PaperOptions, paper),
    "study": (StudyOptions, study),
    "tune": (TuneOptions, tune),
    "emulate": (EmulateOptions, emulate),
    "rig": (RigOptions, rig_check),
    "markers": (MarkersOptions, markers),
}
"""The options of every command by its name, and what it does."""


def main(arguments: list[str] | None = None) -> int:
    """Do what the arguments ask for, and return the exit code."""
    print_plainly()
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        return _do(arguments)
    except Stopped as stopped:
        print(f"rcmservo: {stopped}", file=sys.stderr)
        return ENDED
    except BadInput as error:
        option = error.field.startswith("--") and arguments[0] in COMMANDS
        return _fail(f"{error}; see rcmservo {arguments[0]} --help" if option else str(error))
    except RcmServoError as error:
        return _fail(str(error))
    except OSError as error:
        return _fail(f"{error.filename or 'output'}: cannot be used: {error.strerror}")


def _do(arguments: list[str]) -> int:
    if arguments[:1] == ["--version"]:
        print(f"rcmservo {__version__}")
        return 0
    options = with_own({name: kind for name, (kind, _) in COMMANDS.items()}, arguments)
    command = parse(options, arguments)
    if isinstance(command, ReplayOptions) and reader.file_of(command.path).is_file():
        then = reader.read(command.path)
        usual = recorded(command, then)
        return recompute_run(parse(options, arguments, usual), usual, then)
    return COMMANDS[arguments[0]][1](command)


def _fail(sentence: str) -> int:
    print(f"rcmservo: {sentence}", file=sys.stderr)
    return BAD_INPUT
