"""Live loop with emulated devices over TCP, compared with the loop with simulated devices.

    python benchmarks/whole_loop.py [--camera gige|mjpeg] [--seeds N]

For each seed there is one run with emulated devices (`rcmservo emulate galil`, its camera, the
drivers, live tracking and servo) and one with the simulated laboratory, in turns, in wall time.
Each row also shows the longest stall of a processor of this computer, from threads that poll each
millisecond; no software can prevent these stalls. Requirements: all runs settle, the median pose
error is at most 0.5 mm, the lateness p99 at most 1.5 times that of the simulated laboratory, and at
most 0.1 % of the ticks are missed. The exit code is 1 if one does not hold.
"""

import argparse
import contextlib
import os
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from emulated_lab import EmulatedLab

import rcmservo as rs
from rcmservo.config.rig_file import RigDescription
from rcmservo.hardware.device_kinds import prepare_tracker
from rcmservo.live.realtime import request_urgent_priority
from rcmservo.live.supervisor import run_live
from rcmservo.loop.run_result import RunResult
from rcmservo.sim.processes.lab_processes import SimulatedLab
from rcmservo.sim.rig_file import read_rig_settings

DURATION = 15.0
"""Duration (s) of each run."""


@dataclass(frozen=True)
class Row:
    """Result of a run; ``stall`` is the longest stall (ms) of a processor."""

    result: RunResult
    error: float
    stall: float

    @property
    def words(self) -> str:
        r, timing = self.result, self.result.loop
        time_s = f"{r.settle_time_s:5.2f} s" if r.settled else "   -   "
        late = latency = missed = "-"
        if timing is not None:
            late, missed = f"{timing.lateness_ms.p99:.2f}", f"{timing.missed} of {timing.ticks}"
            latency = f"{timing.latency_ms.median:.0f}/{timing.latency_ms.p99:.0f}"
        return (
            f"{time_s} {self.error:7.3f} mm  late p99 {late} ms  missed {missed}  latency "
            f"{latency} ms  stall {self.stall:.0f} ms  {r.cause}"
        )


@contextlib.contextmanager
def stalls(found: list[float]):
    """Append to `found` the longest stall (ms) of each processor, even for a real-time thread."""
    over = threading.Event()

    def watch(processor: int) -> None:
        os.sched_setaffinity(0, {processor})
        request_urgent_priority()
        longest, last = 0.0, time.monotonic()
        while not over.is_set():
            time.sleep(0.001)
            now = time.monotonic()
            longest, last = max(longest, now - last), now
        found.append(longest * 1e3)

    threads = [threading.Thread(target=watch, args=(k,)) for k in os.sched_getaffinity(0)]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        over.set()
        for thread in threads:
            thread.join()


def emulated(seed: int, camera: str, servo: rs.Servo, record: Path) -> Row:
    found: list[float] = []
    with EmulatedLab(seed, camera) as lab, stalls(found):
        result = run_live(lab.session(servo, DURATION, record))
        error = lab.error()
    return Row(result, error, max(found))


def simulated(seed: int, servo: rs.Servo, record: Path) -> Row:
    found: list[float] = []
    lab = RigDescription()
    with SimulatedLab(seed, read_rig_settings(lab)) as bench, stalls(found):
        result = run_live(
            bench.session(servo, prepare_tracker(lab), DURATION, record, frames=30),
            bench.switch_off,
        )
        error = bench.true_error()
    return Row(result, error, max(found))


def judged(rows: dict[str, list[Row]]) -> bool:
    """Print a summary; return whether all requirements hold."""
    emulated_rows = rows["emulated"]
    settled = sum(row.result.settled for row in emulated_rows)
    error = float(np.median([row.error for row in emulated_rows]))
    late = {
        name: float(np.median([r.result.loop.lateness_ms.p99 for r in some if r.result.loop]))
        for name, some in rows.items()
    }
    timings = [row.result.loop for row in emulated_rows if row.result.loop]
    missed = sum(t.missed for t in timings) / max(sum(t.ticks for t in timings), 1)
    ratio = late["emulated"] / late["simulated"]
    print(
        f"settled {settled} of {len(emulated_rows)}; pose error {error:.3f} mm (median); lateness "
        f"p99 {late['emulated']:.2f} ms, {ratio:.2f} times the simulated one; "
        f"{100 * missed:.2f} % of the ticks missed"
    )
    all_settled = settled == len(emulated_rows)
    return all_settled and error <= 0.5 and ratio <= 1.5 and missed <= 0.001


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--camera", choices=("gige", "mjpeg"), default="gige")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    chosen = parser.parse_args()
    lab = RigDescription()
    servo = rs.Servo(mechanism=lab.mechanism, tool=lab.tool, gate=lab.gate)
    servo.warm_up()
    rows: dict[str, list[Row]] = {"emulated": [], "simulated": []}
    with tempfile.TemporaryDirectory() as folder, contextlib.suppress(KeyboardInterrupt):
        for seed in range(chosen.first, chosen.first + chosen.seeds):
            for name in sorted(rows, reverse=seed % 2 == 1):
                record = Path(folder) / f"{name}{seed}.mcap"
                if name == "emulated":
                    row = emulated(seed, chosen.camera, servo, record)
                else:
                    row = simulated(seed, servo, record)
                rows[name].append(row)
                print(f"seed {seed} {name:9} {row.words}", flush=True)
    if not rows["simulated"]:
        return 1
    return 0 if judged(rows) else 1


if __name__ == "__main__":
    sys.exit(main())
