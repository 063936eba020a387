"""Workers by dask: the same rows on any number of them, whatever dies; a cluster that is not there,
or is another one than it should be, is one sentence.
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
from studies import made, small

import rcmservo
from rcmservo.cli.cli import main
from rcmservo.errors import BadInput, RcmServoError
from rcmservo.study.execution import workers as crews
from rcmservo.study.execution.chunk import OtherPackage
from rcmservo.study.execution.run_study import Work
from rcmservo.study.execution.store import RUNS
from rcmservo.study.execution.workers import Crew, WorkLost, crew

OWN = """
from dataclasses import dataclass
import numpy as np
import rcmservo as rs
from rcmservo.geometry.features import about, features_jacobian

@dataclass(frozen=True)
class Least(rs.Estimator):
    name = "least"
    def init(self):
        return np.zeros((4, 4)), 1e6 * np.eye(4)
    def update(self, memory, tool, sample):
        A, P = memory
        x = np.append(sample.p1, 1.0)
        gain = P @ x / (FORGET + x @ P @ x)
        A = A + np.outer(sample.points.ravel() - A @ x, gain)
        return A, (P - np.outer(gain, P @ x)) / FORGET
    def jacobian(self, memory, tool, sample):
        return features_jacobian(about(sample.points, sample.o_c)) @ memory[0][:, :3]
"""


@pytest.fixture(scope="module")
def lab() -> Generator[Cluster]:
    with cluster(2) as lab:
        lab.wait_for(2)
        yield lab


def rows_by(
    folder: Path, hands: Crew, progress: Callable[[int], None] = lambda _: None, **choices: object
) -> bytes:
    work = Work(small(**choices), folder)
    work.go(hands, progress)
    work.gather()
    return (folder / RUNS).read_bytes()


def rows_here(folder: Path, **choices: object) -> bytes:
    made(small(**choices), folder).gather()
    return (folder / RUNS).read_bytes()


def test_a_cluster_makes_the_rows_that_this_process_makes(lab: Cluster, tmp_path: Path) -> None:
    with crew(lab.address, None) as hands:
        assert hands.count == 2
        theirs = rows_by(tmp_path / "cluster", hands)
    assert theirs == rows_here(tmp_path / "here")


def test_a_worker_that_lacks_the_package_is_told(
    lab: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that joined after all others had been asked which they have."""

    def unknown(order: object) -> None:
        raise ModuleNotFoundError("No module named 'rcmservo'")

    monkeypatch.setattr(crews, "done", sent_by_value(unknown))
    with crew(lab.address, None) as hands:
        work = hands.done([("one", None)])  # pyright: ignore[reportArgumentType]
        with pytest.raises(WorkLost, match="a worker has no rcmservo: No module named 'rcmservo'"):
            list(work)


def sent_by_value(function: Callable[[object], Any]) -> Callable[[object], Any]:
    """A function that workers need not import."""
    function.__module__ = "__main__"
    return function


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 4])
def test_the_rows_are_the_same_on_any_number_of_workers(workers: int, tmp_path: Path) -> None:
    choices = {"count": 40, "methods": ("dlt", "projection", "flow"), "duration": 1.5}
    with crew(None, workers) as hands:
        assert hands.count == workers
        theirs = rows_by(tmp_path / "many", hands, **choices)
    assert theirs == rows_here(tmp_path / "here", **choices)


@pytest.mark.slow
def test_workers_that_die_lose_nothing(tmp_path: Path) -> None:
    """One dies whenever another four orders are done, so that the work comes to its end however
    slow the machine is.
    """
    choices = {"count": 1700, "duration": 15.0, "methods": ("dlt",)}
    killed: list[int] = []
    with cluster(3) as lab, crew(lab.address, None) as hands:
        lab.wait_for(3)
        done = [0]

        def kill(runs: int) -> None:
            done[0] += 1
            if done[0] % 4 == 0 and len(killed) < 4:
                killed.append(lab.pids()[0])
                os.kill(killed[-1], signal.SIGKILL)

        theirs = rows_by(tmp_path / "cluster", hands, kill, **choices)
    assert len(killed) == 4
    assert theirs == rows_here(tmp_path / "here", **choices)


