"""Row of a study's table: the columns of runs.parquet, each with unit and meaning."""

import platform
from dataclasses import dataclass, field, fields
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from rcmservo.control.saturated_controller import scale_rows
from rcmservo.interfaces import Floats
from rcmservo.loop.run_result import RunResult
from rcmservo.numerics.small_svd import compute_condition
from rcmservo.recording.summary_text import list_result_rows
from rcmservo.safety.causes import Cause
from rcmservo.sim import RigSettings
from rcmservo.sim.ground_truth import compute_true_jacobian_at_joints
from rcmservo.sim.scene import Scene
from rcmservo.sim.scenes.joint_paths import compute_imaged_rcm
from rcmservo.study.plan.conditions import PICTURES
from rcmservo.study.run_outcome import StudyRun

SUCCESS_MM = 1.0
"""Largest pose error of a successful run, mm."""

NEVER_BEGAN = "NEVER_BEGAN"
"""Entry in the column `stop` of a run that never reached SERVO without a stop.

Its target could not be taught, or its frames arrived too late to be used.
"""


def column(meaning: str) -> Any:
    """Return a dataclass field that carries the meaning of a column."""
    return field(metadata={"meaning": meaning})


@dataclass(frozen=True)
class StudyRow:
    """Row of one run. None stands for an unknown value, or for an event that never happened."""

    method: str = column("name of the method in the study")
    scenes: str = column("name of the distribution that the scene was drawn from")
    seed: int = column("seed; with the repetition it fixes all random numbers of the run")
    repetition: int = column("number of the noise sequence in this scene, from 0")
    noise_px: float | None = column("px, standard deviation of a marker coordinate in a frame")
    latency_s: float = column("s from the middle of a frame's exposure to its arrival")
    disturb: str = column("disturbances in the notation of --disturb; empty for none")
    engine: str = column(
        "compiled (compiled plant), mujoco (full simulator) or pictures (with rendered frames)"
    )
    success: bool = column("true if pose_error_mm is at most 1 mm")
    time_to_1mm_s: float | None = column("s until marker 2 was first within 1 mm of the target")
    pose_error_mm: float = column("mm, true error of marker 2, rms over the last second")
    bound_mm: float | None = column("mm, Cramér-Rao bound of pose_error_mm for all frames")
    stop: str = column(
        f"cause of the first stop; empty without a stop, {NEVER_BEGAN} if the run never began"
    )
    stop_s: float | None = column("s, time of the first stop")
    stops: int = column("number of changes to HOLD, PAUSED or FAULT from another phase")
    unnoticed_mm: float = column("mm, largest growth of the true error in SERVO without cause")
    start_error_mm: float = column("mm from marker 2 to the target at the first tick")
    condition: float = column("largest condition number of the scaled J on the straight path")
    focal_px: float = column("px, focal length of the camera")
    distance_mm: float = column("mm from the camera to marker 1 at the start")
    rcm_depth: float = column("depth of the RCM in the camera divided by that of marker 1")
    rejected: int = column("number of draws that were rejected before this scene")
    source: str = column("SHA-256 of the user's module; empty for built-in methods")
    cpu: str = column("processor of the machine that made the run")
    versions: str = column("versions of rcmservo, Python, NumPy, Numba and MuJoCo there")

    @property
    def result(self) -> RunResult:
        """Result of the run by the true error, in the form of any other run."""
        sentences = {
            "": f"marker 2 is more than {SUCCESS_MM:g} mm from the target",
            NEVER_BEGAN: "it never began",
        } | {cause.name: cause.value for cause in Cause}
        return RunResult(
            settled=self.success,
            cause="" if self.success else sentences[self.stop],
            settle_time_s=self.time_to_1mm_s,
            pose_error_mm=self.pose_error_mm,
            bound_mm=self.bound_mm,
            seed=self.seed,
            estimator=self.method,
        )


