"""`rig check` of rig files that hold one mistake each: in simulated laboratories, or over TCP.

    python benchmarks/rig_check.py [--seeds N] [--camera gige|mjpeg]

Each mistake must be named after the person was asked, with its settings and no other, and marker 2
must not have gone 2 mm by then. Exit code 1 where one is missed.
"""

import argparse
import sys
import time

from rich.console import Console
from rich.progress import track
from rich.table import Table
from rig_check_emulated import WrongEmulatedLab
from rig_check_lab import MISTAKES, WrongLab

FAR = 2.0
"""mm."""


def main() -> int:
    """Check every mistake with every seed, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0)
    words = "over TCP, with the emulator's camera of this kind; a minute or two each"
    parser.add_argument("--camera", choices=("gige", "mjpeg"), help=words)
    chosen = parser.parse_args()
    seeds = chosen.seeds
    named = dict.fromkeys(MISTAKES, 0)
    farthest = dict.fromkeys(MISTAKES, 0.0)
    asked = dict.fromkeys(MISTAKES, 0)
    began, out = time.monotonic(), Console()
    cases = [(n, s) for s in range(chosen.first, chosen.first + seeds) for n in MISTAKES]
    for name, seed in track(cases, "checking", console=out):
        wrong = MISTAKES[name]
        lab = (
            WrongEmulatedLab(wrong, seed, chosen.camera) if chosen.camera else WrongLab(wrong, seed)
        )
        report = lab.check()
        right = wrong.named(report)
        near = lab.arm.farthest < FAR
        named[name] += right and near
        farthest[name] = max(farthest[name], lab.arm.farthest)
        asked[name] = max(asked[name], len(lab.person.asked))
        if not (right and near):
            out.print(f"{name}, seed {seed}: {report.findings}, {lab.arm.farthest:.2f} mm")
    table = Table("mistake", "named", "marker 2 went at most", "questions at most")
    for name in MISTAKES:
        far = f"{farthest[name]:.2f} mm"
        table.add_row(name, f"{named[name]} of {seeds}", far, str(asked[name]))
    out.print(table)
    whole = f"{sum(named.values())} of {len(cases)}"
    out.print(f"{whole} in {time.monotonic() - began:.0f} s, to {max(farthest.values()):.2f} mm")
    return 0 if sum(named.values()) == len(cases) else 1


if __name__ == "__main__":
    sys.exit(main())
