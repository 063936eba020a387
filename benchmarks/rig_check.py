"""Success of `rig check` on rig files with one mistake each: simulated, or emulated over TCP.

    python benchmarks/rig_check.py [--seeds N] [--camera gige|mjpeg]

The check must find exactly the settings of each mistake, and marker 2 must travel less than 2 mm.
The exit code is 1 if a case fails.
"""

import argparse
import sys
import time

from rich.console import Console
from rich.progress import track
from rich.table import Table
from rig_check_emulated import FaultyEmulatedLab
from rig_check_lab import MAX_TRAVEL_MM, MISTAKES, FaultyLab


def main() -> int:
    """Check every mistake with every seed, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0)
    words = "over TCP, with an emulated camera of this kind; one or two minutes per case"
    parser.add_argument("--camera", choices=("gige", "mjpeg"), help=words)
    chosen = parser.parse_args()
    seeds = chosen.seeds
    named = dict.fromkeys(MISTAKES, 0)
    farthest = dict.fromkeys(MISTAKES, 0.0)
    question_counts = dict.fromkeys(MISTAKES, 0)
    began, out = time.monotonic(), Console()
    cases = [(n, s) for s in range(chosen.first, chosen.first + seeds) for n in MISTAKES]
    for name, seed in track(cases, "checking", console=out):
        mistake = MISTAKES[name]
        lab = (
            FaultyEmulatedLab(mistake, seed, chosen.camera)
            if chosen.camera
            else FaultyLab(mistake, seed)
        )
        report = lab.check()
        success = mistake.is_found(report) and lab.arm.max_travel < MAX_TRAVEL_MM
        named[name] += success
        farthest[name] = max(farthest[name], lab.arm.max_travel)
        question_counts[name] = max(question_counts[name], len(lab.operator.questions))
        if not success:
            out.print(f"{name}, seed {seed}: {report.findings}, {lab.arm.max_travel:.2f} mm")
    table = Table("mistake", "found", "largest travel of marker 2", "most questions")
    for name in MISTAKES:
        travel = f"{farthest[name]:.2f} mm"
        table.add_row(name, f"{named[name]} of {seeds}", travel, str(question_counts[name]))
    out.print(table)
    total = f"{sum(named.values())} of {len(cases)} found in {time.monotonic() - began:.0f} s"
    out.print(f"{total}, largest travel {max(farthest.values()):.2f} mm")
    return 0 if sum(named.values()) == len(cases) else 1


if __name__ == "__main__":
    sys.exit(main())
