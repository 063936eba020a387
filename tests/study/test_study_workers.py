"""Dask workers of a study: the rows do not depend on their number or on workers that die.

A cluster that does not answer, or that has another version of rcmservo, raises one error.
"""

import contextlib
import os
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import threading
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import psutil
import pytest
from dask_cluster import Cluster, cluster
from studies import InProcessPool, make_small_plan, run_plan

import rcmservo
from rcmservo.cli.cli import main
from rcmservo.errors import BadInput, RcmServoError
from rcmservo.study.execution import workers as worker_pool
from rcmservo.study.execution.chunk import PackageMismatch
from rcmservo.study.execution.run_study import StudyExecution
from rcmservo.study.execution.store import RUNS_FILE
from rcmservo.study.execution.workers import WorkerPool, WorkLost, open_worker_pool

USER_MODULE = """
from dataclasses import dataclass
import numpy as np
import rcmservo as rs
from rcmservo.geometry.features import compute_features_jacobian, shift_to_rcm

@dataclass(frozen=True)
class LeastSquares(rs.Estimator):
    name = "least_squares"
    def init(self):
        return np.zeros((4, 4)), 1e6 * np.eye(4)
    def update(self, memory, tool, sample):
        A, P = memory
        x = np.append(sample.p1, 1.0)
        gain = P @ x / (FORGET + x @ P @ x)
        A = A + np.outer(sample.points.ravel() - A @ x, gain)
        return A, (P - np.outer(gain, P @ x)) / FORGET
    def jacobian(self, memory, tool, sample):
        return compute_features_jacobian(shift_to_rcm(sample.points, sample.o_c)) @ memory[0][:, :3]
"""


@pytest.fixture(scope="module")
def lab() -> Generator[Cluster]:
    with cluster(2) as lab:
        lab.wait_for(2)
        yield lab


@pytest.fixture(scope="module")
def address_in_process() -> Generator[str]:
    """Address of a scheduler whose worker is a thread of this process."""
    options = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": None}
    address = {"host": "127.0.0.1", "protocol": "tcp://"}
    with worker_pool.DASK.LocalCluster(processes=False, **options, **address) as local:
        yield local.scheduler_address


def run_on(
    pool: WorkerPool,
    folder: Path,
    progress: Callable[[int], None] = lambda _: None,
    **settings: object,
) -> bytes:
    """Return the bytes of runs.parquet of a study on a pool of workers."""
    work = StudyExecution(make_small_plan(**settings), folder)
    work.run(pool, progress)
    work.gather()
    return (folder / RUNS_FILE).read_bytes()


def run_here(folder: Path, **settings: object) -> bytes:
    """Return the bytes of runs.parquet of the same study in this process."""
    run_plan(make_small_plan(**settings), folder).gather()
    return (folder / RUNS_FILE).read_bytes()


