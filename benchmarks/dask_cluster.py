"""Local dask scheduler and workers for benchmarks and tests, started as dask documents it."""

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
"""Time limit (s) for the start of a scheduler or a worker."""
DASHBOARD_OPTION = "--dashboard-address", "127.0.0.1:0"
"""Address of dask's web server, on a free port."""
DASK = [str(Path(sys.executable).with_name("dask"))]


@contextmanager
def program(words: Sequence[str], **options: Any) -> Generator[subprocess.Popen[bytes]]:
    """Run a program in the context; kill it and its children at the end."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(words, start_new_session=True, **{**quiet, **options})
    try:
        yield process
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@dataclass
class Cluster:
    """Running scheduler, with methods to start its workers."""

    address: str
    """Address of the scheduler."""
    tls: Sequence[str]
    """Options with the TLS certificates."""
    _stack: ExitStack
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def start(self, count: int, **options: Any) -> None:
        """Start `count` more workers; the nanny of each restarts it when it dies."""
        words = [*DASK, "worker", self.address, "--nworkers", str(count), "--nthreads", "1"]
        words += [*DASHBOARD_OPTION, "--memory-limit", "0", *self.tls]
        folder = self._stack.enter_context(tempfile.TemporaryDirectory())
        options = {"cwd": folder, **options}
        words += ["--local-directory", folder]
        self.workers.append(self._stack.enter_context(program(words, **options)))

    def wait_for(self, count: int) -> None:
        """Wait until `count` workers are connected."""
        with distributed.Client(self.address, timeout=PATIENCE) as client:
            client.wait_for_workers(count, timeout=PATIENCE)

    def stop(self) -> None:
        """End the scheduler and all workers at once."""
        self._stack.close()

    def pids(self, security: Any = None) -> list[int]:
        """Return the process ids of the present workers."""
        with distributed.Client(self.address, security=security, timeout=PATIENCE) as client:
            return sorted(client.run(os.getpid).values())


@contextmanager
def cluster(workers: int, tls: Mapping[str, str] | None = None) -> Generator[Cluster]:
    """Run a scheduler on the loopback interface with some workers in the context."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        noted, options = folder / "scheduler.json", [w for p in (tls or {}).items() for w in p]
        words = [*DASK, "scheduler", "--host", "127.0.0.1", "--port", "0", *DASHBOARD_OPTION]
        words += ["--protocol", "tls" if tls else "tcp", "--scheduler-file", str(noted), *options]
        stack.enter_context(program(words, cwd=folder))
        address = _noted(noted)
        made = Cluster(address, options, stack)
        if workers:
            made.start(workers)
        yield made


def _noted(path: Path) -> str:
    """Return the address in a scheduler file, as soon as it is complete."""
    from json import loads

    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if path.exists() and (text := path.read_text()).strip().endswith("}"):
            return loads(text)["address"]
        time.sleep(0.05)
    raise TimeoutError("the scheduler did not start")
