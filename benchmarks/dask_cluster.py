"""A dask scheduler and workers on this machine, started as dask's own documentation has it: what
the tests and cluster.py give their studies to.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import distributed

PATIENCE = 60.0
"""s for a scheduler, or a worker, to be there."""
UNSEEN = "--dashboard-address", "127.0.0.1:0"
"""Where dask's own web server is."""
DASK = [str(Path(sys.executable).with_name("dask"))]


@contextmanager
def program(words: Sequence[str], **options: Any) -> Generator[subprocess.Popen[bytes]]:
    """A program and all that it starts, until the end of this."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(words, start_new_session=True, **{**quiet, **options})
    try:
        yield process
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@dataclass
class Cluster:
    """A scheduler that runs, and what starts workers of it."""

    address: str
    """Of the scheduler."""
    tls: Sequence[str]
    """Options that name its certificates."""
    _stack: ExitStack
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def start(self, count: int, **options: Any) -> None:
        """Start so many workers more, each with a nanny that starts it anew when it dies."""
        words = [*DASK, "worker", self.address, "--nworkers", str(count), "--nthreads", "1"]
        words += [*UNSEEN, "--memory-limit", "0", *self.tls]
        folder = self._stack.enter_context(tempfile.TemporaryDirectory())
        options = {"cwd": folder, **options}
        words += ["--local-directory", folder]
        self.workers.append(self._stack.enter_context(program(words, **options)))

    def wait_for(self, count: int) -> None:
        """Wait until so many workers are there."""
        with distributed.Client(self.address, timeout=PATIENCE) as client:
            client.wait_for_workers(count, timeout=PATIENCE)

    def stop(self) -> None:
        """End the scheduler and all workers at once."""
        self._stack.close()

    def pids(self, security: Any = None) -> list[int]:
        """The processes that work now."""
        with distributed.Client(self.address, security=security, timeout=PATIENCE) as client:
            return sorted(client.run(os.getpid).values())


@contextmanager
def cluster(workers: int, tls: Mapping[str, str] | None = None) -> Generator[Cluster]:
    """A scheduler on the loopback interface, with so many workers."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        noted, options = folder / "scheduler.json", [w for p in (tls or {}).items() for w in p]
        words = [*DASK, "scheduler", "--host", "127.0.0.1", "--port", "0", *UNSEEN]
        words += ["--protocol", "tls" if tls else "tcp", "--scheduler-file", str(noted), *options]
        stack.enter_context(program(words, cwd=folder))
        address = _noted(noted)
        made = Cluster(address, options, stack)
        if workers:
            made.start(workers)
        yield made


def _noted(path: Path) -> str:
    """The address that a scheduler has noted."""
    from json import loads

    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if path.exists() and (text := path.read_text()).strip().endswith("}"):
            return loads(text)["address"]
        time.sleep(0.05)
    raise TimeoutError("the scheduler did not start")