@pytest.mark.slow
def test_an_order_is_given_again_when_dask_gives_it_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask gives it up when four workers have died with it."""

    def kill_five(order: object) -> list[int]:
        import os

        died = tmp_path / "died"
        count = died.stat().st_size if died.exists() else 0
        if count < 5:
            died.write_text("x" * (count + 1))
            os._exit(1)
        return [count]

    monkeypatch.setattr(crews, "done", sent_by_value(kill_five))
    with cluster(1) as lab, crew(lab.address, None) as hands:
        found = list(hands.done([("one", None)]))  # pyright: ignore[reportArgumentType]
    assert found == [("one", [5])]


def test_a_worker_of_its_own_that_is_lost_at_its_start_is_replaced(
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

    class Started:
        def scale(self, count: int) -> None:
            replaced.append(count)

    replaced = list[int]()

    monkeypatch.setattr(crews.DASK, "LocalCluster", lambda **_: contextlib.nullcontext(Started()))
    monkeypatch.setattr(crews.DASK, "Client", Client)
    with crew(None, 2) as hands:
        assert hands.count == 2 and replaced == [2]


def test_that_no_worker_of_its_own_joins_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    class Nobody:
        def nthreads(self) -> dict[str, int]:
            return {}

        def wait_for_workers(self, count: int, timeout: float) -> None:
            raise TimeoutError

        def scale(self, count: int) -> None:
            """In vain."""

    nobody = contextlib.nullcontext(Nobody())
    monkeypatch.setattr(crews.DASK, "LocalCluster", lambda **_: nobody)
    monkeypatch.setattr(crews.DASK, "Client", lambda _: nobody)
    with pytest.raises(WorkLost, match="no worker of this machine has joined"), crew(None, 2):
        pass


HEARS = """
import signal
from rcmservo.study.execution.workers import crew

def blocked():
    import signal
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])

if __name__ == "__main__":
    with crew(None, 2) as hands:
        print(blocked(), *hands._client.run(blocked).values())
