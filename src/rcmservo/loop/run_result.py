"""Result of a run, whether it is simulated, live, on hardware or part of a study.

Unknown numbers are None and unknown texts are empty, so that
``json.dumps(dataclasses.asdict(result))`` gives the content of the file metrics.json.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from rcmservo.interfaces import Floats


def finite_or_none(value: float) -> float | None:
    """Return a finite number, or None: JSON has no NaN."""
    return float(value) if np.isfinite(value) else None


@dataclass(frozen=True)
class FeatureError:
    """Root mean square of the feature errors Δy = (Δs, Δr, Δd) over the last second of a run.

    Parameters
    ----------
    s_rad : float or None
        Error of s, the angle of the tool in the image, rad.
    r_px : float or None
        Error of r, the distance of marker 1 from the imaged RCM, px.
    d_px : float or None
        Error of d, the distance of the markers from each other in the image, px.
    """

    s_rad: float | None = None
    r_px: float | None = None
    d_px: float | None = None


@dataclass(frozen=True)
class JacobianError:
    """Relative error ‖Ĵ − J‖/‖J‖ of the scaled Jacobian, by the simulation's ground truth.

    Parameters
    ----------
    explored : float or None
        Error at the end of exploration.
    final : float or None
        Error at the end of the run.
    """

    explored: float | None = None
    final: float | None = None


@dataclass(frozen=True)
class FinalPose:
    """Position of marker 2 at the end of a run, and its distance from the taught one.

    Neither distance is the true one. That by the image is what the servo itself reduces: at rest it
    is small even if the image is biased. That by the joints does not show backlash, bending or a
    moved port.

    Parameters
    ----------
    p2_mm : list[float] or None
        Position (3,) from the RCM by the joints, mm.
    by_joints_mm : float or None
        Distance from its position at the taught joints, mm.
    by_image_mm : float or None
        Distance ‖∂p₂/∂p₁ Ĵ⁻¹ Δy‖ of the mean feature error over the last second, mm; None before
        the end of exploration.
    by_image_std_mm : float or None
        Standard deviation of this distance by the scatter of Δy, mm. It does not contain the error
        of Ĵ.
    bound_mm : float or None
        True distance that is kept with 95 % by the servo's own estimate, mm: from the noise of the
        markers and the errors of arm and tool that their residuals on the way show. None unless the
        tool has arrived.
    limit : str
        What contributes most to this bound; empty if unknown.
    """

    p2_mm: list[float] | None = None
    by_joints_mm: float | None = None
    by_image_mm: float | None = None
    by_image_std_mm: float | None = None
    bound_mm: float | None = None
    limit: str = ""


@dataclass(frozen=True)
class DriveResponse:
    """Response of each drive to the joint rates that the arm applied.

    A joint that hardly moved has None.

    Parameters
    ----------
    gain : list[float | None]
        Measured motion (3,) divided by the applied one; 1 for a drive that follows completely.
    lag_ms : list[float | None]
        Time (3,) by which the measured motion follows the applied one, ms, in steps of 5 ms.
    """

    gain: list[float | None]
    lag_ms: list[float | None]


@dataclass(frozen=True)
class ExplorationCost:
    """Time and motion that exploration took.

    Parameters
    ----------
    time_s : float or None
        Time at which exploration ended; None if it did not end.
    path_mm : float or None
        Length of the path of marker 1, by the simulation's ground truth.
    max_excursion_mm : float or None
        Largest distance of marker 1 from its start, by the simulation's ground truth.
    """

    time_s: float | None = None
    path_mm: float | None = None
    max_excursion_mm: float | None = None


@dataclass(frozen=True)
class TimeSpread:
    """Median, 99th percentile and maximum of a set of times; None if the set is empty.

    Parameters
    ----------
    median : float or None
        Median, ms.
    p99 : float or None
        99th percentile, ms.
    max : float or None
        Maximum, ms.
    """

    median: float | None = None
    p99: float | None = None
    max: float | None = None


def time_spread(times: Floats) -> TimeSpread:
    """Return median, 99th percentile and maximum in ms of times in ns."""
    if not len(times):
        return TimeSpread()
    return TimeSpread(*(float(time) * 1e-6 for time in np.percentile(times, (50, 99, 100))))


@dataclass(frozen=True)
class LoopTiming:
    """Punctuality of a loop.

    Parameters
    ----------
    ticks : int
        Number of ticks.
    late : int or None
        Number of ticks that began later than `Thresholds.late_tick_fraction` of a period.
    longest_ms : float or None
        Longest time between two ticks; None for fewer than two ticks.
    missed : int or None
        Number of ticks that were skipped because the loop was late.
    rate_hz : float or None
        Mean number of ticks per second; None for fewer than two ticks.
    lateness_ms : TimeSpread
        Time from the scheduled to the actual begin of a tick.
    latency_ms : TimeSpread
        Time from the exposure of a frame to the tick that uses it.
    collections : int or None
        Number of garbage collections that stopped the process.
    refused : list[str]
        Requests that the operating system refused, in sentences.
    """

    ticks: int = 0
    late: int | None = None
    longest_ms: float | None = None
    missed: int | None = None
    rate_hz: float | None = None
    lateness_ms: TimeSpread = TimeSpread()
    latency_ms: TimeSpread = TimeSpread()
    collections: int | None = None
    refused: list[str] = field(default_factory=list[str])


@dataclass(frozen=True)
class FrameCounts:
    """Use of a camera's frames by the loop.

    Parameters
    ----------
    used : int
        Number of frames used.
    skipped : int
        Number of frames that the loop never used, from the gaps between frame numbers.
    rejected : int
        Number of used frames that the checks did not accept.
    dropped : dict[str, int]
        Number of ticks at which the newest frame was not used, by reason.
    """

    used: int = 0
    skipped: int = 0
    rejected: int = 0
    dropped: dict[str, int] = field(default_factory=dict[str, int])


@dataclass(frozen=True)
class CameraStatistics:
    """Frame counts and state of a camera, as its driver reports them.

    Parameters
    ----------
    frames : int
        Number of frames delivered.
    lost : int
        Number of frames that the camera took but that never arrived, from gaps in their numbers.
    incomplete : int
        Number of frames that arrived incomplete or damaged and were dropped.
    reconnects : int
        Number of times that the camera was reopened.
    uncertainty_ms : float or None
        Uncertainty of the exposure times on the computer's clock, ms. None if it is unknown: the
        camera reports no times, or those of another computer's clock.
    trouble : str
        Present fault of the camera, in a sentence; empty without a fault.
    """

    frames: int = 0
    lost: int = 0
    incomplete: int = 0
    reconnects: int = 0
    uncertainty_ms: float | None = None
    trouble: str = ""


@dataclass(frozen=True)
class RunResult:
    """Result of a run; ``print`` shows it in one line.

    Parameters
    ----------
    settled : bool
        True if the run ended without a fault at the taught pose, and the feature errors had stayed
        small for a second; in a study, if the true error stayed small.
    cause : str
        Reason for not settling; empty if the run settled.
    remark : str
        Fault at the end that did not stop the arm; empty without one.
    settle_time_s : float or None
        Time after which the errors stayed small, s; in a study, time at which marker 2 was first
        within 1 mm of the target.
    duration_s : float or None
        Time to the end of the last tick, s.
    pose_error_mm : float or None
        Error ‖p₂ − p_d‖ of marker 2's position at the end, by the simulation's ground truth, mm.
    bound_mm : float or None
        Cramér-Rao bound, the smallest root mean square that the pose error can have by the image
        alone, mm. The joints of teaching can reduce it further.
    pose : FinalPose
        Position of marker 2 at the end, and its distance from the taught one by image and joints.
    drives : DriveResponse or None
        Measured gain and lag of the drives; None without a tick.
    backlash : list[float] or None
        Backlash (3,) of the joints in rad, rad, mm, fitted to the frames of the run; 0 where they
        show none. A shaft that friction bends looks alike. None without a tick.
    feature_error : FeatureError
        Errors Δy at the end, as the servo measures them.
    jacobian_error : JacobianError
        Errors of Ĵ.
    explore : ExplorationCost
        Time and motion of the exploration.
    target_q : list[float] or None
        Joint values (3,) in rad, rad, mm during teaching of the target.
    loop : LoopTiming or None
        Punctuality of the loop; None if its process did not finish.
    frames : FrameCounts or None
        Use of the frames.
    camera : CameraStatistics or None
        Frame counts of the camera's driver, if it reports them.
    drive_off : str
        Reason for a drive that went off by itself or may still be on; empty if it was disabled at
        the end as usual.
    simulated : bool
        False on hardware.
    seed : int or None
        Seed of camera, start, target and noise.
    estimator : str
        Name of the estimator on the command line.
    estimator_time_per_frame_s : float or None
        Time that the estimator was allotted for every frame; None for the real time between frames.
    rejected_scenes : int or None
        Number of scenes drawn before one in which the target can be reached.
    real_time_factor : float or None
        Ratio of simulated to real time.
    resumed : int
        Number of requests of the scripted operator to resume that the servo followed.
    refused : int
        Number of requests of the scripted operator to resume that the servo refused.
    taught_again : int
        Number of times that the scripted operator repeated teaching.
    rig : str
        Rig file of the hardware.
    rig_sha256 : str
        SHA-256 of the bytes of the rig file.
    rig_checked : bool or None
        True if `rig check` had passed for the rig file.
    speed_scale : float or None
        Fraction of the full speed that was allowed.
    folder : str
        Folder of the record, its figures and metrics.json.
    not_recorded : str
        Reason for an incomplete record; empty for a complete one.
    not_filmed : str
        Reason for a missing video that was requested.
    not_written : str
        Metrics and figures that could not be written, with the reasons.
    """

    settled: bool = False
    cause: str = "the run was stopped before its first tick"
    remark: str = ""
    settle_time_s: float | None = None
    duration_s: float | None = None
    pose_error_mm: float | None = None
    bound_mm: float | None = None
    pose: FinalPose = FinalPose()
    drives: DriveResponse | None = None
    backlash: list[float] | None = None
    feature_error: FeatureError = FeatureError()
    jacobian_error: JacobianError = JacobianError()
    explore: ExplorationCost = ExplorationCost()
    target_q: list[float] | None = None
    loop: LoopTiming | None = None
    frames: FrameCounts | None = None
    camera: CameraStatistics | None = None
    drive_off: str = ""
    simulated: bool = True
    seed: int | None = None
    estimator: str = ""
    estimator_time_per_frame_s: float | None = None
    rejected_scenes: int | None = None
    real_time_factor: float | None = None
    resumed: int = 0
    refused: int = 0
    taught_again: int = 0
    rig: str = ""
    rig_sha256: str = ""
    rig_checked: bool | None = None
    speed_scale: float | None = None
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
        elif self.pose.by_image_mm is not None:
            image, joints = self.pose.by_image_mm, self.pose.by_joints_mm
            by_joints = "" if joints is None else f"{joints:.2f} mm by the joints, "
            alone = " alone: the target has no joints" if joints is None else ""
            parts.append(f"error {by_joints}{image:.2f} mm by the image{alone}")
            if self.pose.bound_mm is not None:
                limit = self.pose.limit and f", limited by {self.pose.limit}"
                parts.append(f"± {self.pose.bound_mm:.2f} mm (95 %){limit}")
        if self.settle_time_s is not None:
            parts.append(f"{self.settle_time_s:.1f} s")
        return ", ".join(parts)
