"""Settling time, pose error and exploration of `rcmservo run --seed N` for N = 0..19.

    python benchmarks/settle.py [SEEDS [ESTIMATOR]]

Each row is the JSON output of the command: rendered frames with noise, 20 ms delay, 30 s, no video.
One process runs on one core, so that the real-time factor is that of one core.
"""

import contextlib
import io
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.cli.cli import main as rcmservo


def row(seed: int, estimator: str) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()) as out:
        arguments = [
            "run",
            "--seed",
            str(seed),
            "--estimator",
            estimator,
            "--no-video",
            "--json",
            "--teaching-frames",
            "30",
        ]
        rcmservo([*arguments, "--out", str(Path(folder) / "run")])
    return json.loads(out.getvalue())


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    estimator = sys.argv[2] if len(sys.argv) > 2 else "dlt"
    print("seed settled time_s  pose_mm  Ĵ explored  final  explore_s  excursion_mm  x real time")
    rows = []
    for seed in range(count):
        r = row(seed, estimator)
        rows.append(r)
        print(
            f"{seed:4d} {r['settled']!s:7} {r['settle_time_s'] or np.nan:6.2f} "
            f"{r['pose_error_mm']:8.3f} "
            f"{r['jacobian_error']['explored'] or np.nan:11.3f} "
            f"{r['jacobian_error']['final'] or np.nan:6.3f} "
            f"{r['explore']['time_s'] or np.nan:10.2f} {r['explore']['max_excursion_mm']:13.2f} "
            f"{r['real_time_factor']:12.2f}  {r['cause']}",
            flush=True,
        )
    settled = [r for r in rows if r["settled"]]
    times, poses = [r["settle_time_s"] for r in settled], [r["pose_error_mm"] for r in rows]
    print(
        f"settled {len(settled)} of {count}; settle time median {np.median(times):.2f} s, worst "
        f"{max(times):.2f} s; "
        f"pose error median {np.median(poses):.3f} mm, worst {max(poses):.3f} mm; longest "
        f"exploration "
        f"{max(r['explore']['time_s'] or np.nan for r in rows):.2f} s and "
        f"{max(r['explore']['max_excursion_mm'] for r in rows):.2f} mm; "
        f"{np.median([r['real_time_factor'] for r in rows]):.1f} x real time (median)"
    )


if __name__ == "__main__":
    main()
