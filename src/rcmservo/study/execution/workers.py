"""Workers of a study by dask.distributed: local processes, or a cluster by its scheduler's address.

A scheduler is the process that passes requests on to workers. Everyone who can connect to a
scheduler can run code on its workers. The local scheduler therefore listens on the loopback
interface and requires a certificate that is made for it alone. A remote scheduler is used over TLS,
with the certificates in dask's configuration, or on the loopback interface, where a tunnel may end.
"""

import gc
import ipaddress
import logging
import re
import signal
import socket
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import islice
from multiprocessing import resource_tracker
from typing import Any, NamedTuple

from rcmservo.errors import BadInput, RcmServoError, require, require_extra, shorten_to_line
from rcmservo.study.execution.chunk import ChunkRequest, PackageMismatch, RowValues, run_chunk
from rcmservo.study.execution.package_version import identify_package

with require_extra("a study", "study"):
    import distributed
    from dask import config, system

DASK: Any = distributed
"""Dask as `Any`, because most of it has no type annotations."""

SCHEDULER_HOST = "127.0.0.1"
WORKER_TIMEOUT_S = 30.0
"""Time to wait for a scheduler, and then for its first worker, s."""
WORKER_START_ATTEMPTS = 10
"""Number of times that lost workers are replaced within WORKER_TIMEOUT_S."""
TASKS_PER_WORKER = 4
"""Requests sent ahead per worker, so that no worker is idle."""
MAX_LOST_WORKERS = 100
"""Number of workers that may die on a request before the study stops."""
CLUSTER_OPTION = "--cluster"
DASK_OBJECT_PATTERN = re.compile(r"in <[^>]*>: (\w+: )?(\[Errno \d+\] )?")
"""Part of dask's messages that describes its internal objects."""


class WorkLost(RcmServoError):
    """Requests in progress that no worker can complete."""


class PendingTask(NamedTuple):
    """Request in progress.

    Parameters
    ----------
    key : str
        Key that the result is stored by.
    request : ChunkRequest
        The request.
    losses : int
        Number of workers that died on it.
    """

    key: str
    request: ChunkRequest
    losses: int


class WorkerPool:
    """Pool of workers that run requests.

    Parameters
    ----------
    client : Any
        Dask client.
    where : str
        Address of the scheduler, or "this machine", for messages.
    """

    def __init__(self, client: Any, where: str) -> None:
        self._client, self.where = client, where
        self._pending: dict[Any, PendingTask] = {}

    @property
    def count(self) -> int:
        """Number of requests that run at the same time."""
        return sum(self._client.nthreads().values())

    def run(
        self, requests: Iterable[tuple[str, ChunkRequest]]
    ) -> Generator[tuple[str, list[RowValues]]]:
        """Yield key and rows of every request as they arrive.

        Another worker takes over the requests of a worker that dies.

        Raises
        ------
        WorkLost
            If the scheduler disconnects, a worker has no rcmservo, or too many workers die on one
            request.
        """
        waiting_requests, futures = iter(requests), DASK.as_completed()
        try:
            self._submit_waiting(futures, waiting_requests)
            for future in futures:
                task = self._pending.pop(future)
                try:
                    rows = future.result()
                except DASK.KilledWorker as error:
                    futures.add(self._submit(self._count_loss(task, error)))
                    continue
                except ImportError as error:
                    raise WorkLost(
                        f"a worker has no rcmservo: {shorten_to_line(error)}; install it there"
                    ) from error
                yield task.key, rows
                self._submit_waiting(futures, waiting_requests)
        except (OSError, DASK.CancelledError) as error:
            raise WorkLost(
                f"the scheduler at {self.where} has disconnected: {shorten_to_line(error)}; "
                "the same command resumes the study"
            ) from error
        finally:
            self._client.cancel(list(self._pending))
            self._pending.clear()

    def _submit_waiting(
        self, futures: Any, waiting_requests: Iterator[tuple[str, ChunkRequest]]
    ) -> None:
        """Submit requests until every worker has enough of them."""
        free_places = TASKS_PER_WORKER * max(self.count, 1) - len(self._pending)
        for key, request in islice(waiting_requests, max(free_places, 0)):
            futures.add(self._submit(PendingTask(key, request, 0)))

    def _submit(self, task: PendingTask) -> Any:
        future = self._client.submit(run_chunk, task.request, key=f"{task.key}-{task.losses}")
        self._pending[future] = task
        return future

    def _count_loss(self, task: PendingTask, error: Exception) -> PendingTask:
        """Return the task with one more lost worker; raise `WorkLost` after too many."""
        if task.losses >= MAX_LOST_WORKERS:
            raise WorkLost(
                f"{task.losses} workers died on the same request: {shorten_to_line(error)}"
            ) from error
        return task._replace(losses=task.losses + 1)


@contextmanager
def open_worker_pool(address: str | None, workers: int | None) -> Generator[WorkerPool]:
    """Open a pool of workers, all with the version of rcmservo of this machine.

    Parameters
    ----------
    address : str or None
        Address of the scheduler of a cluster; None for processes of this machine.
    workers : int or None
        Number of local processes; None for one per processor.

    Raises
    ------
    BadInput
        If the address is invalid, not protected, or no scheduler answers there.
    PackageMismatch
        If a worker has another version of rcmservo.
    """
    with _silence_dask():
        if address is None:
            with _start_processes(workers) as client:
                yield WorkerPool(client, "this machine")
        else:
            require_protected(address)
            _require_certificates(address)
            with _connect(address) as client:
                _require_same_package(client)
                yield WorkerPool(client, address)


@contextmanager
def _silence_dask() -> Generator[None]:
    """Suppress dask's log messages: this module reports errors in its own words."""
    logger = logging.getLogger("distributed")
    previous_level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(previous_level)


