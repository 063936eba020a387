"""Start of `rcmservo serve` in another process."""

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from conftest import INTERRUPTIBLE_COMMAND, SMALL_30_HZ_RIG_TOML, make_environment


@contextmanager
def serve_page(folder: Path, *options: str) -> Iterator[str]:
    """Serve the page, record into the folder, and yield the address of the page."""
    command = [sys.executable, "-c", INTERRUPTIBLE_COMMAND, "serve", "--port", "0", "--no-browser"]
    (rig := folder.with_name(f"{folder.name}.toml")).write_text(SMALL_30_HZ_RIG_TOML)
    poses = folder.with_name(f"{folder.name}-poses")
    process = subprocess.Popen(
        [
            *command,
            "--seed",
            "1",
            "--teaching-frames",
            "10",
            "--out",
            str(folder),
            "--poses",
            str(poses),
            "--rig",
            str(rig),
            *options,
        ],
        stdout=subprocess.PIPE,
        text=True,
        env=make_environment(COLUMNS="200", TERM="dumb"),
    )
    assert process.stdout is not None
    try:
        line = next(line for line in process.stdout if "rcmservo page at" in line)
        address = re.search(r"http://[\d.]+:\d+", line)
        assert address is not None and "simulated arm" in line, line
        yield address[0]
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
