"""Reading of damaged records: truncated, and with single flipped bits.

    python benchmarks/damage.py [--flips N] [--step BYTES]

Two records, a run of 1.5 s in three stages and one of 0.5 s with frames, are cut at every 1000th
byte; 10,000 random bits are flipped, and each bit of the kind and the length of each MCAP record. A
damaged record may be rejected with a sentence, read up to the damage with a report that data is
missing, or read completely if nothing is missing. All data that is read must equal the written
data, bit for bit. The process may allocate 256 MiB more than at its start.
"""

import argparse
import gc
import resource
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from struct import unpack_from

import numpy as np
from mcap.opcode import Opcode

import rcmservo as rs
from rcmservo.interfaces import Image
from rcmservo.recording import reader
from rcmservo.recording.mcap_recovery import MAGIC
from rcmservo.recording.writer import Recorder
from rcmservo.tracking import PointMarkers

ROOM = 256 * 2**20
HEAD = 9
"""Bytes of the kind and the length of an MCAP record."""

REFUSED, SHORT, WHOLE = (
    "rejected with a sentence",
    "read up to the damage",
    "read completely, nothing missing",
)


@dataclass
class Original:
    """Record before the damage: bytes, content and frames."""

    data: bytes
    rows: reader.Record
    frames: list[tuple[int, Image]]


def original(folder: Path, duration: float, pictures: bool, stages: int = 1) -> Original:
    """Record a simulated run in one or several stages of equal length, with or without frames."""
    settings = replace(rs.sim.RigSettings(), width=160, height=120)
    rig = rs.sim.Rig(1, settings, pictures=False)
    plant = rs.Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    servo = rs.Servo(mechanism=rs.SphericalRcm(), tool=rs.RigidTool(spacing=30.0))
    rig.move_to_target()
    target = rs.teach(plant, frames=5)
    rig.go_home()
    random = np.random.default_rng(0)
    path, state = folder / reader.RECORD, None
    with Recorder(path, {"seed": 1, "settings": {"name": "damage"}}) as recorder:
        for _ in range(stages):
            recorder.begin(servo, target, state)
            for count, tick in enumerate(
                rs.servo_ticks(plant, servo, target, duration / stages, state=state)
            ):
                recorder.write(tick)
                recorder.write_truth(tick.observation.q, tick.state.command.rates, 0.1)
                if pictures and count % 2:
                    noise = random.integers(0, 30, (120, 160, 3)).astype(np.uint8)
                    recorder.write_frame(
                        rs.Frame(count, tick.observation.now, tick.observation.now, image=noise)
                    )
            state = tick.state
    return Original(path.read_bytes(), reader.read_record(path), list(reader.iterate_frames(path)))


def read(path: Path, before: Original) -> str:
    """Read a damaged record and return the outcome; raise `AssertionError` for incorrect data."""
    try:
        rows = reader.read_record(path)
    except rs.UnusableFile as error:
        assert "\n" not in str(error)
        return REFUSED
    whole, count = before.rows, len(rows.time)
    assert count <= len(whole.time)
    assert rows.about == whole.about
    assert rows.time.tobytes() == whole.time[:count].tobytes()
    for name, column in whole.ticks.items():
        found = rows.ticks.get(name, column[:0])  # missing in a record without ticks
        assert found.tobytes() == column[:count].tobytes(), name
    for name, words in whole.words.items():
        assert rows.words[name] == words[:count], name
    for name, column in whole.truth.items():
        known = ~np.isnan(rows.truth[name]).any(axis=1)
        assert count - known.sum() <= 1 or not len(known)
        assert rows.truth[name][known].tobytes() == column[:count][known].tobytes(), name
    assert len(rows.stages) >= sum(stage.first < count for stage in whole.stages)
    for stage, original in zip(rows.stages, whole.stages, strict=rows.complete):
        expected = original.first, original.origin, original.servo
        assert (stage.first, stage.origin, stage.servo) == expected
        assert stage.target.points.tobytes() == original.target.points.tobytes()
    assert rows.complete == (rows.missing == "")
    assert not rows.complete or count == len(whole.time)
    assert _frames(path, before) or not rows.complete
    return WHOLE if rows.complete else SHORT


