"""Mutation test: ten planted faults that the tests must detect.

    python benchmarks/planted_faults.py             the test files named for each fault
    python benchmarks/planted_faults.py --quick     the same without slow tests, as in `make test`

Each fault changes one expression in a copy of the package and runs the tests on that copy. A fault
counts as caught if a test fails. The exit code is 1 if a fault is missed. A whole round takes about
ten minutes on 2 cores, as each copy compiles its own kernels.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
QUICK = ["-m", "not slow"]
TEST_FAILED = 1
"""Exit code of pytest. Others mean that the tests did not run."""


class Fault(NamedTuple):
    """A mistake in one expression of the package."""

    kind: str
    """What is changed."""
    file: str
    """Path below src/rcmservo."""
    old: str
    """The expression."""
    new: str
    """What replaces it."""
    tests: str
    """Files or folders below tests, separated by spaces."""


FAULTS = (
    Fault(
        "sign of the control law, eq. (31)",
        "control/saturated_controller.py",
        "v = -gain * x, -gain * y, -gain * z",
        "v = gain * x, gain * y, gain * z",
        "control/test_controller.py",
    ),
    Fault(
        "slew limit of the gate, twice as wide",
        "safety/gate.py",
        "step = slew * dt * ROUNDING",
        "step = 2.0 * slew * dt * ROUNDING",
        "safety/test_gate.py",
    ),
    Fault(
        "unit of insertion in CRTK messages, mm instead of m",
        "hardware/crtk/messages.py",
        "CRTK_UNITS = np.array([1.0, 1.0, 1e-3])",
        "CRTK_UNITS = np.array([1.0, 1.0, 1.0])",
        "crtk",
    ),
    Fault(
        "order of the markers in a target file",
        "config/target_file.py",
        "points, q = np.array(content.markers_px), np.array(content.joints)",
        "points, q = np.array(content.markers_px[::-1]), np.array(content.joints)",
        "config/test_target_file.py",
    ),
    Fault(
        "watchdog accepts expired commands",
        "safety/watchdog.py",
        "in_time = now <= command.deadline <= now + self.timeout",
        "in_time = command.deadline <= now + self.timeout",
        "safety/test_watchdog.py",
    ),
    Fault(
        "sign of the prediction for the present joints",
        "control/latency_compensation.py",
        "return error - (slope[0] * x + slope[1] * y + slope[2] * z)",
        "return error + (slope[0] * x + slope[1] * y + slope[2] * z)",
        "servo",
    ),
    Fault(
        "derivative of the features of the line through the imaged RCM",
        "geometry/features.py",
        "J[2, k] = (1.0 - is_marker_1) * direction + normal_2 * J[0, k] - J[1, k]",
        "J[2, k] = (1.0 - is_marker_1) * direction + normal_2 * J[0, k] + J[1, k]",
        "geometry/test_derivatives.py servo/test_decisions.py",
    ),
    Fault(
        "marker centre, shifted by 0.3 px",
        "tracking/ball_fit.py",
        "return replace(self, u=self.u + du,",
        "return replace(self, u=self.u + du + 0.3,",
        "tracking",
    ),
    Fault(
        "confidence intervals of 80 instead of 95 %",
        "study/report/statistics.py",
        "CONFIDENCE = 0.95",
        "CONFIDENCE = 0.80",
        "study/test_statistics.py",
    ),
    Fault(
        "page answers to websockets of other origins",
        "page/web/origin_check.py",
        "if (origins or origin_required) and not (len(origins) == 1 and origins[0] in allowed):",
        "if origin_required and not origins:",
        "page/test_websocket_access.py page/test_forged_requests.py",
    ),
)


def main(only: list[str]) -> int:
    missed = [fault for fault in FAULTS if not caught(fault, only)]
    print(f"{len(FAULTS) - len(missed)} of {len(FAULTS)} faults caught")
    return 1 if missed else 0


def caught(fault: Fault, only: list[str]) -> bool:
    """Plant a fault and run its tests; report the first one that fails."""
    with tempfile.TemporaryDirectory() as folder:
        plant(fault, Path(folder))
        tests = [f"tests/{name}" for name in fault.tests.split()]
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-rfE", *only]
        environment = os.environ | {"PYTHONPATH": folder}
        done = subprocess.run(
            [*command, *tests],
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    result = f"caught by {failed[0]:.150}" if failed else f"MISSED: {done.stdout[-300:]}"
    print(f"{fault.kind}: {result}", flush=True)
    return done.returncode == TEST_FAILED


def plant(fault: Fault, folder: Path) -> None:
    """Copy the package into the folder with the fault in it."""
    package = folder / "rcmservo"
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "src/rcmservo", package, ignore=ignored)
    path = package / fault.file
    text = path.read_text()
    if text.count(fault.old) != 1:
        raise SystemExit(
            f"{fault.file} holds {fault.old!r} {text.count(fault.old)} times, not once"
        )
    path.write_text(text.replace(fault.old, fault.new))


if __name__ == "__main__":
    sys.exit(main(QUICK if "--quick" in sys.argv else []))