class RunLabels(Protocol):
    """Part of a row that is known before the run: a cell of a plan, or a compared method."""

    @property
    def method(self) -> str: ...

    @property
    def scenes(self) -> str: ...

    @property
    def repetition(self) -> int: ...

    @property
    def disturb(self) -> tuple[str, ...]: ...

    @property
    def engine(self) -> str: ...

    @property
    def source(self) -> str: ...


COLUMN_MEANINGS = {f.name: str(f.metadata["meaning"]) for f in fields(StudyRow)}


def make_row(labels: RunLabels, settings: RigSettings, run: StudyRun) -> StudyRow:
    """Return the row of a run in the laboratory with these settings."""
    arrival_s, stops = run.first_within(SUCCESS_MM), run.stops
    timing, scene = settings.timing, run.scene
    p1 = scene.body.points(scene.start)[0]
    rcm_depth, marker_depth = scene.optics.depth(np.stack([np.zeros(3), p1]))
    sight_line: Floats = p1 - scene.optics.position
    return StudyRow(
        method=labels.method,
        scenes=labels.scenes,
        seed=run.seed,
        repetition=labels.repetition,
        noise_px=None if labels.engine == PICTURES else float(settings.point_noise),
        latency_s=float(0.5 * timing.exposure + timing.delay),
        disturb=" ".join(labels.disturb),
        engine=labels.engine,
        success=bool(run.pose_error <= SUCCESS_MM),
        time_to_1mm_s=arrival_s if np.isfinite(arrival_s) else None,
        pose_error_mm=run.pose_error,
        bound_mm=run.bound if np.isfinite(run.bound) else None,
        stop=stops[0][1].name if stops else "" if run.began else NEVER_BEGAN,
        stop_s=stops[0][0] if stops else None,
        stops=len(stops),
        unnoticed_mm=run.unnoticed,
        start_error_mm=float(run.error[0]),
        condition=compute_worst_condition(scene),
        focal_px=float(scene.optics.focal),
        distance_mm=float(np.linalg.norm(sight_line)),
        rcm_depth=float(rcm_depth / marker_depth),
        rejected=scene.rejected,
        source=labels.source,
        cpu=read_cpu_name(),
        versions=versions(),
    )


def list_row_texts(row: StudyRow) -> list[tuple[str, str]]:
    """Return the row's result as pairs of title and text, with what only a study measures."""
    first_stop = f"{row.stop} at {row.stop_s:.2f} s" if row.stop_s is not None else "none"
    stops = f"{first_stop} (stops in all: {row.stops})" if row.stops > 1 else first_stop
    titles = {"settle time": f"first within {SUCCESS_MM:g} mm"}
    return [
        *((titles.get(title, title), text) for title, text in list_result_rows(row.result)),
        ("first stop", stops),
        ("unnoticed", f"the error grew by up to {row.unnoticed_mm:.3f} mm while no check spoke"),
    ]


def format_success(row: StudyRow) -> str:
    """Return whether a run of a study succeeded, which is not the settling of a single run."""
    words = "success" if row.success else "no success"
    return f"{words} (error at the end up to {SUCCESS_MM:g} mm)"


def compute_worst_condition(scene: Scene) -> float:
    """Return the largest condition number of the scaled J on the path; inf where J is undefined."""
    body, optics, o_c = scene.body, scene.optics, compute_imaged_rcm(scene.optics)
    jacobians = (compute_true_jacobian_at_joints(body, optics, q, o_c) for q in scene.path)
    return max(float(compute_condition(scale_rows(jacobian))) for jacobian in jacobians)


@cache
def read_cpu_name() -> str:
    """Return the model name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


@cache
def versions() -> str:
    """Return the versions of the packages that determine the numbers of a run."""
    packages = {"rcmservo": _find_version("rcmservo"), "python": platform.python_version()}
    packages |= {name: _find_version(name) for name in ("numpy", "numba", "mujoco-core")}
    return " ".join(f"{name} {number}" for name, number in packages.items())


def _find_version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
