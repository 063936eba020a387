"""Speed of studies: steps per second, a command with 10,000 scenes, and scaling to two workers.

    python benchmarks/study.py [--scenes 10000] [--rounds 5]

A step is one tick of the servo and ten of the arm; its speed is in CPU time per core, without the
generation of scenes. The command runs with and without the report. Two workers are compared with
two independent processes on the same work. These are wall times and need an idle machine.
"""

import json
import platform
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import tyro

import rcmservo as rs
from rcmservo.study.compiled_engine import CompiledEngine
from rcmservo.study.execution.chunk import ChunkRequest, run_chunk
from rcmservo.study.execution.package_version import identify_package
from rcmservo.study.execution.workers import open_worker_pool
from rcmservo.study.plan.file import StudyFile, make_plan
from rcmservo.study.trial import draw_trial

RCMSERVO = str(Path(sys.executable).with_name("rcmservo"))
SHOWN = 300
LOOPS = 200


@dataclass(frozen=True)
class Options:
    """Options of the benchmark."""

    scenes: int = 10_000
    """Number of scenes of the command's study."""
    rounds: int = 5
    """Number of comparisons of two workers with two processes."""


def steps_per_second() -> float:
    """Return the steps per second of CPU time on one core, over LOOPS loops in ten scenes."""
    engine = CompiledEngine(
        rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0)), teaching_frames=SHOWN
    )
    given = [draw_trial(seed, 0, engine.settings, engine.duration, SHOWN) for seed in range(10)]
    first = [engine.of(seed, *one) for seed, one in enumerate(given)]
    assert max(run.error[-1] for run in first) < 1.0, "a run failed, and its steps are faster"
    began = time.process_time()
    ticks = sum(len(engine.of(k, *given[k % 10]).error) for k in range(LOOPS))
    return ticks / (time.process_time() - began)


def command(scenes: int, *words: str) -> float:
    """Run a study from the command line; return its wall time (s)."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "study"
        line = [RCMSERVO, "study", "--count", str(scenes), "--out", str(out), *words]
        began = time.monotonic()
        subprocess.run(line, check=True, stdout=subprocess.DEVNULL)
        took = time.monotonic() - began
        summary = json.loads((out / "summary.json").read_text())
        success = summary["methods"][0]["success"]
        print(f"  success {100 * success['value']:.2f} %, {summary['pace']}")
        return took


def orders(scenes: int) -> list[ChunkRequest]:
    """Return the chunks of a study."""
    chunks = make_plan(StudyFile(count=scenes), {}).chunks()
    empty = make_plan(StudyFile(), {}).methods[0].archive
    return [
        ChunkRequest(chunk.cell.text, chunk.seeds, identify_package(), empty) for chunk in chunks
    ]


def alone(work: list[ChunkRequest], ready: object, go: object) -> None:
    """Process chunks in an independent process."""
    run_chunk(work[0])
    ready.release()  # pyright: ignore
    go.wait()  # pyright: ignore
    for order in work:
        run_chunk(order)


def two_alone(work: list[ChunkRequest]) -> float:
    """Return the chunks per second of two independent processes with half of the work each."""
    context = get_context("spawn")
    ready, go = context.Semaphore(0), context.Event()
    both = [context.Process(target=alone, args=(work[k::2], ready, go)) for k in range(2)]
    for one in both:
        one.start()
    for _ in both:
        ready.acquire()
    began = time.monotonic()
    go.set()
    for one in both:
        one.join()
    return len(work) / (time.monotonic() - began)


def two_workers(work: list[ChunkRequest]) -> float:
    """Return the chunks per second of two workers of a study."""
    with open_worker_pool(None, 2) as hands:
        warm = [(f"warm-{k}", work[k]) for k in range(4)]
        assert len(list(hands.run(warm))) == 4
        began = time.monotonic()
        count = sum(1 for _ in hands.run([(str(k), one) for k, one in enumerate(work)]))
        return count / (time.monotonic() - began)


def main(options: Options) -> None:
    print(f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}")
    speeds = [steps_per_second() for _ in range(5)]
    listed = ", ".join(f"{speed / 1e6:.2f}" for speed in sorted(speeds))
    print(f"million steps per second and core (CPU time), five times: {listed}")
    print(f"{options.scenes} scenes, no report: {command(options.scenes, '--no-report'):.1f} s")
    print(f"{options.scenes} scenes, report: {command(options.scenes):.1f} s")
    work, ratios = orders(12_000), list[float]()
    for _ in range(options.rounds):
        ratios.append(two_workers(work) / two_alone(work))
    listed = ", ".join(f"{ratio:.2f}" for ratio in sorted(ratios))
    median = np.median(ratios)
    print(f"speed of two workers relative to two processes: {listed}; median {median:.3f}")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
