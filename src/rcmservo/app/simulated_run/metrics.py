"""What became of a simulated run, in numbers. All that its record tells is taken from there, as
`show` does."""

from dataclasses import dataclass, replace

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.record.reader import Record
from rcmservo.record.timeline import RunSummary, rate, summary
from rcmservo.record.verdict import LAST

METRICS = "metrics.json"
"""The metrics' name in the folder of a run."""


@dataclass(frozen=True)
class FeatureError:
    """The root mean square of Δy over the last second; None where it is not known."""

    s_rad: float | None = None
    """Of s, the imaged tool's angle."""
    r_px: float | None = None
    """Of r, marker 1's distance from the imaged RCM."""
    d_px: float | None = None
    """Of d, the imaged markers' distance from each other."""


@dataclass(frozen=True)
class JacobianError:
    """‖Ĵ − J‖/‖J‖, scaled, by the simulation's truth."""

    explored: float | None = None
    """When exploration ended."""
    final: float | None = None
    """At the end of the run."""


@dataclass(frozen=True)
class ExplorationCost:
    """What exploration took, by the simulation's truth."""

    time_s: float | None = None
    """When it ended; None where it did not."""
    path_mm: float = 0.0
    """The length of marker 1's path."""
    max_excursion_mm: float = 0.0
    """How far marker 1 went from its start."""


@dataclass(frozen=True)
class Latency:
    """Time from a frame's exposure to the tick that uses it, s; None where no frame was used."""

    median: float | None = None
    """Half of the times were no longer."""
    p99: float | None = None
    """The 99th percentile."""


@dataclass(frozen=True)
class RunMetrics:
    """A simulated run in numbers: what metrics.json holds, by the same names."""

    seed: int
    """What camera, start, target and noise were drawn from."""
    estimator: str
    """The estimator's name on the command line."""
    settled: bool = False
    """Whether the errors stayed small to the end, with nothing wrong then."""
    cause: str = "the run was stopped before its first tick"
    """Why it did not settle; empty where it did."""
    remark: str = ""
    """What was not as it should be at the end although nothing stopped; empty if all was."""
    settle_time_s: float | None = None
    """When the errors became small for good; None where they did not."""
    pose_error_mm: float | None = None
    """‖p₂ − p_d‖, root mean square over the last second, by the simulation's truth."""
    feature_error: FeatureError = FeatureError()
    """What is left of Δy."""
    jacobian_error: JacobianError = JacobianError()
    """How far Ĵ is from the true J."""
    explore: ExplorationCost = ExplorationCost()
    """What exploration took."""
    estimator_time_per_frame_s: float | None = None
    """Time that the estimator was given for every frame; None for the real time between frames."""
    latency_s: Latency = Latency()
    """How old the frames are when they are used."""
    late_ticks: int = 0
    """Ticks that came later than by Thresholds.late_share of a period."""
    real_time_factor: float = 0.0
    """Simulated over real time."""
    rejected_scenes: int = 0
    """Scenes that were drawn before one in which the target can be reached."""
    folder: str = ""
    """Where record, figures and these metrics are."""
    resumed: int = 0
    """How often the scripted person resumed."""
    refused: int = 0
    """How often that was refused."""
    shown_again: int = 0
    """How often the person showed the target again."""
    not_recorded: str = ""
    """Why the record ends early; empty where it does not."""
    not_filmed: str = ""
    """Why there is no video of a run that was to have one."""
    not_written: str = ""
    """Which of the metrics and figures could not be written, and why."""


@dataclass(frozen=True, eq=False)
class Unrecorded:
    """What the record of a simulated run does not tell of it."""

    p_d: Floats
    """Where marker 2 was shown, (3,) mm."""
    took: float
    """Real time of the run, s."""
    ended: str
    """What ended the run before its time, in words; empty where nothing did."""


def measured(metrics: RunMetrics, record: Record, beside: Unrecorded) -> RunMetrics:
    """The metrics with what the record tells."""
    told = summary(record)
    outcome, p2 = told.outcome, record.truth["p2"]
    last = round(LAST * rate(record))
    pose: Floats = np.linalg.norm(p2[-last:] - beside.p_d, axis=1)
    explore, jacobian = _exploration(record)
    return replace(
        metrics,
        settled=outcome.settled,
        cause=outcome.cause if outcome.settled else beside.ended or outcome.cause,
        remark=outcome.remark,
        settle_time_s=outcome.settle_time,
        pose_error_mm=number(float(np.sqrt(np.mean(pose**2)))) if len(pose) else None,
        feature_error=FeatureError(*map(number, outcome.error)),
        jacobian_error=jacobian,
        explore=explore,
        latency_s=_latency(told),
        late_ticks=told.late,
        real_time_factor=told.duration / beside.took,
    )


def _exploration(record: Record) -> tuple[ExplorationCost, JacobianError]:
    """What exploration cost, and how far off Ĵ was after it and at the end."""
    p1, errors = record.truth["p1"], record.truth["jacobian_error"][:, 0]
    if not len(p1):
        return ExplorationCost(), JacobianError()
    explored = np.flatnonzero(record.ticks["explored"][:, 0])
    end = int(explored[0]) if len(explored) else None
    places: Floats = p1 if end is None else p1[: end + 1]
    start: Floats = places[0]
    cost = ExplorationCost(
        None if end is None else float(record.time[end]),
        float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum()),
        float(np.linalg.norm(places - start, axis=1).max()),
    )
    return cost, JacobianError(None if end is None else number(errors[end]), number(errors[-1]))


def _latency(told: RunSummary) -> Latency:
    median, p99, _ = told.latency
    return Latency(number(median), number(p99))


def number(value: float) -> float | None:
    """A finite number, or None: JSON has no NaN."""
    return float(value) if np.isfinite(value) else None