"""
"""In a process that has started no other before: the first one unblocks Ctrl-C."""


@pytest.mark.slow
def test_its_own_workers_do_not_hear_ctrl_c_and_this_process_does() -> None:
    words = [sys.executable, "-c", HEARS]
    assert subprocess.check_output(words, text=True).split() == ["False", "True", "True"]


def test_its_own_workers_can_be_reached_from_this_machine_only_and_with_a_certificate() -> None:
    def heard() -> set[Any]:
        here = [psutil.Process(), *psutil.Process().children(recursive=True)]
        return {c.laddr for p in here for c in p.net_connections() if c.status == "LISTEN"}

    before = heard()
    with crew(None, 1) as hands:
        places = heard() - before
        address = hands._client.scheduler_info()["address"]  # pyright: ignore[reportPrivateUsage]
        assert len(places) >= 2 and {place.ip for place in places} == {"127.0.0.1"}
        assert address.startswith("tls://127.0.0.1:")
        anybody = ssl.create_default_context()
        anybody.check_hostname, anybody.verify_mode = False, ssl.CERT_NONE
        host, _, port = address.removeprefix("tls://").partition(":")
        with (
            socket.create_connection((host, int(port)), timeout=5.0) as line,
            pytest.raises((ssl.SSLError, ConnectionResetError)),
            anybody.wrap_socket(line) as secret,
        ):
            secret.sendall(b"hello")
            secret.recv(1)


def test_what_no_worker_survives_is_told(lab: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    with crew(lab.address, None) as hands:

        class Deadly:
            def result(self) -> None:
                raise crews.DASK.KilledWorker("task", None, 3)

        monkeypatch.setattr(crews, "LOSSES", 3)
        given = crews.Given("key", None, 3)  # pyright: ignore[reportArgumentType]
        with pytest.raises(WorkLost, match="every worker that takes it dies"):
            hands._again(given, ValueError("died"))  # pyright: ignore[reportPrivateUsage]


def test_a_users_own_module_travels_with_its_source(
    lab: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The workers stand in folders of their own, and have never seen it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    found = []
    for forget in (0.99, 0.9):
        (tmp_path / "mylab_least.py").write_text(OWN.replace("FORGET", str(forget)))
        sys.modules.pop("mylab_least", None)
        words = ["study", "--method", "mylab_least:Least", "--count", "6", "--duration", "4"]
        folder = tmp_path / f"out-{forget}"
        words += ["--cluster", lab.address, "--out", str(folder), "--no-report"]
        assert main(words) == 0
        found.append(crews_rows(folder))
    one, other = found
    assert {row["engine"] for row in one} == {"mujoco"} and one[0]["source"] != other[0]["source"]
    assert len(one[0]["source"]) == 64
    errors = [[row["pose_error_mm"] for row in rows] for rows in found]
    assert errors[0] != errors[1]


def crews_rows(folder: Path) -> list[dict[str, object]]:
    from rcmservo.study.execution.store import runs_in

    return runs_in(folder).to_pylist()


@pytest.mark.slow
def test_workers_with_another_rcmservo_are_refused(tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(Path(rcmservo.__file__).parent, other / "rcmservo")
    law = other / "rcmservo/control/saturated_controller.py"
    law.write_text(law.read_text().replace("CONDITION = 1e3", "CONDITION = 1e4"))
    with cluster(1) as lab:
        lab.start(1, env={**os.environ, "PYTHONPATH": str(other)})
        lab.wait_for(2)
        words = "1 of 2 workers have another rcmservo than this machine"
        with pytest.raises(OtherPackage, match=words), crew(lab.address, None):
            pass


def test_workers_without_rcmservo_are_refused(
    lab: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nowhere() -> str:
        raise ModuleNotFoundError("No module named 'rcmservo'")

    usual = crews.package
    monkeypatch.setattr(crews, "package", nowhere)
    with crews._reached(lab.address) as client:  # pyright: ignore[reportPrivateUsage]
        told = client.run(nowhere, on_error="return")
    assert all(isinstance(found, ModuleNotFoundError) for found in told.values())

    class ReportTold:
        def run(self, *given: object, **options: object) -> dict[str, object]:
            return told

    monkeypatch.setattr(crews, "package", usual)
    with pytest.raises(OtherPackage, match="has none"):
        crews._require_same_package(ReportTold())  # pyright: ignore[reportPrivateUsage]


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("tcp://192.0.2.7:8786", "whoever reaches a scheduler can run code on its workers"),
        ("192.0.2.7:8786", "or on the loopback interface"),
        ("nowhere", "that of a dask scheduler, such as tls://host:8786"),
        ("http://127.0.0.1:8786", "that of a dask scheduler"),
        ("tcp://127.0.0.1:port", "that of a dask scheduler"),
        ("tcp://no.such.host.invalid:8786", "a host with an address"),
        ("tcp://127.0.0.1:9", "the address of a dask scheduler that answers"),
        ("tls://127.0.0.1:9", "docs/cluster.md); it lacks ca-file, client.cert, client.key"),
        ("tcp://host..name:8786", "a host with an address"),
    ],
)
def test_a_cluster_that_cannot_be_used_is_one_sentence(
    address: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(crews, "PATIENCE", 0.5)
    with pytest.raises(BadInput, match="--cluster") as told, crew(address, None):
        pass
    assert words in str(told.value) and "\n" not in str(told.value)


@pytest.mark.slow
def test_a_scheduler_without_workers_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with cluster(0) as lab:
        monkeypatch.setattr(crews, "PATIENCE", 1.0)
        with pytest.raises(RcmServoError, match="no worker has joined"), crew(lab.address, None):
            pass


@pytest.mark.slow
def test_a_scheduler_that_goes_is_told_and_what_is_done_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted: list[int] = []
    monkeypatch.setattr(crews, "PATIENCE", 5.0)
    with cluster(1) as lab, crew(lab.address, None) as hands:
        work = Work(small(count=5000, duration=15.0), tmp_path)

        def progress(runs: int) -> None:
            counted.append(runs)
            if len(counted) == 3:
                lab.stop()

        with pytest.raises(WorkLost, match=r"scheduler at .* is gone"):
            work.go(hands, progress)
    left = Work(small(count=5000, duration=15.0), tmp_path)
    assert left.runs_left <= left.plan.runs - sum(counted)


@pytest.mark.slow
def test_over_tls_with_the_certificates_of_dasks_own_configuration(tmp_path: Path) -> None:
    from dask import config
    from distributed.security import Security

    made_up = Security.temporary()
    files = {
        "--tls-ca-file": ("ca.pem", made_up.tls_ca_file),
        "--tls-cert": ("cert.pem", made_up.tls_scheduler_cert),
        "--tls-key": ("key.pem", made_up.tls_scheduler_key),
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
        with pytest.raises(BadInput, match="--cluster"), crew(lab.address, None):
            pass
        with config.set(keys), crew(lab.address, None) as hands:
            theirs = rows_by(tmp_path / "cluster", hands, count=20)
    assert theirs == rows_here(tmp_path / "here", count=20)


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_done_and_the_same_command_goes_on(tmp_path: Path) -> None:
    folder = tmp_path / "study"
    code = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
    code += "from rcmservo.__main__ import main; sys.exit(main())"
    words = [sys.executable, "-c", code, "study", "--count", "1500", "--out", str(folder)]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
    ) as study:
        while study.poll() is None and len(list(folder.glob("parts/*.parquet"))) < 3:
            threading.Event().wait(0.02)
        os.killpg(study.pid, signal.SIGINT)
        out, err = (told.decode() for told in study.communicate(timeout=60))
    assert study.returncode == 130, err
    assert f"the same command with --out {folder} resumes there" in out
    assert err.strip() == "rcmservo: stopped by Ctrl-C"
    done = len(list(folder.glob("parts/*.parquet")))
    assert 3 <= done < 15
    again = subprocess.run(words, capture_output=True, text=True, check=True)
    assert f"{100 * done} runs exist already" in again.stdout
    assert len(crews_rows(folder)) == 1500
