"""What becomes of a simulated run, in numbers."""

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rcmservo.app.simulated_run.job import Job
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.run import Tick
from rcmservo.record.verdict import LAST, Judge
from rcmservo.record.writer import Recorder
from rcmservo.sim import Rig

METRICS = "metrics.json"


@dataclass
class _Explored:
    """What exploration cost, by the truth: when it ended, the path of marker 1 and how far it
    went."""

    time: float | None = None
    error: float | None = None
    path: float = 0.0
    farthest: float = 0.0
    places: list[Floats] = field(default_factory=list[Floats])

    def add(self, tick: Tick, p1: Floats, error: float) -> None:
        if self.time is not None:
            return
        if self.places:
            self.path += float(np.linalg.norm(p1 - self.places[-1]))
            self.farthest = max(self.farthest, float(np.linalg.norm(p1 - self.places[0])))
        self.places.append(p1)
        if tick.state.explored:
            self.time, self.error = tick.time / 1e9, error


class Notes:
    """What becomes of a run, tick by tick: the verdict, by the truth how far off pose and Ĵ are,
    and the timing."""

    def __init__(self, job: Job, rig: Rig, target: Target) -> None:
        self._job, self._rig, self._p_d = job, rig, rig.body.points(rig.scene.target)[1]
        self._judge, self._explored = Judge(job.servo, target), _Explored()
        self._pose_errors: list[float] = []
        self._latencies: list[int] = []
        self._late, self._frame, self._jacobian_error = 0, -1, np.nan
        self._started = time.perf_counter()

    def add(self, tick: Tick, recorder: Recorder) -> None:
        """One tick more: note it, and record it with the truth beside it."""
        rig, state = self._rig, tick.state
        markers = rig.truth.markers(rig.clock.now())
        error = rig.truth.jacobian_error(state.J_hat, tick.seen.q_exposure, state.o_c)
        recorder.write(tick)
        recorder.write_truth(markers[0], markers[1], error)
        self._judge.add(tick)
        self._explored.add(tick, markers[0], error)
        self._pose_errors.append(float(np.linalg.norm(markers[1] - self._p_d)))
        self._jacobian_error = error
        self._late += state.watch.late > 0
        if tick.seen.frame > self._frame:
            self._frame = tick.seen.frame
            self._latencies.append(state.watch.latency)

    def metrics(self) -> dict[str, Any]:
        """The run in numbers."""
        job, outcome, explored = self._job, self._judge.outcome(), self._explored
        pose = np.array(self._pose_errors[-round(LAST * job.servo.rate) :])
        p50, p99 = (
            np.percentile(self._latencies, [50, 99]) * 1e-9 if self._latencies else (np.nan, np.nan)
        )
        return {
            "seed": job.seed,
            "estimator": job.name,
            "settled": outcome.settled,
            "cause": outcome.cause,
            "settle_time_s": outcome.settle_time if outcome.settled else None,
            "pose_error_mm": _number(np.sqrt(np.mean(pose**2))) if len(pose) else None,
            "feature_error": dict(
                zip(("s_rad", "r_px", "d_px"), map(_number, outcome.error), strict=True)
            ),
            "jacobian_error": {"explored": explored.error, "final": _number(self._jacobian_error)},
            "explore": {
                "time_s": explored.time,
                "path_mm": explored.path,
                "max_excursion_mm": explored.farthest,
            },
            "estimator_time_per_frame_s": getattr(job.servo.estimator, "estimator_time", 0.0)
            or None,
            "latency_s": {"median": _number(p50), "p99": _number(p99)},
            "late_ticks": self._late,
            "real_time_factor": self._judge.duration / (time.perf_counter() - self._started),
            "rejected_scenes": self._rig.scene.rejected,
            "folder": str(job.folder),
        }


def _number(value: Any) -> float | None:
    """A finite number, or None: JSON has no NaN."""
    return float(value) if np.isfinite(value) else None
