"""Outcome of a run: one type for simulated and live runs, runs on hardware and runs of a study.

What is unknown or does not apply is None, or empty in words, so that
``json.dumps(dataclasses.asdict(result))`` is the file metrics.json.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from rcmservo.interfaces import Floats


def known(value: float) -> float | None:
    """Return a finite number, or None: JSON has no NaN."""
    return float(value) if np.isfinite(value) else None


@dataclass(frozen=True)
class FeatureError:
    """Root mean square of Δy over the last second of a run.

    Parameters
    ----------
    s_rad : float or None
        Error of s, the imaged tool's angle.
    r_px : float or None
        Error of r, marker 1's distance from the imaged RCM.
    d_px : float or None
        Error of d, the imaged markers' distance from each other.
    """

    s_rad: float | None = None
    r_px: float | None = None
    d_px: float | None = None


@dataclass(frozen=True)
class JacobianError:
    """‖Ĵ − J‖/‖J‖ of the scaled Jacobians, by the simulation's truth.

    Parameters
    ----------
    explored : float or None
        When exploration ended.
    final : float or None
        At the end of the run.
    """

    explored: float | None = None
    final: float | None = None


@dataclass(frozen=True)
class ExplorationCost:
    """Time and motion that exploration took.

    Parameters
    ----------
    time_s : float or None
        When it ended; None where it did not.
    path_mm : float or None
        Length of marker 1's path, by the simulation's truth.
    max_excursion_mm : float or None
        Largest distance of marker 1 from its start, by the simulation's truth.
    """

    time_s: float | None = None
    path_mm: float | None = None
    max_excursion_mm: float | None = None


@dataclass(frozen=True)
class Spread:
    """Median, 99th percentile and maximum of a time, ms; None where it never came up.

    Parameters
    ----------
    median : float or None
        Half of the times were no longer.
    p99 : float or None
        99 % of the times were no longer.
    max : float or None
        The longest.
    """

    median: float | None = None
    p99: float | None = None
    max: float | None = None


def spread(times: Floats) -> Spread:
    """Return the spread of times in ns."""
    if not len(times):
        return Spread()
    return Spread(*(float(one) * 1e-6 for one in np.percentile(times, (50, 99, 100))))


@dataclass(frozen=True)
class LoopTiming:
    """Punctuality of a loop.

    Parameters
    ----------
    ticks : int
        Number of ticks.
    late : int or None
        Ticks that came later than by Thresholds.late_share of a period.
    longest_ms : float or None
        Longest time between two ticks; None where there were fewer than two.
    missed : int or None
        Ticks that the loop was not there to begin.
    rate_hz : float or None
        Mean number of ticks a second; None where there were fewer than two.
    lateness_ms : Spread
        From when a tick was due until it began.
    latency_ms : Spread
        From a frame's exposure to the tick that uses it.
    collections : int or None
        Number of garbage collections that stopped the process.
    refused : list[str]
        What the operating system refused, in sentences.
    """

    ticks: int = 0
    late: int | None = None
    longest_ms: float | None = None
    missed: int | None = None
    rate_hz: float | None = None
    lateness_ms: Spread = Spread()
    latency_ms: Spread = Spread()
    collections: int | None = None
    refused: list[str] = field(default_factory=list[str])


@dataclass(frozen=True)
class FrameCounts:
    """Numbers of a camera's frames, as the loop used them.

    Parameters
    ----------
    used : int
        Frames used.
    skipped : int
        Frames passed over, by their numbers.
    rejected : int
        Frames used that the checks did not accept.
    dropped : dict[str, int]
        By reason, the ticks at which the newest frame was not used.
    """

    used: int = 0
    skipped: int = 0
    rejected: int = 0
    dropped: dict[str, int] = field(default_factory=dict[str, int])


@dataclass(frozen=True)
class CameraAccount:
    """Numbers of a camera's frames so far, as its driver counts them.

    Parameters
    ----------
    frames : int
        Frames that were delivered.
    lost : int
        Frames whose numbers were left out: the camera took them, and they never came.
    incomplete : int
        Frames that came with parts missing, or damaged, and were dropped.
    reconnects : int
        Number of times that the camera was opened again.
    uncertainty_ms : float or None
        Uncertainty of exposure times on the computer's clock, ms; None where it is unknown: the
        camera reports no times, or those of another computer's clock.
    trouble : str
        Present fault of the camera, in a sentence; empty where there is none.
    """

    frames: int = 0
    lost: int = 0
    incomplete: int = 0
    reconnects: int = 0
    uncertainty_ms: float | None = None
    trouble: str = ""


@dataclass(frozen=True)
class RunResult:
    """Outcome of a run. ``print`` gives it in one line.

    Parameters
    ----------
    settled : bool
        True if the errors stayed small to the end, with no fault then, at the taught pose; in a
        study, if the true error stayed small.
    cause : str
        Reason why it did not settle; empty where it did.
    remark : str
        Fault at the end that stopped nothing; empty if there was none.
    settle_time_s : float or None
        Time at which the errors became small for good; in a study, at which marker 2 was first
        within 1 mm of the target.
    duration_s : float or None
        Time to the end of the last tick.
    pose_error_mm : float or None
        ‖p₂ − p_d‖ at the end, by the simulation's truth.
    bound_mm : float or None
        Cramér-Rao bound of that error, rms.
    feature_error : FeatureError
        Errors Δy at the end, as the servo measures them.
    jacobian_error : JacobianError
        Errors of Ĵ.
    explore : ExplorationCost
        Time and motion of the exploration.
    target_q : list[float] or None
        Joints at which the target was taught.
    loop : LoopTiming or None
        Punctuality of the loop; None where its process came to no end.
    frames : FrameCounts or None
        Use of the frames.
    camera : CameraAccount or None
        Account of the camera's driver, if it keeps one.
    drive_off : str
        Reason why the arm's drive went off by itself, or is not known to be off; empty where it
        went off in the end as it should.
    simulated : bool
        False on hardware.
    seed : int or None
        Seed of camera, start, target and noise.
    estimator : str
        Name of the estimator on the command line.
    estimator_time_per_frame_s : float or None
        Time that the estimator was given for every frame; None for the real time between frames.
    rejected_scenes : int or None
        Scenes drawn before one in which the target can be reached.
    real_time_factor : float or None
        Simulated over real time.
    resumed : int
        Requests of the scripted operator to resume that the servo followed.
    refused : int
        Requests of the scripted operator to resume that the servo refused.
    shown_again : int
        Times that the scripted operator taught the target again.
    rig : str
        Rig file of the hardware.
    rig_sha256 : str
        SHA-256 of its bytes.
    rig_checked : bool or None
        True if `rig check` had passed for them.
    speed_share : float or None
        Fraction of the full speed that was allowed.
    folder : str
        Folder of the record, its figures and metrics.json.
    not_recorded : str
        Reason why the record ends early; empty where it does not.
    not_filmed : str
        Reason why a run that was to have a video has none.
    not_written : str
        Which of metrics and figures could not be written, and why.
    """

    settled: bool = False
    cause: str = "the run was stopped before its first tick"
    remark: str = ""
    settle_time_s: float | None = None
    duration_s: float | None = None
    pose_error_mm: float | None = None
    bound_mm: float | None = None
    feature_error: FeatureError = FeatureError()
    jacobian_error: JacobianError = JacobianError()
    explore: ExplorationCost = ExplorationCost()
    target_q: list[float] | None = None
    loop: LoopTiming | None = None
    frames: FrameCounts | None = None
    camera: CameraAccount | None = None
    drive_off: str = ""
    simulated: bool = True
    seed: int | None = None
    estimator: str = ""
    estimator_time_per_frame_s: float | None = None
    rejected_scenes: int | None = None
    real_time_factor: float | None = None
    resumed: int = 0
    refused: int = 0
    shown_again: int = 0
    rig: str = ""
    rig_sha256: str = ""
    rig_checked: bool | None = None
    speed_share: float | None = None
    folder: str = ""
    not_recorded: str = ""
    not_filmed: str = ""
    not_written: str = ""

    def unsettled(self, cause: str) -> "RunResult":
        """Return the result of a run that did not settle, for this cause."""
        return replace(self, settled=False, settle_time_s=None, cause=cause)

    def __str__(self) -> str:
        parts = ["arrived" if self.settled else f"not arrived: {self.cause}"]
        if self.pose_error_mm is not None:
            bound = "" if self.bound_mm is None else f" (bound {self.bound_mm:.2f})"
            parts.append(f"error {self.pose_error_mm:.2f} mm{bound}")
        if self.settle_time_s is not None:
            parts.append(f"{self.settle_time_s:.1f} s")
        return ", ".join(parts)
