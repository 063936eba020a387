"""Text of a run's result as rows of title and text, for the commands and pages that show one.

A number or part that is unknown gives an empty text, and its row is left out.
"""

import math
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np

from rcmservo.loop import run_result
from rcmservo.loop.run_result import RunResult
from rcmservo.recording.final_pose import format_backlash
from rcmservo.recording.reader import Record
from rcmservo.recording.timeline import Span
from rcmservo.safety.causes import Action, Cause
from rcmservo.safety.state_machine import Request


def format_title(result: RunResult) -> str:
    """Return "settled" or "not settled", the title of a result."""
    return "settled" if result.settled else "not settled"


def format_verdict(record: Record, result: RunResult) -> str:
    """Return the title of a recorded result, and if the record is incomplete."""
    return format_title(result) + (", as far as the record can be read" if record.missing else "")


def list_record_rows(record: Record, result: RunResult) -> list[tuple[str, str]]:
    """Return a recorded run as pairs of title and text."""
    rows = [("what", describe_run(record.about, record.stages[-1].servo if record.stages else {}))]
    if len(record.stages) > 1:
        rows.append(("stages", _describe_stages(record)))
    return rows + list_result_rows(result)


def list_result_rows(result: RunResult) -> list[tuple[str, str]]:
    """Return the known parts of a result as pairs of title and text."""
    own_time_s = result.estimator_time_per_frame_s
    rows = (
        ("cause", result.cause),
        ("arm", result.drive_off),
        ("at the end", result.remark),
        ("settle time", _format_number(result.settle_time_s, "s", 2)),
        ("marker 2 to its taught position", _describe_final_pose(result.pose)),
        ("true distance, estimated bound (95 %)", _format_bound(result.pose)),
        ("feature error (rms, last second)", _format_feature_error(result.feature_error)),
        ("pose error ‖p₂ − p_d‖ (simulation's truth)", _format_pose_error(result)),
        ("exploration", _format_exploration(result.explore)),
        ("drives", "" if result.drives is None else _describe_drives(result.drives)),
        ("backlash or friction (fitted)", _describe_backlash(result.backlash or [0.0, 0.0, 0.0])),
        ("‖Ĵ − J‖/‖J‖ (scaled)", _format_jacobian_error(result.jacobian_error)),
        (
            "estimator's own time",
            f"{own_time_s:g} s for every frame, not real time" if own_time_s else "",
        ),
        ("the operator", _describe_scripted_operator(result)),
        ("duration", _format_duration(result)),
        *_list_loop_rows(result.loop or run_result.LoopTiming()),
        ("frames", "" if result.frames is None else _describe_frames(result.frames)),
        ("camera", "" if result.camera is None else _describe_camera(result.camera)),
        ("speed", _describe_speed(result)),
        ("not recorded", result.not_recorded),
        ("not filmed", result.not_filmed),
        ("not written", result.not_written),
    )
    return [(title, text) for title, text in rows if text]


def describe_run(about: dict[str, Any], servo: Any) -> str:
    """Return kind of run, seed, mechanism, tool, estimator and version, separated by commas.

    Parameters
    ----------
    about : dict[str, Any]
        Settings, seed and versions of the run.
    servo : Any
        JSON description of its servo.
    """
    parts = ["simulation" if about.get("simulation") else "run"]
    if "seed" in about:
        parts[0] += f" with seed {about['seed']}"
    for section in ("mechanism", "tool", "estimator"):
        with suppress(KeyError, TypeError):
            parts.append(f"{section} {servo[section]['kind']}")
    versions: Any = about.get("versions")
    if isinstance(versions, dict) and "rcmservo" in versions:
        parts.append(f"rcmservo {versions['rcmservo']}")
    return ", ".join(parts)


def describe_cause(span: Span) -> str:
    """Return the cause of a span, preceded by the operator's request."""
    if span.request is Request.NONE or span.cause is Cause.ASKED:
        return span.why
    request = f"after the operator's request to {span.request.value}"
    return f"{request}: {span.why}" if span.cause is not Cause.NONE else request


def describe_remedy(span: Span) -> str:
    """Return the remedy of a span's cause if the tool stands still until then; else empty."""
    return span.cause.remedy if span.action >= Action.HOLD else ""


def _format_number(value: float | None, unit: str, digits: int, prefix: str = "") -> str:
    """Return a number with its unit; empty if it is unknown."""
    return "" if value is None else f"{prefix}{value:.{digits}f} {unit}"


