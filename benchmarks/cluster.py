"""Workers that die in mid-study: a dask scheduler and four worker processes on this machine, one of
which is killed every 20 s by its id, until the study ends.

    python benchmarks/cluster.py [--scenes 60000] [--every 20]

The rows must be those of the same study on two processes of this machine, bit for bit.
"""

import hashlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import tyro
from dask_cluster import Cluster, cluster

RCMSERVO = str(Path(sys.executable).with_name("rcmservo"))


@dataclass(frozen=True)
class Options:
    """What is tried."""

    scenes: int = 60_000
    """How many; enough for some workers to die."""
    every: float = 20.0
    """s from death to death."""
    workers: int = 4
    """Processes."""


def study(folder: Path, options: Options, *words: str) -> tuple[str, float]:
    """SHA-256 of the rows of a study, and how long it took, s."""
    began = time.monotonic()
    count = ["--count", str(options.scenes)]
    command = [RCMSERVO, "study", *count, "--no-report", "--out", str(folder), *words]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    rows = (folder / "runs.parquet").read_bytes()
    return hashlib.sha256(rows).hexdigest(), time.monotonic() - began


class Killer(threading.Thread):
    """Kills a worker every so often."""

    def __init__(self, lab: Cluster, every: float) -> None:
        super().__init__(daemon=True)
        self.lab, self.every, self.killed, self.over = lab, every, 0, threading.Event()

    def run(self) -> None:
        chance = random.Random(0)
        while not self.over.wait(self.every):
            if there := self.lab.pids():
                os.kill(chance.choice(there), signal.SIGKILL)
                self.killed += 1


def main(options: Options) -> None:
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        with cluster(options.workers) as lab:
            killer = Killer(lab, options.every)
            killer.start()
            theirs, took = study(folder / "cluster", options, "--cluster", lab.address)
            killer.over.set()
        deaths = f"{options.workers} workers, {killer.killed} of them killed"
        print(f"{options.scenes} scenes, {deaths}: {took:.0f} s")
        ours, took = study(folder / "here", options, "--workers", "2")
        print(f"the same on two processes of this machine: {took:.0f} s")
        print("rows are the same, bit for bit" if ours == theirs else "ROWS DIFFER")
        sys.exit(ours != theirs or not killer.killed)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
