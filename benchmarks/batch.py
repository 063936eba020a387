"""Closed loops in scenes drawn from seeds, by the compiled twin of the laboratory: how soon and how
near, with intervals, and how many steps a core makes in a second.

    python benchmarks/batch.py [SCENES [NOISE [ESTIMATOR]]]

15 s each, NOISE px of noise (0.3), 60 frames/s, 20 ms delay, the target shown for 5 s. Shares come
with their Wilson interval of 95 %, quantiles with that of the order statistics. The errors at the
end are also told in units of the Cramér-Rao bound of each scene, with all frames of the 15 s.
"""

import platform
import sys
import time
from collections import Counter

import numpy as np
from scipy.stats import binom, binomtest

import rcmservo as rs
from rcmservo.app.servo_options import ServoOptions
from rcmservo.interfaces import Floats
from rcmservo.sim.rig import drawn
from rcmservo.study import Study, StudyRun
from rcmservo.study.closed_loop import Goal

SHOWN = 300
"""Frames: 5 s."""

FAR = 3.5
"""Times the bound; noise alone leads that far in one scene of thousands."""


def share(count: int, of: int) -> str:
    """A share and its interval."""
    low, high = binomtest(count, of).proportion_ci(method="wilson")
    return f"{100 * count / of:.2f} % ({100 * low:.2f}-{100 * high:.2f})"


def quantile(times: Floats, p: float) -> str:
    """A quantile and its interval; times that never came are infinite."""
    ordered, n = np.sort(times), len(times)
    low, high = (int(binom.ppf(side, n, p)) for side in (0.025, 0.975))
    at = ordered[[min(int(p * n), n - 1), max(low - 1, 0), min(high, n - 1)]]
    return f"{at[0]:.2f} s ({at[1]:.2f}-{at[2]:.2f})"


def speed(study: Study) -> float:
    """Steps a second of one core, the drawing of scenes left out."""
    scene, random = drawn(0, study.settings)
    markers = scene.body.points(scene.target)[:2]
    shown = Goal(scene.optics.project(markers), scene.target, markers[1])
    noise = study.settings.point_noise * random.standard_normal((1000, 2, 2))
    first = study.of(0, scene, shown, noise)
    assert first.error[-1] < 5.0, "steps of a loop that does not servo are quicker"
    start = time.perf_counter()
    ticks = sum(len(study.of(0, scene, shown, noise).error) for _ in range(20))
    return ticks / (time.perf_counter() - start)


def print_bound(final: Floats, least: Floats) -> None:
    """The errors at the end beside the bound on each."""
    if not least.all():
        return
    ratio, held = final / least, final <= np.maximum(1.0, FAR * least)
    rms = np.sqrt(np.mean(ratio[held] ** 2))
    print(f"within 1 mm or {FAR:g} x bound    {share(int(held.sum()), len(held))}")
    print(f"of these, error / bound      rms {rms:.2f}, median {np.median(ratio[held]):.2f}")


def report(runs: list[StudyRun]) -> None:
    """The rows of a study."""
    count, first = len(runs), np.array([run.first_within(1.0) for run in runs])
    final = np.array([run.error[-1] for run in runs])
    quiet = np.array([not run.stops for run in runs])
    for p in (0.5, 0.95, 0.99):
        print(f"first within 1 mm, {100 * p:.0f} %       {quantile(first, p)}")
    print(f"within 1 mm at the end       {share(int((final <= 1.0).sum()), count)}")
    print(f"that, and without a stop     {share(int(((final <= 1.0) & quiet).sum()), count)}")
    print_bound(final, np.array([run.bound for run in runs]))
    print(f"error at the end             median {np.median(final):.3f} mm, worst {final.max():.2f}")
    causes = Counter(run.stops[0][1].name for run in runs if run.stops)
    print(f"first stops                  {dict(causes.most_common())}")


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    noise = float(sys.argv[2]) if len(sys.argv) > 2 else 0.3
    settings = rs.sim.RigSettings(point_noise=noise)
    name = sys.argv[3] if len(sys.argv) > 3 else "dlt"
    estimator = ServoOptions().estimator(name)
    servo = rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0), estimator)
    study = Study(servo, settings, shown=SHOWN)
    print(f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}")
    print(f"steps a second and core      {speed(study):.0f}")
    start, runs = time.perf_counter(), list[StudyRun]()
    try:
        for run in study.runs(range(count)):
            runs.append(run)
            print(f"\r{len(runs)} of {count}", end="", file=sys.stderr, flush=True)
    except KeyboardInterrupt:
        print("\nstopped", file=sys.stderr)
    print(file=sys.stderr)
    print(f"{len(runs)} scenes, {noise:g} px, {name}  in {time.perf_counter() - start:.0f} s")
    if runs:
        report(runs)


if __name__ == "__main__":
    main()
