"""One run of a study as a row: the columns of runs.parquet, each with its unit and meaning."""

import platform
from dataclasses import dataclass, field, fields
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.control.saturated_controller import scaled
from rcmservo.interfaces import Floats
from rcmservo.loop.run_result import RunResult
from rcmservo.numerics.small_svd import condition
from rcmservo.safety.causes import Cause
from rcmservo.sim import RigSettings
from rcmservo.sim.ground_truth import compute_feature_jacobian
from rcmservo.sim.scene import Scene
from rcmservo.sim.scenes.joint_paths import compute_imaged_rcm
from rcmservo.study.plan.cell import Cell
from rcmservo.study.plan.conditions import PICTURES
from rcmservo.study.run_outcome import StudyRun

NEAR = 1.0
"""mm of pose error up to which a run is a success."""

NEVER = "NEVER_BEGAN"
"""What is told instead of a stop of a run whose target could not be taught, or whose frames came
too late for anything to be made of them."""


def column(meaning: str) -> Any:
    """A column, and what it tells."""
    return field(metadata={"meaning": meaning})


@dataclass(frozen=True)
class StudyRow:
    """One run. None is what is not known, or never came."""

    method: str = column("what was tried, by its name in the study")
    scenes: str = column("the distribution that the scene was drawn from")
    seed: int = column("all chance of the run comes from it, and from the repetition")
    repetition: int = column("which noise of this scene")
    noise_px: float | None = column("px, standard deviation of a marker's coordinate in a frame")
    latency_s: float = column("s from the middle of a frame's exposure to its arrival")
    disturb: str = column("what went wrong, as --disturb has it; empty where nothing did")
    engine: str = column(
        "compiled (the twin), mujoco (the live path's code) or pictures (the same)"
    )
    success: bool = column("whether pose_error_mm is at most 1 mm")
    time_to_1mm_s: float | None = column("s until marker 2 was first within 1 mm of the target")
    pose_error_mm: float = column("mm of marker 2, true, root mean square over the last second")
    bound_mm: float | None = column("mm, rms: the Cramér-Rao bound of that, all frames of the run")
    stop: str = column(
        f"cause of the first stop; empty where the run never stopped, {NEVER} where it never began"
    )
    stop_s: float | None = column("s at which that was")
    stops: int = column("how often the run stopped: HOLD, PAUSED or FAULT after none of them")
    unnoticed_mm: float = column("mm by which the true error grew while servoing, no cause named")
    start_error_mm: float = column("mm of marker 2 from the target at the first tick")
    condition: float = column("of the scaled Jacobian, the largest on the straight way")
    focal_px: float = column("px, the camera's focal length")
    distance_mm: float = column("mm from the camera to the tool's marker 1 at the start")
    rcm_depth: float = column("depth of the RCM before the camera, in units of marker 1's")
    rejected: int = column("draws that did not suit before this scene did")
    source: str = column("SHA-256 of the user's own module; empty for built-in methods")
    cpu: str = column("the processor that made the run")
    versions: str = column("of rcmservo, Python, NumPy, Numba and MuJoCo there")

    @property
    def result(self) -> RunResult:
        """Result of the run by the truth, as of any other run."""
        why = self.stop if self.stop in ("", NEVER) else Cause[self.stop].value
        words = {"": f"marker 2 is more than {NEAR:g} mm from the target", NEVER: "it never began"}
        return RunResult(
            settled=self.success,
            cause="" if self.success else words.get(why, why),
            settle_time_s=self.time_to_1mm_s,
            pose_error_mm=self.pose_error_mm,
            bound_mm=self.bound_mm,
            seed=self.seed,
            estimator=self.method,
        )


MEANINGS = {f.name: str(f.metadata["meaning"]) for f in fields(StudyRow)}


def row_of(cell: Cell, settings: RigSettings, run: StudyRun) -> StudyRow:
    """The row of a run of a cell."""
    first, stops, timing, scene = run.first_within(NEAR), run.stops, settings.timing, run.scene
    depths = scene.optics.depth(np.stack([np.zeros(3), scene.body.points(scene.start)[0]]))
    away: Floats = scene.body.points(scene.start)[0] - scene.optics.position
    return StudyRow(
        method=cell.method,
        scenes=cell.scenes,
        seed=run.seed,
        repetition=cell.repetition,
        noise_px=None if cell.engine == PICTURES else float(settings.point_noise),
        latency_s=float(0.5 * timing.exposure + timing.delay),
        disturb=" ".join(cell.disturb),
        engine=cell.engine,
        success=bool(run.pose_error <= NEAR),
        time_to_1mm_s=first if np.isfinite(first) else None,
        pose_error_mm=run.pose_error,
        bound_mm=run.bound if np.isfinite(run.bound) else None,
        stop=stops[0][1].name if stops else "" if run.began else NEVER,
        stop_s=stops[0][0] if stops else None,
        stops=len(stops),
        unnoticed_mm=run.unnoticed,
        start_error_mm=float(run.error[0]),
        condition=worst_condition(scene),
        focal_px=float(scene.optics.focal),
        distance_mm=float(np.linalg.norm(away)),
        rcm_depth=float(depths[0] / depths[1]),
        rejected=scene.rejected,
        source=cell.source,
        cpu=cpu(),
        versions=versions(),
    )


def worst_condition(scene: Scene) -> float:
    """The largest condition number of the scaled J on the way to the target; inf where there is
    none.
    """
    o_c = compute_imaged_rcm(scene.optics)
    return max(_condition(scene, q, o_c) for q in scene.path)


def _condition(scene: Scene, q: Floats, o_c: Floats) -> float:
    return float(condition(scaled(compute_feature_jacobian(scene.body, scene.optics, q, o_c))))


@cache
def cpu() -> str:
    """What the processor calls itself."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


@cache
def versions() -> str:
    """Of what decides a run's numbers, here."""
    found = {"rcmservo": _version("rcmservo"), "python": platform.python_version()}
    found |= {name: _version(name) for name in ("numpy", "numba", "mujoco-core")}
    return " ".join(f"{name} {number}" for name, number in found.items())


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
