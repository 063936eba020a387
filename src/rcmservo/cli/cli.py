"""Command line: the table of all commands, the dispatch to one of them, and its exit code.

To add a command, write its file in this folder and add it to `COMMANDS`. To add an option, add a
field to the dataclass of the command's options, with its description in the Parameters section:
`RunOptions` in run_options.py for `rcmservo run`, otherwise the dataclass in the command's file.
A command is imported only when it is requested, so that `--help` is quick.
"""

import os
import sys
import textwrap
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

from rcmservo import __version__
from rcmservo.errors import BadInput, RcmServoError, Stopped, quote_value, suggest_name

EXIT_BAD_INPUT = 2
"""Exit code of an invalid request."""
EXIT_STOPPED = 1
"""Exit code of a stopped run, and of a run that did not settle."""
EXIT_PIPE_CLOSED = 141
"""Exit code if the reader of the output, such as `head`, has read enough: that of SIGPIPE."""


class CommandEntry(NamedTuple):
    """Command that is imported on first use.

    Parameters
    ----------
    entry_point : str
        Module below rcmservo.cli and its function, as module:function. The dataclass that
        annotates the function's parameter `options` is the only list of the command's options.
    summary : str
        Summary of one line for the list of commands.
    """

    entry_point: str
    summary: str

    def load(self) -> tuple[type[Any], Callable[[Any], int]]:
        """Import the command; return the class of its options and its function."""
        module, _, name = self.entry_point.partition(":")
        function = getattr(import_module(f"rcmservo.cli.{module}"), name)
        return function.__annotations__["options"], function


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
"""All commands by name."""

DESCRIPTION = (
    "Position a tool through a remote centre of motion from the images of one uncalibrated camera."
)


def main(arguments: list[str] | None = None) -> int:
    """Run the command that the arguments name and return the exit code."""
    from rcmservo.cli.terminal import use_ascii_fallback

    use_ascii_fallback()
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        exit_code = _dispatch(arguments)
        sys.stdout.flush()
        return exit_code
    except Stopped as stopped:
        print(f"rcmservo: {stopped}", file=sys.stderr)
        return EXIT_STOPPED
    except BadInput as error:
        is_option = error.field.startswith("--") and arguments[0] in COMMANDS
        help_option = "--help-all" if "." in error.field else "--help"
        hint = f"; see rcmservo {arguments[0]} {help_option}" if is_option else ""
        return _print_error(f"{error}{hint}")
    except RcmServoError as error:
        return _print_error(str(error))
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for the rest of it
        return EXIT_PIPE_CLOSED
    except OSError as error:
        return _print_error(f"{error.filename or 'output'}: cannot be used: {error.strerror}")


def _dispatch(arguments: list[str]) -> int:
    """Run a command, or print the version or the list of commands."""
    names = ", ".join(COMMANDS)
    match arguments:
        case ["--version"]:
            print(f"rcmservo {__version__}")
        case ["-h" | "--help" | "--help-all", *_]:
            print(format_command_overview())
        case [name, *command_arguments] if name in COMMANDS:
            return _run_command(name, command_arguments)
        case [name, *_]:
            invalid = f"{names}, got {quote_value(name)}{suggest_name(name, COMMANDS)}"
            return _print_error(f"the command must be one of {invalid}; see rcmservo --help")
        case _:
            return _print_error(f"a command must be given, one of {names}; see rcmservo --help")
    return 0


def _run_command(name: str, arguments: list[str]) -> int:
    """Run a command, or print its help."""
    from rcmservo.cli.argument_parsing.help_text import HELP_ALL_OPTION, HELP_OPTIONS, format_help

    if {*HELP_OPTIONS, HELP_ALL_OPTION} & set(arguments):
        print(format_help(name, load_options_class(name, arguments), HELP_ALL_OPTION in arguments))
        return 0
    options = parse_command_options(name, arguments)
    if name == "replay":
        return _run_replay(options, arguments)
    if name == "study" and options.file_defaults is not None:
        options = parse_command_options(name, arguments, options.file_defaults)
    _, function = COMMANDS[name].load()
    return function(options)


def load_options_class(name: str, arguments: list[str]) -> type[Any]:
    """Return the dataclass of a command's options.

    It includes the settings of a user-defined estimator that the arguments name.
    """
    from rcmservo.cli.servo_options import add_user_estimator_options

    options_class, _ = COMMANDS[name].load()
    return add_user_estimator_options(options_class, arguments)


def parse_command_options(name: str, arguments: list[str], defaults: Any = None) -> Any:
    """Return a command's options from its arguments, and from `defaults` where they are absent."""
    from rcmservo.cli.argument_parsing.parse import parse_options

    return parse_options(name, load_options_class(name, arguments), arguments, defaults)


def _run_replay(options: Any, arguments: list[str]) -> int:
    """Score a recording, or recompute a run with its recorded settings and the given ones."""
    from rcmservo.cli.replay import rebuild_recorded_options, recompute_run, replay
    from rcmservo.recording import reader

    if not reader.find_record_file(options.path).is_file():
        return replay(options)
    record = reader.read_record(options.path)
    recorded_options = rebuild_recorded_options(options, record)
    given_options = parse_command_options("replay", arguments, recorded_options)
    return recompute_run(given_options, recorded_options, record)


def format_command_overview() -> str:
    """Return the list of all commands."""
    width = max(map(len, COMMANDS)) + 2
    commands = "\n".join(f"  {name:<{width}}{entry.summary}" for name, entry in COMMANDS.items())
    return f"""usage: rcmservo [--version] COMMAND [options]

{textwrap.fill(DESCRIPTION, 80)}

commands:
{commands}

rcmservo COMMAND --help explains a command."""


def _print_error(message: str) -> int:
    print(f"rcmservo: {message}", file=sys.stderr)
    return EXIT_BAD_INPUT
