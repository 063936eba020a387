"""The way in: `rcmservo` and `python -m rcmservo`. Ctrl-C ends it quietly, while it loads too."""

import sys

INTERRUPTED = 130
"""Exit code after Ctrl-C."""


def main() -> int:
    """Load the commands and do what is asked for; the exit code."""
    try:
        from rcmservo.app.cli import main as do

        return do()
    except KeyboardInterrupt as stop:
        where = f"; what was done until then is in {stop}" if str(stop) else ""
        print(f"rcmservo: stopped by Ctrl-C{where}", file=sys.stderr)
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
