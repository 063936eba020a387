"""Study on a dask cluster whose workers are killed during the run.

    python benchmarks/cluster.py [--scenes 60000] [--every 20]

A dask scheduler and four workers run on this machine; every 20 s one worker is killed by its
process id. The rows must equal those of the same study on two local processes, bit for bit.
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
    """Options of the benchmark."""

    scenes: int = 60_000
    """Number of scenes, large enough for several kills."""
    every: float = 20.0
    """Time (s) between two kills."""
    workers: int = 4
    """Number of worker processes."""


def study(folder: Path, options: Options, *words: str) -> tuple[str, float]:
    """Run a study; return the SHA-256 of its rows and the duration (s)."""
    began = time.monotonic()
    count = ["--count", str(options.scenes)]
    command = [RCMSERVO, "study", *count, "--no-report", "--out", str(folder), *words]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    rows = (folder / "runs.parquet").read_bytes()
    return hashlib.sha256(rows).hexdigest(), time.monotonic() - began


class Killer(threading.Thread):
    """Thread that kills a random worker periodically."""

    def __init__(self, lab: Cluster, every: float) -> None:
        super().__init__(daemon=True)
        self.lab, self.every, self.killed, self.over = lab, every, 0, threading.Event()

    def run(self) -> None:
        chance = random.Random(0)
        while not self.over.wait(self.every):
            if pids := self.lab.pids():
                os.kill(chance.choice(pids), signal.SIGKILL)
                self.killed += 1


def main(options: Options) -> None:
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        with cluster(options.workers) as lab:
            killer = Killer(lab, options.every)
            killer.start()
            distributed, took = study(folder / "cluster", options, "--cluster", lab.address)
            killer.over.set()
        kills = f"{options.workers} workers, {killer.killed} kills"
        print(f"{options.scenes} scenes, {kills}: {took:.0f} s")
        local, took = study(folder / "local", options, "--workers", "2")
        print(f"two local processes: {took:.0f} s")
        print("rows are equal, bit for bit" if local == distributed else "ROWS DIFFER")
        sys.exit(local != distributed or not killer.killed)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
