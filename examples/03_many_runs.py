"""Comparison of gains in the same scenes, with hundreds of simulated closed loops per minute.

python examples/03_many_runs.py [SEEDS]
"""

import sys

import numpy as np

import rcmservo as rs


def study(gain: float) -> rs.study.Study:
    law = rs.SaturatedController(gain=gain)
    return rs.study.Study(rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0), controller=law))


if __name__ == "__main__":
    seeds = range(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
    print(
        f"{len(seeds)} scenes, 15 s each\n"
        "gain   within 1 mm first, median, 95 %   at the end   stopped"
    )
    for gain in (2.0, 6.0, 12.0):
        runs = list(study(gain).runs(seeds))
        median, most = np.percentile([run.first_within(1.0) for run in runs], [50, 95])
        final = np.mean([run.error[-1] <= 1.0 for run in runs])
        stopped = np.mean([len(run.stops) > 0 for run in runs])
        print(f"{gain:4.1f} {median:20.2f} s {most:8.2f} s {final:12.1%} {stopped:9.1%}")