@contextmanager
def _start_processes(workers: int | None) -> Generator[Any]:
    """Start a scheduler and workers on this machine, and yield their client."""
    count = workers or system.CPU_COUNT
    settings: dict[str, Any] = {
        "distributed.scheduler.allowed-failures": MAX_LOST_WORKERS,
        "distributed.scheduler.http.routes": [],
        # dask's self-monitoring takes a twentieth of two processors
        "distributed.worker.profile.enabled": False,
        "distributed.admin.tick.interval": "1s",
        "distributed.admin.system-monitor.interval": "10s",
    }
    with (
        config.set(settings),
        _block_interrupts(),
        DASK.LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            processes=True,
            host=SCHEDULER_HOST,
            dashboard_address=f"{SCHEDULER_HOST}:0",
            worker_dashboard_address=f"{SCHEDULER_HOST}:0",
            security=True,
            memory_limit=None,
            silence_logs=logging.CRITICAL + 1,
        ) as cluster,
        DASK.Client(cluster) as client,
    ):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        _wait_for_workers(cluster, client, count)
        yield client


def _wait_for_workers(cluster: Any, client: Any, count: int) -> None:
    """Wait until all workers have joined, and replace those that are lost.

    With OpenSSL 3.5 one worker in thirty loses its connection when it joins, and dask does not
    replace it.
    """
    with config.set({"distributed.deploy.lost-worker-timeout": "1s"}):
        for _ in range(WORKER_START_ATTEMPTS):
            with suppress(TimeoutError):
                client.wait_for_workers(count, timeout=WORKER_TIMEOUT_S / WORKER_START_ATTEMPTS)
                return
            cluster.scale(count)
    if not client.nthreads():
        raise WorkLost(
            f"no worker of this machine has joined in {WORKER_TIMEOUT_S:g} s: use fewer --workers"
        )


@contextmanager
def _block_interrupts() -> Generator[None]:
    """Block SIGINT, which Ctrl-C sends to every process of the terminal, while workers start.

    The threads and workers that start inside inherit the block; the caller unblocks its own thread.
    """
    resource_tracker.ensure_running()  # otherwise the first process starts it and unblocks SIGINT
    previous_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous_mask)


def require_protected(address: str) -> None:
    """Raise `BadInput` for a scheduler that others in the network can use too."""
    scheme, _, host_and_port = address.rpartition("://")
    host, _, port = host_and_port.rpartition(":")
    is_address = scheme in ("", "tcp", "tls") and bool(host) and port.isdigit()
    expected = "the address of a dask scheduler, such as tls://host:8786"
    require(is_address, CLUSTER_OPTION, address, expected)
    expected = (
        "tls://..., or on the loopback interface, because everyone who connects to a scheduler can "
        "run code on its workers; a tunnel such as ssh -L 8786:localhost:8786 ends there"
    )
    is_protected = scheme == "tls" or _is_loopback(host.strip("[]"))
    require(is_protected, CLUSTER_OPTION, address, expected)


def _require_certificates(address: str) -> None:
    """Raise `BadInput` for a TLS address if dask's configuration lacks certificates."""
    names = "ca-file", "client.cert", "client.key"
    missing = [name for name in names if not config.get(f"distributed.comm.tls.{name}", None)]
    expected = "an address with certificates in dask's configuration (docs/cluster.md); it lacks "
    uses_tls = address.startswith("tls://")
    require(not (uses_tls and missing), CLUSTER_OPTION, address, expected + ", ".join(missing))


def _is_loopback(host: str) -> bool:
    """Return True if all addresses of a host are on the loopback interface."""
    try:
        addresses = {info[4][0] for info in socket.getaddrinfo(host, None)}
    except (OSError, UnicodeError) as error:
        raise BadInput(
            CLUSTER_OPTION, host, f"a host with an address ({shorten_to_line(error)})"
        ) from error
    return all(ipaddress.ip_address(address).is_loopback for address in addresses)


@contextmanager
def _connect(address: str) -> Generator[Any]:
    """Connect to a scheduler with at least one worker, and yield the client."""
    client, failure = _try_to_connect(address)
    if client is None:
        gc.collect()  # collect the partial client now: collected later, it can wait for itself
        expected = f"the address of a dask scheduler that answers ({failure})"
        raise BadInput(CLUSTER_OPTION, address, expected)
    with client:
        try:
            client.wait_for_workers(1, timeout=WORKER_TIMEOUT_S)
        except TimeoutError as error:
            raise RcmServoError(
                f"no worker has joined the scheduler at {address} in {WORKER_TIMEOUT_S:g} s: start "
                "one, as docs/cluster.md describes"
            ) from error
        yield client


def _try_to_connect(address: str) -> tuple[Any, str]:
    """Return the client of a scheduler, or None and the reason.

    After a failure nothing refers to the partial client.
    """
    try:
        return DASK.Client(address, timeout=WORKER_TIMEOUT_S), ""
    except (OSError, TypeError, ValueError, RuntimeError) as error:
        return None, shorten_to_line(DASK_OBJECT_PATTERN.sub("", str(error.__cause__ or error)))


def _require_same_package(client: Any) -> None:
    """Raise `PackageMismatch` if a worker has another version of this package, or none."""
    packages: dict[str, object] = client.run(identify_package, on_error="return")
    others = {
        worker: package for worker, package in packages.items() if package != identify_package()
    }
    for worker, package in others.items():
        is_installed = isinstance(package, str)
        found = f"rcmservo {package}" if is_installed else f"none ({shorten_to_line(package)})"
        raise PackageMismatch(
            f"{len(others)} of {len(packages)} workers have another rcmservo than this machine, "
            f"{identify_package()}: {worker} has {found}; install the same version there"
        )
