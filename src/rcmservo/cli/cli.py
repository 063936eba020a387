"""The command line: which command is asked for, and how it ends. A command is imported when it is
named, so that `--help` starts at once.
"""

import sys
import textwrap
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

from rcmservo import __version__
from rcmservo.errors import BadInput, RcmServoError, Stopped

EXIT_BAD_INPUT, EXIT_STOPPED = 2, 1
"""Exit codes: of what cannot be done, and of what was told to end before it was done. Others are 0,
and 1 where a run did not settle."""

SUMMARY_COLUMN = 11
"""Columns before the summary of a command."""


class CommandEntry(NamedTuple):
    """A command that is not imported yet.

    Parameters
    ----------
    place : str
        Module below rcmservo.cli and its function that does it, as module:function. The dataclass
        of the function's `options` is the only list of the command's options.
    summary : str
        One line for the list of commands.
    """

    entry_point: str
    summary: str

    def load(self) -> tuple[type[Any], Callable[[Any], int]]:
        """Import the command: its options, and what it does."""
        module, _, name = self.entry_point.partition(":")
        action = getattr(import_module(f"rcmservo.cli.{module}"), name)
        return action.__annotations__["options"], action


COMMANDS = {
    "run": CommandEntry("run:run", "Servo a simulated arm to a target."),
    "live": CommandEntry("live:live", "Servo in wall time, a simulated arm or your own."),
    "serve": CommandEntry("lab.serve:serve", "Serve the operator's page in the browser."),
    "replay": CommandEntry("replay:replay", "Score a recording, or recompute a recorded run."),
    "show": CommandEntry("show:show", "Summarise a recorded run, with a timeline and figures."),
    "export": CommandEntry("export:export", "Write a recorded run as CSV and NumPy arrays."),
    "paper": CommandEntry("paper:paper", "Reproduce the paper's experiments, with a report."),
    "study": CommandEntry("studies.study:study", "Compare methods in many simulated scenes."),
    "tune": CommandEntry("studies.tune:tune", "Search a method's settings."),
    "emulate": CommandEntry("lab.emulate:emulate", "Emulate a motion controller or a ROS arm."),
    "rig": CommandEntry("lab.rig_check:rig_check", "Check a rig file at the arm: rig check FILE."),
    "markers": CommandEntry("lab.markers:markers", "Find coloured balls that could be markers."),
}
"""Every command by its name."""

DESCRIPTION = """Position a tool through a remote centre of motion from the picture of one uncalibrated
camera."""


def main(arguments: list[str] | None = None) -> int:
    """Do what the arguments ask for, and return the exit code."""
    from rcmservo.cli.terminal import use_ascii_fallback

    use_ascii_fallback()
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        return _dispatch(arguments)
    except Stopped as stopped:
        print(f"rcmservo: {stopped}", file=sys.stderr)
        return EXIT_STOPPED
    except BadInput as error:
        option = error.field.startswith("--") and arguments[0] in COMMANDS
        more = "--help-all" if "." in error.field else "--help"
        return _print_error(
            f"{error}; see rcmservo {arguments[0]} {more}" if option else str(error)
        )
    except RcmServoError as error:
        return _print_error(str(error))
    except OSError as error:
        return _print_error(f"{error.filename or 'output'}: cannot be used: {error.strerror}")


def _dispatch(arguments: list[str]) -> int:
    match arguments:
        case ["--version"]:
            print(f"rcmservo {__version__}")
        case ["-h" | "--help" | "--help-all", *_]:
            print(command_overview())
        case [name, *words] if name in COMMANDS:
            return _run_command(name, words)
        case _:
            return _print_error(f"{_unknown_command(arguments)}; see rcmservo --help")
    return 0


def _run_command(name: str, words: list[str]) -> int:
    """Do what a command is asked for, or print its help."""
    from rcmservo.cli.command_line.help_text import HELP_ALL_OPTION, HELP_OPTIONS, help_text

    if {*HELP_OPTIONS, HELP_ALL_OPTION} & set(words):
        print(help_text(name, options_kind(name, words), HELP_ALL_OPTION in words))
        return 0
    options = asked_of(name, words)
    if name == "replay":
        return _run_replay(options, words)
    if name == "study" and options.file_defaults is not None:
        options = asked_of(name, words, options.file_defaults)
    _, action = COMMANDS[name].load()
    return action(options)


def options_kind(name: str, words: list[str]) -> type[Any]:
    """Return the dataclass of a command's options, with those of a user's own estimator that the
    words name.
    """
    from rcmservo.cli.servo_options import with_own_estimator

    kind, _ = COMMANDS[name].load()
    return with_own_estimator(kind, words)


def asked_of(name: str, words: list[str], defaults: Any = None) -> Any:
    """Return the options of a command that the words give; `usual` holds the others."""
    from rcmservo.cli.parse import parse

    return parse(name, options_kind(name, words), words, defaults)


def _run_replay(options: Any, words: list[str]) -> int:
    """Score a recording, or recompute a run with its recorded settings but for those given."""
    from rcmservo.cli.replay import recompute_run, recorded_options, replay
    from rcmservo.recording import reader

    if not reader.record_file(options.path).is_file():
        return replay(options)
    then = reader.read_record(options.path)
    usual = recorded_options(options, then)
    return recompute_run(asked_of("replay", words, usual), usual, then)


def command_overview() -> str:
    """Return the list of all commands."""
    about = textwrap.fill(" ".join(DESCRIPTION.split()), 80)
    rows = (f"  {name:<{SUMMARY_COLUMN - 2}}{one.summary}" for name, one in COMMANDS.items())
    return "\n".join(
        [
            "usage: rcmservo [--version] COMMAND [options]",
            "",
            about,
            "",
            "commands:",
            *rows,
            "",
            "rcmservo COMMAND --help explains a command.",
        ]
    )


def _unknown_command(arguments: list[str]) -> str:
    """Return a sentence about arguments that name no command."""
    from rcmservo.errors import quoted, suggestion

    known = ", ".join(COMMANDS)
    if not arguments:
        return f"a command must be given, one of {known}"
    word = arguments[0]
    return f"the command must be one of {known}, got {quoted(word)}{suggestion(word, COMMANDS)}"


def _print_error(sentence: str) -> int:
    print(f"rcmservo: {sentence}", file=sys.stderr)
    return EXIT_BAD_INPUT