def _frames(path: Path, before: Original) -> bool:
    """Return whether all frames are present; assert that those present are unchanged."""
    count = 0
    for (exposure, image), (then, written) in zip(
        reader.iterate_frames(path), before.frames, strict=False
    ):
        assert exposure == then
        assert image.tobytes() == written.tobytes()
        count += 1
    return count == len(before.frames)


def cuts(before: Original, step: int) -> Iterator[bytes]:
    """Yield the record cut at each `step`-th byte."""
    for size in range(0, len(before.data), step):
        yield before.data[:size]


def flips(before: Original, count: int, seed: int = 0) -> Iterator[bytes]:
    """Yield the record with one random bit flipped, `count` times."""
    random = np.random.default_rng(seed)
    data = bytearray(before.data)
    for place, bit in zip(
        random.integers(0, len(data), count), random.integers(0, 8, count), strict=True
    ):
        data[place] ^= 1 << bit
        yield bytes(data)
        data[place] ^= 1 << bit


def heads(data: bytes) -> Iterator[int]:
    """Yield the offsets of the MCAP records of the data: header, chunks, indexes and their end."""
    place, kind = len(MAGIC), 0
    while kind != Opcode.DATA_END:
        yield place
        kind, length = unpack_from("<BQ", data, place)
        place += HEAD + length


def head_flips(before: Original) -> Iterator[bytes]:
    """Yield the record with one bit flipped in a kind or a length, for each such bit."""
    data = bytearray(before.data)
    for head in heads(before.data):
        for bit in range(8 * HEAD):
            data[head + bit // 8] ^= 1 << bit % 8
            yield bytes(data)
            data[head + bit // 8] ^= 1 << bit % 8


def judge(name: str, damaged: Iterator[bytes], before: Original, path: Path) -> int:
    """Read all damaged records, print the outcomes, and return the number of failures."""
    outcomes: Counter[str] = Counter()
    longest, failures = 0.0, 0
    for data in damaged:
        path.write_bytes(data)
        started = time.perf_counter()
        try:
            outcomes[read(path, before)] += 1
        except Exception as error:
            failures += 1
            print(f"  FAILED: {error!r}")
        longest = max(longest, time.perf_counter() - started)
    listed = ", ".join(f"{count} {outcome}" for outcome, count in sorted(outcomes.items()))
    print(f"{name}: {listed}; {failures} failed; longest {longest * 1e3:.0f} ms")
    return failures


def limit_memory() -> None:
    """Limit the address space of this process to ROOM bytes more than at present."""
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + ROOM, taken + ROOM))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--flips", type=int, default=10_000)
    parser.add_argument("--step", type=int, default=1000)
    arguments = parser.parse_args()
    failures = 0
    with tempfile.TemporaryDirectory() as folder:
        originals = {}
        for name, duration, pictures, stages in (
            ("run of 1.5 s", 1.5, False, 3),
            ("run of 0.5 s with frames", 0.5, True, 1),
        ):
            place = Path(folder) / name
            place.mkdir()
            originals[name] = original(place, duration, pictures, stages)
        gc.collect()
        limit_memory()
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        path = Path(folder) / "damaged.mcap"
        for name, one in originals.items():
            print(
                f"{name}: {len(one.rows.time)} ticks, {len(one.frames)} frames, {len(one.data)} "
                f"bytes"
            )
            failures += judge("  cut", cuts(one, arguments.step), one, path)
            failures += judge("  one bit of a kind or length flipped", head_flips(one), one, path)
            failures += judge("  one bit flipped", flips(one, arguments.flips), one, path)
        grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    print(f"resident memory grew by {grown:.0f} MiB; {failures} failed")
    sys.exit(failures > 0)


if __name__ == "__main__":
    main()