def _format_count(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _join(*parts: str) -> str:
    """Return the parts that are not empty, separated by commas."""
    return ", ".join(filter(None, parts))


def _format_bound(pose: run_result.FinalPose) -> str:
    """Return the bound of the true distance and what limits it; empty if unknown."""
    limit = pose.limit and f", limited by {pose.limit}"
    return _format_number(pose.bound_mm, "mm", 2) + limit


def _describe_final_pose(pose: run_result.FinalPose) -> str:
    deviation = _format_number(pose.by_image_std_mm, "mm", 3, "± ")
    by_image = _format_number(pose.by_image_mm, "mm", 3)
    return _join(
        f"{by_image} {deviation} by the image" if by_image else "",
        _format_number(pose.by_joints_mm, "mm by the joints", 3),
    )


def _describe_drives(drives: run_result.DriveResponse) -> str:
    """Return motion and lag of each drive; a dash for one that hardly moved."""
    gains = (f"{gain:.3f}" if gain is not None else "–" for gain in drives.gain)
    lags = (f"{lag:.0f}" if lag is not None else "–" for lag in drives.lag_ms)
    return f"moved {' '.join(gains)} of what was applied, {' '.join(lags)} ms later"


def _describe_backlash(backlash: list[float]) -> str:
    """Return the backlash of the joints; empty if the frames show none."""
    sizes = zip(backlash, format_backlash(np.array(backlash)), strict=True)
    return _join(*(f"joint {i + 1} {text}" for i, (size, text) in enumerate(sizes) if size > 0.0))


def _format_feature_error(error: run_result.FeatureError) -> str:
    s_degrees = None if error.s_rad is None else math.degrees(error.s_rad)
    return _join(
        _format_number(s_degrees, "°", 3, "s "),
        _format_number(error.r_px, "px", 2, "r "),
        _format_number(error.d_px, "px", 2, "d "),
    )


def _format_pose_error(result: RunResult) -> str:
    bound = _format_number(result.bound_mm, "mm", 3)
    error = _format_number(result.pose_error_mm, "mm", 3)
    return f"{error} (Cramér-Rao bound {bound})" if bound and error else error


def _format_exploration(cost: run_result.ExplorationCost) -> str:
    return _join(
        _format_number(cost.time_s, "s", 2),
        _format_number(cost.path_mm, "mm", 1, "path "),
        _format_number(cost.max_excursion_mm, "mm from the start", 1, "at most "),
    )


def _format_jacobian_error(error: run_result.JacobianError) -> str:
    return _join(
        _format_number(error.explored, "after exploration", 3),
        _format_number(error.final, "at the end", 3),
    )


def _describe_scripted_operator(result: RunResult) -> str:
    """Return the actions of the scripted operator of a simulation; empty if there were none."""
    if not (result.resumed or result.refused or result.taught_again):
        return ""
    refused = f" (refused {result.refused} x)" if result.refused else ""
    return f"resumed {result.resumed} x{refused}, taught the target again {result.taught_again} x"


def _format_duration(result: RunResult) -> str:
    if result.duration_s is None:
        return ""
    ticks = "" if result.loop is None else _format_count(result.loop.ticks, "tick")
    return _join(_format_number(result.duration_s, "s", 2), ticks)


def _list_loop_rows(loop: run_result.LoopTiming) -> Iterator[tuple[str, str]]:
    """Yield the punctuality of a loop as pairs of title and text."""
    if loop.missed is not None:
        missed = f"{loop.missed} of {loop.ticks} ticks missed"
        yield "loop", _join(_format_number(loop.rate_hz, "Hz", 3), missed)
    if loop.late is not None:
        longest = _format_number(loop.longest_ms, "ms between two", 1, "at most ")
        yield "late ticks", _join(str(loop.late), longest)
    if loop.collections is not None:
        collections = _format_count(loop.collections, "garbage collection")
        yield "lateness of ticks", _join(_format_spread(loop.lateness_ms, 2), collections)
    yield "latency, exposure to command", _format_spread(loop.latency_ms, 1)
    for sentence in loop.refused:
        yield "refused", sentence


def _format_spread(times: run_result.TimeSpread, digits: int) -> str:
    return _join(
        _format_number(times.median, "ms", digits, "median "),
        _format_number(times.p99, "ms", digits, "p99 "),
        _format_number(times.max, "ms", digits, "max "),
    )


def _describe_frames(frames: run_result.FrameCounts) -> str:
    return _join(
        f"{frames.used} used",
        f"{frames.skipped} skipped" if frames.skipped else "",
        f"{frames.rejected} rejected" if frames.rejected else "",
        *(f"{reason} at {_format_count(n, 'tick')}" for reason, n in frames.dropped.items()),
    )


def _describe_camera(camera: run_result.CameraStatistics) -> str:
    counts = f"{camera.frames} frames, {camera.lost} lost, {camera.incomplete} incomplete"
    uncertainty = _format_number(camera.uncertainty_ms, "ms", 2, "exposure times to ")
    parts = f"{counts}, reopened {camera.reconnects} x", uncertainty or "exposure times unchecked"
    return "; ".join(filter(None, (*parts, camera.trouble)))


def _describe_speed(result: RunResult) -> str:
    if result.speed_scale is not None:
        passed = "has passed" if result.rig_checked else "has not passed"
        return f"at most {100.0 * result.speed_scale:g} %: rig check {passed}"
    return _format_number(result.real_time_factor, "x real time", 1)


def _describe_stages(record: Record) -> str:
    """Return the number of stages in the record and the time at which each begins."""
    times, firsts = record.time, (stage.first for stage in record.stages)
    starts = [f"{times[first]:.2f} s" for first in firsts if first < len(times)]
    return f"{len(record.stages)}, begun at {', '.join(starts)}"
