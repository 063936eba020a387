"""How quick studies are: steps a second of a core, 10,000 scenes from the command line with and
without the report, and two workers beside two processes of the same work that know nothing of each
other.

    python benchmarks/study.py [--scenes 10000] [--rounds 5]

A step is one tick of the servo and ten of the arm. Its speed is told in CPU time, the drawing of
scenes left out. The others are wall time, and want the machine to themselves.
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
from rcmservo.study.execution.chunk import ChunkOrder, done
from rcmservo.study.execution.package_version import package
from rcmservo.study.execution.workers import crew
from rcmservo.study.plan.file import StudyFile, plan_of
from rcmservo.study.trial import trial

RCMSERVO = str(Path(sys.executable).with_name("rcmservo"))
SHOWN = 300
LOOPS = 200


@dataclass(frozen=True)
class Options:
    """What is measured."""

    scenes: int = 10_000
    """Of the command's study."""
    rounds: int = 5
    """Of two workers beside two processes, in turns."""


def steps_a_second() -> float:
    """Of a core, in CPU time, over as many loops in ten scenes."""
    study = rs.study.Study(rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0)), shown=SHOWN)
    given = [trial(seed, 0, study.settings, study.duration, SHOWN) for seed in range(10)]
    first = [study.of(seed, *one) for seed, one in enumerate(given)]
    assert max(run.error[-1] for run in first) < 1.0, "steps that do not servo are quicker"
    began = time.process_time()
    ticks = sum(len(study.of(k, *given[k % 10]).error) for k in range(LOOPS))
    return ticks / (time.process_time() - began)


def command(scenes: int, *words: str) -> float:
    """S of wall time of a study from the command line."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "study"
        line = [RCMSERVO, "study", "--count", str(scenes), "--out", str(out), *words]
        began = time.monotonic()
        subprocess.run(line, check=True, stdout=subprocess.DEVNULL)
        took = time.monotonic() - began
        told = json.loads((out / "summary.json").read_text())
        success = told["methods"][0]["success"]
        print(f"  success {100 * success['value']:.2f} %, {told['pace']}")
        return took


def orders(scenes: int) -> list[ChunkOrder]:
    """The work of a study, in chunks."""
    chunks = plan_of(StudyFile(count=scenes), {}).chunks()
    ends = ((chunk, chunk.seeds.start, chunk.seeds.stop) for chunk in chunks)
    empty = plan_of(StudyFile(), {}).methods[0].parcel
    return [ChunkOrder(chunk.cell.text, begin, end, package(), empty) for chunk, begin, end in ends]


def alone(work: list[ChunkOrder], ready: object, go: object) -> None:
    """One process by itself."""
    done(work[0])
    ready.release()  # pyright: ignore
    go.wait()  # pyright: ignore
    for order in work:
        done(order)


def two_alone(work: list[ChunkOrder]) -> float:
    """Chunks a second of two processes that do half of the work each."""
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


def two_workers(work: list[ChunkOrder]) -> float:
    """Chunks a second of a study's two workers."""
    with crew(None, 2) as hands:
        warm = [(f"warm-{k}", work[k]) for k in range(4)]
        assert len(list(hands.done(warm))) == 4
        began = time.monotonic()
        count = sum(1 for _ in hands.done([(str(k), one) for k, one in enumerate(work)]))
        return count / (time.monotonic() - began)


def main(options: Options) -> None:
    print(f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}")
    speeds = [steps_a_second() for _ in range(5)]
    told = ", ".join(f"{speed / 1e6:.2f}" for speed in sorted(speeds))
    print(f"million steps a second and core (CPU time), five times: {told}")
    print(f"{options.scenes} scenes, no report: {command(options.scenes, '--no-report'):.1f} s")
    print(f"{options.scenes} scenes, report: {command(options.scenes):.1f} s")
    work, ratios = orders(12_000), list[float]()
    for _ in range(options.rounds):
        ratios.append(two_workers(work) / two_alone(work))
    told = ", ".join(f"{ratio:.2f}" for ratio in sorted(ratios))
    print(f"two workers beside two processes, in turns: {told}; median {np.median(ratios):.3f}")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
