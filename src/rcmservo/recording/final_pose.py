"""Pose of the tool at the end of a run, drives and backlash, from the ticks of the run."""

from dataclasses import dataclass, field

import numpy as np

from rcmservo.control.backlash_fit import fit_backlash
from rcmservo.geometry.kinematics import Kinematics, compute_position, compute_position_jacobian
from rcmservo.geometry.tool import Tool, compute_second_marker_jacobian
from rcmservo.interfaces import Floats
from rcmservo.loop.run_result import DriveResponse, FinalPose, finite_or_none

FINAL_WINDOW_S = 1.0
"""Time at the end of a run in s over which its errors are averaged."""

LAGS_S = np.arange(0.0, 0.2001, 0.005)
"""Lags in s among which that of a drive is searched."""

MIN_TRAVEL = np.array([np.radians(1.0), np.radians(1.0), 2.0])
"""Smallest travel (3,) of a joint in rad, rad, mm from which its drive's response is measured."""


PART_NAMES = (
    "noise of the markers",
    "errors of arm, tool and lens, such as backlash or bending",
    "the way left to the target",
)
"""Parts of the bound of the final pose."""

ARM_ERRORS, WAY_LEFT = 1, 2
"""Parts of the errors of arm, tool and lens, and of the way left."""

MIN_BACKLASH_RATIO = 0.5
"""Motion of the tool by half the backlash of a joint, relative to the errors of arm, tool and lens,
from which the backlash is what limits the pose."""

REST_UNITS, RATE_UNITS = np.array([0.01, 0.01, 1.0]), ("rad/s", "rad/s", "mm/s")
"""Rates of about the same speed of the tool, by which joints are compared, and their units."""


@dataclass(frozen=True, eq=False)
class RunCourse:
    """Ticks of one run, at least one, as arrays.

    Parameters
    ----------
    times : Floats
        Times (N,) since the start of the loop, s.
    errors : Floats
        Feature errors Δy (N, 3), rad, px, px.
    now : Floats
        Times (N,) of the observations on the plant's clock, s.
    q : Floats
        Measured joints (N, 3), rad, rad, mm.
    applied : Floats
        Joint rates (N, 3) that the arm applied after each tick, rad/s, rad/s, mm/s.
    J_hat : Floats
        Ĵ (3, 3) at the last tick, rows in rad/mm, px/mm, px/mm.
    distances : Floats
        Distances (N,) of marker 2 from its taught position by the joints, mm; NaN if unknown.
    pose_bound : float
        Distance from the taught position that is kept with 95 % at the last tick, mm; or NaN.
    bound_parts : Floats
        Its parts (3,): noise of the markers, errors of arm, tool and lens, way left, mm.
    resting_rates : Floats
        Rates (3,) up to which the joints have rested, rad/s, rad/s, mm/s.
    frames : Floats
        Numbers (N,) of the newest frames, -1 before the first.
    q_exposure : Floats
        Joints (N, 3) at their exposures, rad, rad, mm.
    points : Floats
        Their markers (N, 2, 2), px; NaN where lost.
    """

    times: Floats
    errors: Floats
    now: Floats
    q: Floats
    applied: Floats
    J_hat: Floats
    distances: Floats
    pose_bound: float = np.nan
    bound_parts: Floats = field(default_factory=lambda: np.full(3, np.nan))
    resting_rates: Floats = field(default_factory=lambda: np.zeros(3))
    frames: Floats = field(default_factory=lambda: np.zeros(0))
    q_exposure: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    points: Floats = field(default_factory=lambda: np.zeros((0, 2, 2)))


def measure_distances(q: Floats, mechanism: Kinematics, tool: Tool, taught_q: Floats) -> Floats:
    """Return the distances (N,) in mm of marker 2 from its taught position by the joints q (N, 3).

    They are NaN if the joints `taught_q` (3,) of the target are.
    """
    rcm = mechanism.to_struct(tool.offset)
    p2 = np.array([tool.second_marker(compute_position(rcm, joints)) for joints in q])
    distances: Floats = np.linalg.norm(
        p2 - tool.second_marker(compute_position(rcm, taught_q)), axis=1
    )
    return distances


def measure_backlash(course: RunCourse, mechanism: Kinematics, tool: Tool) -> Floats:
    """Return the backlash (3,) of the joints in rad, rad, mm; 0 where the frames show none."""
    is_new = np.diff(course.frames, prepend=-1.0) > 0.0
    is_seen = np.isfinite(course.points).all(axis=(1, 2)) & np.isfinite(course.q_exposure).all(
        axis=1
    )
    q, points = course.q_exposure[is_new & is_seen], course.points[is_new & is_seen]
    fit = fit_backlash(mechanism.to_struct(tool.offset), tool.struct, q, points)
    return np.zeros(3) if fit is None else fit.size


