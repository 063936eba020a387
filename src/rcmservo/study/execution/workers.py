"""Workers, by dask.distributed: processes of this machine, or those of a cluster by the address of
its scheduler.

Whoever reaches a scheduler can run code on its workers. So the one that is started here listens on
the loopback interface and asks for a certificate that is made for it alone. Another one is used
over TLS, with the certificates that dask's own configuration names, or on the loopback interface,
where a tunnel may end.
"""

import gc
import ipaddress
import logging
import re
import signal
import socket
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from typing import Any, NamedTuple

from rcmservo.errors import BadInput, RcmServoError, needing, one_line, require
from rcmservo.study.execution.chunk import ChunkOrder, Numbers, OtherPackage, done
from rcmservo.study.execution.package_version import package

with needing("a study", "study"):
    import distributed
    from dask import config, system

DASK: Any = distributed
"""Dask without types: most of it has none."""

HERE = "127.0.0.1"
PATIENCE = 30.0
"""s for which a scheduler is waited for, and then for a first worker."""
STARTS = 10
"""Times that lost workers are replaced within PATIENCE."""
AHEAD = 4
"""Orders for each worker that are under way, so that none is idle."""
LOSSES = 100
"""Workers that may die with an order before it is blamed for that."""
OPTION = "--cluster"
INSIDE = re.compile(r"in <[^>]*>: (\w+: )?(\[Errno \d+\] )?")
"""What dask's messages tell of its own objects."""


class WorkLost(RcmServoError):
    """What was under way cannot be had."""


class Given(NamedTuple):
    """An order that is under way.

    Parameters
    ----------
    key : str
        What its result is kept by.
    order : ChunkOrder
        What is to be done.
    losses : int
        Workers that died with it.
    """

    key: str
    order: ChunkOrder
    losses: int


class Crew:
    """Workers that take orders."""

    def __init__(self, client: Any, where: str) -> None:
        self._client, self.where = client, where
        self._under_way: dict[Any, Given] = {}

    @property
    def count(self) -> int:
        """Orders that are worked on at a time."""
        return sum(self._client.nthreads().values())

    def done(
        self, orders: Iterable[tuple[str, ChunkOrder]]
    ) -> Generator[tuple[str, list[Numbers]]]:
        """The rows of every order, as they come. A worker that dies loses nothing: what it had is
        done by another.
        """
        waiting, futures = iter(orders), DASK.as_completed()
        try:
            self._fill(futures, waiting)
            for future in futures:
                given = self._under_way.pop(future)
                try:
                    rows = future.result()
                except DASK.KilledWorker as error:
                    futures.add(self._submit(self._again(given, error)))
                    continue
                except ImportError as error:
                    raise WorkLost(f"a worker has no rcmservo: {one_line(error)}") from error
                yield given.key, rows
                self._fill(futures, waiting)
        except (OSError, DASK.CancelledError) as error:
            raise WorkLost(f"the scheduler at {self.where} is gone: {one_line(error)}") from error
        finally:
            self._client.cancel(list(self._under_way))
            self._under_way.clear()

    def _fill(self, futures: Any, waiting: Iterator[tuple[str, ChunkOrder]]) -> None:
        """Keep every worker busy."""
        room = AHEAD * max(self.count, 1) - len(self._under_way)
        for _, (key, order) in zip(range(room), waiting, strict=False):
            futures.add(self._submit(Given(key, order, 0)))

    def _submit(self, given: Given) -> Any:
        future = self._client.submit(done, given.order, key=f"{given.key}-{given.losses}")
        self._under_way[future] = given
        return future

    def _again(self, given: Given, error: Exception) -> Given:
        if given.losses >= LOSSES:
            raise WorkLost(f"every worker that takes it dies: {one_line(error)}") from error
        return given._replace(losses=given.losses + 1)


@contextmanager
def crew(address: str | None, workers: int | None) -> Generator[Crew]:
    """The workers of a cluster, all of which have this very package; without an address as many
    processes of this machine as it has processors, or as are asked for.
    """
    with _quietly():
        if address is None:
            with _processes(workers) as client:
                yield Crew(client, "this machine")
        else:
            require_guarded(address)
            _require_certificates(address)
            with _reached(address) as client:
                _require_same_package(client)
                yield Crew(client, address)


@contextmanager
def _quietly() -> Generator[None]:
    """What goes wrong is told by us; dask's own words of it go nowhere."""
    log = logging.getLogger("distributed")
    usual = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        log.setLevel(usual)