def test_a_worker_without_the_package_raises_an_error(
    address_in_process: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The worker joins after the check of the others."""

    def fail(request: object) -> None:
        raise ModuleNotFoundError("No module named 'rcmservo'")

    monkeypatch.setattr(worker_pool, "run_chunk", sent_by_value(fail))
    with open_worker_pool(address_in_process, None) as pool:
        results = pool.run([("key", None)])  # pyright: ignore[reportArgumentType]
        with pytest.raises(WorkLost, match="a worker has no rcmservo: No module named 'rcmservo'"):
            list(results)


def sent_by_value(function: Callable[[object], Any]) -> Callable[[object], Any]:
    """Return a function that dask sends by value, so that workers need not import it."""
    function.__module__ = "__main__"
    return function


@pytest.mark.slow
def test_the_rows_do_not_depend_on_the_number_of_workers(tmp_path: Path) -> None:
    settings = {"count": 8, "methods": ("dlt", "projection"), "duration": 1.5}
    with open_worker_pool(None, 2) as pool:
        assert pool.count == 2
        rows = run_on(pool, tmp_path / "many", **settings)
    assert rows == run_here(tmp_path / "here", **settings)


@pytest.mark.slow
def test_no_rows_are_lost_with_workers_that_die(lab: Cluster, tmp_path: Path) -> None:
    """A worker dies after every three requests, so that the study ends on a slow machine too."""
    settings = {"count": 800, "duration": 1.2, "methods": ("dlt",)}
    killed: list[int] = []
    with open_worker_pool(lab.address, None) as pool:
        assert pool.count == 2
        done = [0]

        def kill(runs: int) -> None:
            done[0] += 1
            if done[0] % 3 == 0 and len(killed) < 2:
                killed.append(lab.pids()[0])
                os.kill(killed[-1], signal.SIGKILL)

        rows = run_on(pool, tmp_path / "cluster", kill, **settings)
    assert len(killed) == 2
    assert rows == run_here(tmp_path / "here", **settings)


@pytest.mark.slow
def test_a_request_that_dask_abandons_is_sent_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask abandons it after one worker has died on it: its default are four."""

    def kill_one(request: object) -> list[int]:
        import os

        died = tmp_path / "died"
        count = died.stat().st_size if died.exists() else 0
        if count < 1:
            died.write_text("x" * (count + 1))
            os._exit(1)
        return [count]

    monkeypatch.setenv("DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES", "0")
    monkeypatch.setattr(worker_pool, "run_chunk", sent_by_value(kill_one))
    with cluster(1) as lab, open_worker_pool(lab.address, None) as pool:
        results = list(pool.run([("key", None)]))  # pyright: ignore[reportArgumentType]
    assert results == [("key", [1])]


def test_a_local_worker_that_is_lost_at_its_start_is_replaced(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Client(contextlib.nullcontext[Any]):
        def __enter__(self) -> Any:
            self.joined = {"one": 1}
            return self

        def nthreads(self) -> dict[str, int]:
            return self.joined

        def wait_for_workers(self, count: int, timeout: float) -> None:
            if not replaced:
                raise TimeoutError
            self.joined = {str(number): 1 for number in range(count)}

    class LocalCluster:
        def scale(self, count: int) -> None:
            replaced.append(count)

    replaced = list[int]()

    monkeypatch.setattr(
        worker_pool.DASK, "LocalCluster", lambda **_: contextlib.nullcontext(LocalCluster())
    )
    monkeypatch.setattr(worker_pool.DASK, "Client", Client)
    with open_worker_pool(None, 2) as pool:
        assert pool.count == 2 and replaced == [2]


def test_missing_local_workers_raise_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    class ClusterWithoutWorkers:
        def nthreads(self) -> dict[str, int]:
            return {}

        def wait_for_workers(self, count: int, timeout: float) -> None:
            raise TimeoutError

        def scale(self, count: int) -> None:
            """Start nothing."""

    empty = contextlib.nullcontext(ClusterWithoutWorkers())
    monkeypatch.setattr(worker_pool.DASK, "LocalCluster", lambda **_: empty)
    monkeypatch.setattr(worker_pool.DASK, "Client", lambda _: empty)
    with (
        pytest.raises(WorkLost, match="no worker of this machine has joined"),
        open_worker_pool(None, 2),
    ):
        pass


PRINT_BLOCKED = """
import signal
from rcmservo.study.execution.workers import open_worker_pool

def blocked():
    import signal
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])

if __name__ == "__main__":
    with open_worker_pool(None, 2) as pool:
        print(blocked(), *pool._client.run(blocked).values())
"""
"""Print if SIGINT is blocked here and in the workers, from a process that had no child before.

The first child process unblocks SIGINT.
"""


@pytest.mark.slow
def test_local_workers_ignore_ctrl_c_and_this_process_receives_it() -> None:
    words = [sys.executable, "-c", PRINT_BLOCKED]
    assert subprocess.check_output(words, text=True).split() == ["False", "True", "True"]


def test_local_workers_accept_connections_with_their_certificate_on_loopback_only() -> None:
    def find_listening() -> set[Any]:
        family = [psutil.Process(), *psutil.Process().children(recursive=True)]
        return {c.laddr for p in family for c in p.net_connections() if c.status == "LISTEN"}

    before = find_listening()
    with open_worker_pool(None, 1) as pool:
        addresses = find_listening() - before
        address = pool._client.scheduler_info()["address"]  # pyright: ignore[reportPrivateUsage]
        assert len(addresses) >= 2 and {listening.ip for listening in addresses} == {"127.0.0.1"}
        assert address.startswith("tls://127.0.0.1:")
        context = ssl.create_default_context()
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        host, _, port = address.removeprefix("tls://").partition(":")
        with (
            socket.create_connection((host, int(port)), timeout=5.0) as connection,
            pytest.raises((ssl.SSLError, ConnectionResetError)),
            context.wrap_socket(connection) as encrypted,
        ):
            encrypted.sendall(b"hello")
            encrypted.recv(1)


def test_a_request_that_kills_every_worker_raises_an_error(
    address_in_process: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_worker_pool(address_in_process, None) as pool:
        monkeypatch.setattr(worker_pool, "MAX_LOST_WORKERS", 3)
        task = worker_pool.PendingTask("key", None, 3)  # pyright: ignore[reportArgumentType]
        with pytest.raises(WorkLost, match="3 workers died on the same request: died"):
            pool._count_loss(task, ValueError("died"))  # pyright: ignore[reportPrivateUsage]


@pytest.mark.slow
def test_a_user_module_is_sent_to_workers_with_its_source(
    lab: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The workers run in other folders and do not have the module."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    found = []
    for forget in (0.99, 0.9):
        (tmp_path / "least_squares_module.py").write_text(
            USER_MODULE.replace("FORGET", str(forget))
        )
        sys.modules.pop("least_squares_module", None)
        words = [
            "study",
            "--method",
            "least_squares_module:LeastSquares",
            "--count",
            "2",
            "--duration",
            "2.5",
        ]
        folder = tmp_path / f"out-{forget}"
        words += ["--cluster", lab.address, "--out", str(folder), "--no-report"]
        assert main(words) == 0
        found.append(read_rows(folder))
    first, second = found
    assert {row["engine"] for row in first} == {"mujoco"}
    assert first[0]["source"] != second[0]["source"] and len(first[0]["source"]) == 64
    errors = [[row["pose_error_mm"] for row in rows] for rows in found]
    assert errors[0] != errors[1]


def read_rows(folder: Path) -> list[dict[str, object]]:
    from rcmservo.study.execution.store import read_runs

    return read_runs(folder).to_pylist()


@pytest.mark.slow
def test_workers_with_another_rcmservo_are_rejected(tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(Path(rcmservo.__file__).parent, other / "rcmservo")
    law = other / "rcmservo/control/saturated_controller.py"
    law.write_text(f"{law.read_text()}# changed\n")
    with cluster(1) as lab:
        lab.start(1, env={**os.environ, "PYTHONPATH": str(other)})
        lab.wait_for(2)
        words = "1 of 2 workers have another rcmservo than this machine"
        with pytest.raises(PackageMismatch, match=words), open_worker_pool(lab.address, None):
            pass


def test_workers_without_rcmservo_are_rejected(
    address_in_process: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail() -> str:
        raise ModuleNotFoundError("No module named 'rcmservo'")

    installed = worker_pool.identify_package
    monkeypatch.setattr(worker_pool, "identify_package", fail)
    with worker_pool._connect(address_in_process) as client:  # pyright: ignore[reportPrivateUsage]
        packages = client.run(fail, on_error="return")
    assert all(isinstance(found, ModuleNotFoundError) for found in packages.values())

    class ClientWithoutPackage:
        def run(self, *arguments: object, **options: object) -> dict[str, object]:
            return packages

    monkeypatch.setattr(worker_pool, "identify_package", installed)
    with pytest.raises(PackageMismatch, match="has none"):
        worker_pool._require_same_package(ClientWithoutPackage())  # pyright: ignore[reportPrivateUsage]


@pytest.mark.parametrize(
    ("address", "message"),
    [
        (
            "tcp://192.0.2.7:8786",
            "everyone who connects to a scheduler can run code on its workers",
        ),
        ("192.0.2.7:8786", "or on the loopback interface"),
        ("nowhere", "the address of a dask scheduler, such as tls://host:8786"),
        ("http://127.0.0.1:8786", "the address of a dask scheduler"),
        ("tcp://127.0.0.1:port", "the address of a dask scheduler"),
        ("tcp://no.such.host.invalid:8786", "a host with an address"),
        ("tcp://127.0.0.1:9", "the address of a dask scheduler that answers"),
        ("tls://127.0.0.1:9", "docs/cluster.md); it lacks ca-file, client.cert, client.key"),
        ("tcp://host..name:8786", "a host with an address"),
    ],
)
def test_an_unusable_cluster_raises_one_error(
    address: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker_pool, "WORKER_TIMEOUT_S", 0.5)
    with pytest.raises(BadInput, match="--cluster") as raised, open_worker_pool(address, None):
        pass
    assert message in str(raised.value) and "\n" not in str(raised.value)


@pytest.mark.slow
def test_a_scheduler_without_workers_raises_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    with cluster(0) as lab:
        monkeypatch.setattr(worker_pool, "WORKER_TIMEOUT_S", 1.0)
        with (
            pytest.raises(RcmServoError, match="no worker has joined"),
            open_worker_pool(lab.address, None),
        ):
            pass


@pytest.mark.slow
def test_a_scheduler_that_disconnects_raises_an_error_and_finished_chunks_remain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The time-out limits the attempts to reconnect as well."""
    finished: list[int] = []
    with contextlib.ExitStack() as stack:
        lab = stack.enter_context(cluster(1))
        lab.wait_for(1)
        monkeypatch.setattr(worker_pool, "WORKER_TIMEOUT_S", 2.0)
        pool = stack.enter_context(open_worker_pool(lab.address, None))
        work = StudyExecution(make_small_plan(count=5000, duration=1.2), tmp_path)

        def progress(runs: int) -> None:
            finished.append(runs)
            if len(finished) == 3:
                lab.stop()

        with pytest.raises(WorkLost, match=r"scheduler at .* has disconnected"):
            work.run(pool, progress)
    left = StudyExecution(make_small_plan(count=5000, duration=1.2), tmp_path)
    assert left.missing_runs <= left.plan.runs - sum(finished)


@pytest.mark.slow
def test_a_cluster_over_tls_uses_the_certificates_of_dasks_configuration(tmp_path: Path) -> None:
    from dask import config
    from distributed.security import Security

    temporary = Security.temporary()
    files = {
        "--tls-ca-file": ("ca.pem", temporary.tls_ca_file),
        "--tls-cert": ("cert.pem", temporary.tls_scheduler_cert),
        "--tls-key": ("key.pem", temporary.tls_scheduler_key),
    }
    for name, text in files.values():
        (tmp_path / name).write_text(str(text))
    tls = {option: str(tmp_path / name) for option, (name, _) in files.items()}
    comm = "distributed.comm.tls"
    keys = {
        f"{comm}.ca-file": tls["--tls-ca-file"],
        f"{comm}.client.cert": tls["--tls-cert"],
        f"{comm}.client.key": tls["--tls-key"],
    }
    with cluster(1, tls) as lab:
        assert lab.address.startswith("tls://")
        with pytest.raises(BadInput, match="--cluster"), open_worker_pool(lab.address, None):
            pass
        with config.set(keys), open_worker_pool(lab.address, None) as pool:
            rows = run_on(pool, tmp_path / "cluster", count=20)
    assert rows == run_here(tmp_path / "here", count=20)


@pytest.mark.slow
def test_ctrl_c_keeps_finished_chunks_and_the_same_command_resumes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command resumes in this process, because new workers take seconds to start."""
    folder = tmp_path / "study"
    code = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
    code += "from rcmservo.__main__ import main; sys.exit(main())"
    words = ["study", "--count", "400", "--no-report", "--duration", "1.2", "--workers", "1"]
    words += ["--out", str(folder)]
    with subprocess.Popen(
        [sys.executable, "-c", code, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    ) as study:
        while study.poll() is None and len(list(folder.glob("parts/*.parquet"))) < 1:
            threading.Event().wait(0.02)
        os.killpg(study.pid, signal.SIGINT)
        out, err = (stream.decode() for stream in study.communicate(timeout=60))
    assert study.returncode == 130, err
    assert f"the same command with --out {folder} resumes there" in out
    assert err.strip() == "rcmservo: stopped by Ctrl-C"
    done = len(list(folder.glob("parts/*.parquet")))
    assert 1 <= done < 4
    pool = contextlib.nullcontext(InProcessPool())
    monkeypatch.setattr(worker_pool, "open_worker_pool", lambda *_: pool)
    assert main(words) == 0
    assert f"{100 * done} runs exist already" in capsys.readouterr().out
    assert len(read_rows(folder)) == 400