def measure_final_pose(
    course: RunCourse, mechanism: Kinematics, tool: Tool, backlash: Floats
) -> FinalPose:
    """Return the position of marker 2 at the last tick, and its distance from the taught one.

    Parameters
    ----------
    course : RunCourse
        Ticks of the run.
    mechanism : Kinematics
        Kinematics of the arm.
    tool : Tool
        Positions of the markers on the tool.
    backlash : Floats
        Backlash (3,) of the joints in rad, rad, mm.
    """
    p1 = compute_position(mechanism.to_struct(tool.offset), course.q[-1])
    p2 = tool.second_marker(p1)
    recent_errors = course.errors[course.times > course.times[-1] - FINAL_WINDOW_S]
    mean_mm, std_mm = convert_to_mm(recent_errors, course.J_hat, tool, p1)
    by_joints_mm = finite_or_none(float(course.distances[-1]))
    by_image_mm, std_mm = finite_or_none(mean_mm), finite_or_none(std_mm)
    bound_mm = finite_or_none(course.pose_bound)
    p1_per_joint = compute_position_jacobian(mechanism.to_struct(tool.offset), course.q[-1])
    p2_per_joint = compute_second_marker_jacobian(tool.struct, p1) @ p1_per_joint
    play_mm = 0.5 * backlash * np.linalg.norm(p2_per_joint, axis=0)
    names = mechanism.joint_names
    limit = "" if bound_mm is None else describe_limit(course, names, backlash, play_mm)
    return FinalPose(p2.tolist(), by_joints_mm, by_image_mm, std_mm, bound_mm, limit)


def describe_limit(
    course: RunCourse, joint_names: tuple[str, ...], backlash: Floats, play_mm: Floats
) -> str:
    """Return what contributes most to the bound; empty if unknown.

    `backlash` (3,) is that of the joints in rad, rad, mm, and `play_mm` (3,) half of it as motion
    of marker 2.
    """
    if not np.isfinite(course.bound_parts).all():
        return ""
    part = int(np.argmax(course.bound_parts))
    joint = int(np.argmax(play_mm))
    if part == ARM_ERRORS and play_mm[joint] > MIN_BACKLASH_RATIO * course.bound_parts[part]:
        size = format_backlash(backlash)[joint]
        return f"backlash of joint {joint + 1} ({joint_names[joint]}), {size}"
    rates = course.resting_rates / REST_UNITS
    if part != WAY_LEFT or not rates.max() > 0.0:
        return PART_NAMES[part]
    joint = int(np.argmax(rates))
    rate = f"{course.resting_rates[joint]:.2g} {RATE_UNITS[joint]}"
    return f"joint {joint + 1} ({joint_names[joint]}), which rests at up to {rate}"


def format_backlash(backlash: Floats) -> list[str]:
    """Return the backlash (3,) of the joints in rad, rad, mm, in words."""
    angle_1, angle_2, insertion = backlash
    return [f"{np.degrees(angle_1):.2f}°", f"{np.degrees(angle_2):.2f}°", f"{insertion:.2f} mm"]


def convert_to_mm(errors: Floats, J_hat: Floats, tool: Tool, p1: Floats) -> tuple[float, float]:
    """Return the length (mm) of the mean of Δy (n, 3) as motion of marker 2, and its deviation.

    Both are NaN without an estimate Ĵ or an error.
    """
    if not (np.isfinite(errors).all() and np.isfinite(J_hat).all() and np.linalg.det(J_hat)):
        return np.nan, np.nan
    p2_per_error = compute_second_marker_jacobian(tool.struct, p1) @ np.linalg.inv(J_hat)
    mean_mm = np.linalg.norm(p2_per_error @ errors.mean(axis=0))
    if len(errors) < 2:
        return float(mean_mm), np.nan
    covariance = p2_per_error @ np.cov(errors.T) @ p2_per_error.T
    return float(mean_mm), float(np.sqrt(np.trace(covariance)))


def measure_drive_response(course: RunCourse) -> DriveResponse:
    """Return gain g and lag τ of each drive, the least-squares fit of q(t) = q₀ + g ∫ applied(t−τ).

    A joint whose applied travel is below `MIN_TRAVEL` has None.
    """
    steps = course.applied[:-1] * np.diff(course.now)[:, None]
    travel = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    responses = [
        _fit_response(course.now, travel[:, j], course.q[:, j])
        if np.ptp(travel[:, j]) >= MIN_TRAVEL[j]
        else (None, None)
        for j in range(3)
    ]
    return DriveResponse([gain for gain, _ in responses], [lag for _, lag in responses])


def _fit_response(now: Floats, travel: Floats, q: Floats) -> tuple[float | None, float | None]:
    """Return gain and lag (ms) of one joint from its applied travel (N,) and its values (N,).

    Both are None if a value is not finite.
    """
    if not (np.isfinite(travel).all() and np.isfinite(q).all() and np.isfinite(now).all()):
        return None, None
    deviation, best = q - q.mean(), (np.inf, None, None)
    for lag_s in LAGS_S:
        delayed = np.interp(now - lag_s, now, travel)
        delayed -= delayed.mean()
        squared = delayed @ delayed
        if squared > 0.0:
            gain = float(delayed @ deviation / squared)
            residual = float(np.linalg.norm(deviation - gain * delayed))
            best = min(best, (residual, gain, float(1e3 * lag_s)), key=lambda fit: fit[0])
    return best[1:]
