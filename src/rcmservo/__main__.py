"""The way in: `rcmservo` and `python -m rcmservo`. Ctrl-C ends it quietly, while it loads too."""

import os
import sys

EXIT_INTERRUPTED = 130
"""Exit code after Ctrl-C."""


def main() -> int:
    """Load the commands and do what is asked for; the exit code."""
    try:
        from rcmservo.cli.cli import main as do

        return do()
    except KeyboardInterrupt as stop:
        where = f"; what was done until then is in {stop}" if str(stop) else ""
        print(f"rcmservo: stopped by Ctrl-C{where}", file=sys.stderr)
        return EXIT_INTERRUPTED
    finally:
        _drop_unread_output()


def _drop_unread_output() -> None:
    """Send the rest of the output nowhere if nobody reads it, as after a terminal was closed.

    Python would end with exit code 120 instead of the command's.
    """
    for stream in sys.stdout, sys.stderr:
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


if __name__ == "__main__":
    sys.exit(main())
