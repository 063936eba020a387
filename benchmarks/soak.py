"""Timing of a long live run, with rendering and detection at 60 frames/s in parallel.

    python benchmarks/soak.py [--seconds N]

Prints the mean rate of the loop, the lateness of its ticks, missed ticks, the latency from exposure
to command, and garbage collections, each with the requirement for an idle machine; also the time
of the two functions between each decision and the arm. If a run ends early, another one follows.
If the process of the arm was blocked as long as the loop, the whole computer was.
"""

import argparse
import os
import platform
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import rcmservo as rs
from rcmservo.config.rig_file import RigDescription
from rcmservo.hardware.device_kinds import prepare_tracker
from rcmservo.live.loop_statistics import Report
from rcmservo.live.supervisor import run_live
from rcmservo.loop.run_result import RunResult
from rcmservo.numerics.structs import to_row
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Mode, ModeStruct, Phase, TransitionInputs, advance_mode
from rcmservo.sim.processes.lab_processes import SimulatedLab
from rcmservo.sim.rig_file import read_rig_settings

CALLS = 20_000


def each(call: Callable[[], object]) -> tuple[float, float]:
    """Return median and 99th percentile (us) of the time of one call."""
    took = []
    for _ in range(CALLS):
        start = time.perf_counter_ns()
        call()
        took.append(time.perf_counter_ns() - start)
    median, most = np.percentile(took, [50, 99]) * 1e-3
    return float(median), float(most)


def functions(servo: rs.Servo) -> None:
    """Print the times of the transition with two causes, and of the gate."""
    causes, signs = Cause.AGEING.bit | Cause.LATE_TICK.bit, TransitionInputs(True, True, True, True)
    gate, rcm, t = servo.gate, servo.rcm, to_row(servo.thresholds)[0]
    mode: Any = ModeStruct.from_source(Mode(Phase.SERVO)).rows[0]
    last, q, rates = gate.rest(), np.array([0.5, 0.0, 130.0]), np.array([0.1, 0.2, 3.0])
    gate.admit(rates, last, q, rcm, 0)
    advance_mode(mode, causes, signs, 0, 0, t)
    for name, call in (
        ("transition", lambda: advance_mode(mode, causes, signs, 0, 0, t)),
        ("gate", lambda: gate.admit(rates, last, q, rcm, 0)),
    ):
        median, most = each(call)
        print(f"{name:<22} median {median:6.2f} us, 99 % {most:6.2f} us   (requirement: 10 us)")


def show(report: Report) -> None:
    """Print a line every ten seconds."""
    if report.time % 10_000_000_000 == 0:
        print(f"  {report.time * 1e-9:5.0f} s  {report.text}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    print(
        f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}, Python "
        f"{platform.python_version()}"
    )
    print(f"load of the machine before: {os.getloadavg()[0]:.2f}")
    lab = RigDescription()
    servo = rs.Servo(mechanism=lab.mechanism, tool=lab.tool, gate=lab.gate)
    functions(servo)
    left = chosen.seconds
    with (
        tempfile.TemporaryDirectory() as folder,
        SimulatedLab(chosen.seed, read_rig_settings(lab)) as bench,
    ):
        while left >= 1.0:
            record = Path(folder) / f"{left:g}.mcap"
            result = run_live(
                bench.session(servo, prepare_tracker(lab), left, record, frames=30),
                bench.switch_off,
                show,
            )
            print(f"load of the machine: {os.getloadavg()[0]:.2f}")
            judge(result, bench)
            if result.loop is None:
                return
            left -= max(result.loop.ticks / servo.rate, 1.0)


def judge(result: RunResult, bench: SimulatedLab) -> None:
    """Print the results of one run."""
    print(result)
    if result.loop is None:
        return
    loop, late, latency = result.loop, result.loop.lateness_ms, result.loop.latency_ms
    for sentence in loop.refused:
        print(sentence)
    print(f"{'ticks':<22} {loop.ticks}, missed {loop.missed}")
    print(f"{'mean rate':<22} {loop.rate_hz:.4f} Hz   (requirement: 100.00 Hz +- 0.01 %)")
    print(
        f"{'lateness':<22} median {late.median:.3f}, 99 % {late.p99:.3f}, max "
        f"{late.max:.3f} ms   (requirement: 3 ms)"
    )
    print(f"{'exposure to command':<22} median {latency.median:.1f}, 99 % {latency.p99:.1f} ms")
    print(f"{'garbage collections':<22} {loop.collections}   (requirement: 0)")
    print(f"{'pose error':<22} {bench.true_error():.2f} mm")
    gap = np.diff(bench.log.since(0)["wall"]).max() * 1e-6
    print(f"{'arm, last half minute':<22} longest gap in its process {gap:.1f} ms")


if __name__ == "__main__":
    main()
