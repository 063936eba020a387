"""Entry point of the command `rcmservo` and of `python -m rcmservo`.

Ctrl-C ends every command with one line, the results so far and a fixed exit code.
"""

import os
import sys

EXIT_INTERRUPTED = 130
"""Exit code after Ctrl-C."""


def main() -> int:
    """Load the commands, run the requested one and return the exit code."""
    try:
        from rcmservo.cli.cli import main as run

        return run()
    except KeyboardInterrupt as interrupt:
        results = f"; the results so far are in {interrupt}" if str(interrupt) else ""
        print(f"rcmservo: stopped by Ctrl-C{results}", file=sys.stderr)
        return EXIT_INTERRUPTED
    finally:
        _drop_unread_output()


def _drop_unread_output() -> None:
    """Discard the rest of the output if nothing reads it, for example after a terminal was closed.

    Otherwise Python ends with exit code 120 instead of the code of the command.
    """
    for stream in sys.stdout, sys.stderr:
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


if __name__ == "__main__":
    sys.exit(main())