@contextmanager
def _processes(workers: int | None) -> Generator[Any]:
    """A scheduler and workers of our own."""
    count = workers or system.CPU_COUNT
    chosen: dict[str, Any] = {
        "distributed.scheduler.allowed-failures": LOSSES,
        "distributed.scheduler.http.routes": [],
        # what dask watches itself by, a twentieth of two processors
        "distributed.worker.profile.enabled": False,
        "distributed.admin.tick.interval": "1s",
        "distributed.admin.system-monitor.interval": "10s",
    }
    with (
        config.set(chosen),
        _left_alone(),
        DASK.LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            processes=True,
            host=HERE,
            dashboard_address=f"{HERE}:0",
            worker_dashboard_address=f"{HERE}:0",
            security=True,
            memory_limit=None,
            silence_logs=logging.CRITICAL + 1,
        ) as cluster,
        DASK.Client(cluster) as client,
    ):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        _await_all(cluster, client, count)
        yield client


def _await_all(cluster: Any, client: Any, count: int) -> None:
    """Wait until all workers have joined, and replace those that are lost meanwhile.

    With OpenSSL 3.5 one of thirty loses its connection when it joins, and dask starts no other.
    """
    with config.set({"distributed.deploy.lost-worker-timeout": "1s"}):
        for _ in range(STARTS):
            with suppress(TimeoutError):
                client.wait_for_workers(count, timeout=PATIENCE / STARTS)
                return
            cluster.scale(count)
    if not client.nthreads():
        raise WorkLost(f"no worker of this machine has joined in {PATIENCE:g} s")


@contextmanager
def _left_alone() -> Generator[None]:
    """Ctrl-C, which reaches every process of the terminal, waits until this one unblocks it. The
    thread that is made in here, and all workers that it ever starts, never hear of it.
    """
    resource_tracker.ensure_running()  # whoever starts a first process starts it, and unblocks
    usual = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, usual)


def require_guarded(address: str) -> None:
    """Refuse a scheduler that anybody in the network can talk to as well."""
    scheme, _, rest = address.rpartition("://")
    host, _, port = rest.rpartition(":")
    good = scheme in ("", "tcp", "tls") and bool(host) and port.isdigit()
    require(good, OPTION, address, "that of a dask scheduler, such as tls://host:8786")
    right = (
        "tls://..., or on the loopback interface, as whoever reaches a scheduler can run code on "
        "its workers; a tunnel such as ssh -L 8786:localhost:8786 ends there"
    )
    require(scheme == "tls" or _on_loopback(host.strip("[]")), OPTION, address, right)


def _require_certificates(address: str) -> None:
    """Refuse TLS of which dask's configuration has no certificates."""
    names = "ca-file", "client.cert", "client.key"
    lacking = [name for name in names if not config.get(f"distributed.comm.tls.{name}", None)]
    right = "an address with its certificates in dask's configuration (docs/cluster.md); it lacks "
    need = address.startswith("tls://")
    require(not (need and lacking), OPTION, address, right + ", ".join(lacking))


def _on_loopback(host: str) -> bool:
    try:
        found = {info[4][0] for info in socket.getaddrinfo(host, None)}
    except (OSError, UnicodeError) as error:
        raise BadInput(OPTION, host, f"a host with an address ({one_line(error)})") from error
    return all(ipaddress.ip_address(place).is_loopback for place in found)


@contextmanager
def _reached(address: str) -> Generator[Any]:
    """The client of a scheduler that is there, with a worker at least."""
    client, failure = _connected(address)
    if client is None:
        gc.collect()  # the half-made client, while it cannot wait for itself: later it might
        right = f"the address of a dask scheduler that answers ({failure})"
        raise BadInput(OPTION, address, right)
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError as error:
            raise RcmServoError(
                f"no worker has joined the scheduler at {address} in {PATIENCE:g} s: start one, "
                f"as docs/cluster.md has it"
            ) from error
        yield client


def _connected(address: str) -> tuple[Any, str]:
    """The client of a scheduler; or None, and why not, with nothing that holds on to the half-made
    one.
    """
    try:
        return DASK.Client(address, timeout=PATIENCE), ""
    except (OSError, TypeError, ValueError, RuntimeError) as error:
        return None, one_line(INSIDE.sub("", str(error.__cause__ or error)))


def _require_same_package(client: Any) -> None:
    """Refuse workers with another version of this package, or without it."""
    told: dict[str, object] = client.run(package, on_error="return")
    others = {worker: found for worker, found in told.items() if found != package()}
    for worker, found in others.items():
        has = f"rcmservo {found}" if isinstance(found, str) else f"none ({one_line(found)})"
        raise OtherPackage(
            f"{len(others)} of {len(told)} workers have another rcmservo than this machine, "
            f"{package()}: {worker} has {has}; install the same version there"
        )
