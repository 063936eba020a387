"""Text of a run's result, row by row, for every command that prints one."""

import math
from collections.abc import Iterator
from typing import Any

from rcmservo.loop.run_result import (
    CameraStatistics,
    ExplorationCost,
    FeatureError,
    FrameCounts,
    JacobianError,
    LoopTiming,
    RunResult,
    TimeSpread,
)
from rcmservo.recording.reader import Record
from rcmservo.recording.timeline import Span
from rcmservo.safety.causes import Action, Cause
from rcmservo.safety.state_machine import Request


def format_verdict(record: Record, result: RunResult) -> str:
    """Return whether the run settled, and if the record is incomplete."""
    so_far = ", as far as the record can be read" if record.missing else ""
    return format_title(result) + so_far


def list_record_rows(record: Record, result: RunResult) -> list[tuple[str, str]]:
    """Return a recorded run as pairs of title and text."""
    rows = [("what", describe_run(record.about, record.stages[-1].servo if record.stages else {}))]
    if len(record.stages) > 1:
        rows.append(("stages", _stages(record)))
    return rows + list_result_rows(result)


def format_title(result: RunResult) -> str:
    """Return "settled" or "not settled", the title of a result."""
    return "settled" if result.settled else "not settled"


def list_result_rows(result: RunResult) -> list[tuple[str, str]]:
    """Return the known parts of a result as pairs of title and text."""
    given = result.estimator_time_per_frame_s
    loop = LoopTiming() if result.loop is None else result.loop
    rows = (
        ("cause", result.cause),
        ("arm", result.drive_off),
        ("at the end", result.remark),
        ("settle time", _number(result.settle_time_s, "s", 2)),
        ("feature error (rms, last second)", _feature_error(result.feature_error)),
        ("pose error ‖p₂ − p_d‖ (simulation's truth)", _pose_error(result)),
        ("exploration", _exploration(result.explore)),
        ("‖Ĵ − J‖/‖J‖ (scaled)", _jacobian_error(result.jacobian_error)),
        ("estimator's own time", f"{given:g} s for every frame, not real time" if given else ""),
        ("the operator", _operator(result)),
        ("duration", _duration(result)),
        *_loop_rows(loop),
        ("frames", "" if result.frames is None else _frames(result.frames)),
        ("camera", "" if result.camera is None else _camera(result.camera)),
        ("speed", _speed(result)),
        ("not recorded", result.not_recorded),
        ("not filmed", result.not_filmed),
        ("not written", result.not_written),
    )
    return [(title, words) for title, words in rows if words]


def _number(value: float | None, unit: str, digits: int, before: str = "") -> str:
    """Return a number with its unit; empty if it is unknown."""
    return "" if value is None else f"{before}{value:.{digits}f} {unit}"


def _joined(*parts: str) -> str:
    return ", ".join(filter(None, parts))


def _feature_error(error: FeatureError) -> str:
    s = None if error.s_rad is None else math.degrees(error.s_rad)
    return _joined(
        _number(s, "°", 3, "s "),
        _number(error.r_px, "px", 2, "r "),
        _number(error.d_px, "px", 2, "d "),
    )


def _pose_error(result: RunResult) -> str:
    bound = _number(result.bound_mm, "mm", 3)
    words = _number(result.pose_error_mm, "mm", 3)
    return f"{words} (Cramér-Rao bound {bound})" if bound and words else words


def _exploration(cost: ExplorationCost) -> str:
    far = _number(cost.max_excursion_mm, "mm from the start", 1, "at most ")
    return _joined(_number(cost.time_s, "s", 2), _number(cost.path_mm, "mm", 1, "path "), far)


def _jacobian_error(error: JacobianError) -> str:
    return _joined(
        _number(error.explored, "after exploration", 3), _number(error.final, "at the end", 3)
    )


def _operator(result: RunResult) -> str:
    if not (result.resumed or result.refused or result.taught_again):
        return ""
    refused = f" (refused {result.refused} x)" if result.refused else ""
    return f"resumed {result.resumed} x{refused}, taught the target again {result.taught_again} x"


def _duration(result: RunResult) -> str:
    ticks = "" if result.loop is None else _count(result.loop.ticks, "tick")
    seconds = _number(result.duration_s, "s", 2)
    return _joined(seconds, ticks) if seconds else ""


def _loop_rows(loop: LoopTiming) -> Iterator[tuple[str, str]]:
    """Yield the punctuality of a loop as pairs of title and text."""
    if loop.missed is not None:
        missed = f"{loop.missed} of {loop.ticks} ticks missed"
        yield "loop", _joined(_number(loop.rate_hz, "Hz", 3), missed)
    if loop.late is not None:
        longest = _number(loop.longest_ms, "ms between two", 1, "at most ")
        yield "late ticks", _joined(str(loop.late), longest)
    if loop.collections is not None:
        collections = _count(loop.collections, "garbage collection")
        yield "lateness of ticks", _joined(_spread(loop.lateness_ms, 2), collections)
    yield "latency, exposure to command", _spread(loop.latency_ms, 1)
    for sentence in loop.refused:
        yield "refused", sentence


def _spread(times: TimeSpread, digits: int) -> str:
    return _joined(
        _number(times.median, "ms", digits, "median "),
        _number(times.p99, "ms", digits, "p99 "),
        _number(times.max, "ms", digits, "max "),
    )


def _camera(camera: CameraStatistics) -> str:
    counts = f"{camera.frames} frames, {camera.lost} lost, {camera.incomplete} incomplete"
    times = _number(camera.uncertainty_ms, "ms", 2, "exposure times to ")
    parts = f"{counts}, reopened {camera.reconnects} x", times or "exposure times unchecked"
    return "; ".join(filter(None, (*parts, camera.trouble)))


def _speed(result: RunResult) -> str:
    if result.speed_scale is not None:
        passed = "has passed" if result.rig_checked else "has not passed"
        return f"at most {100.0 * result.speed_scale:g} %: rig check {passed}"
    return _number(result.real_time_factor, "x real time", 1)


def describe_run(about: dict[str, Any], servo: Any) -> str:
    """Return kind of run, seed, mechanism, tool, estimator and version, separated by commas."""
    parts = ["simulation" if about.get("simulation") else "run"]
    if "seed" in about:
        parts[0] += f" with seed {about['seed']}"
    for section in ("mechanism", "tool", "estimator"):
        try:
            parts.append(f"{section} {servo[section]['kind']}")
        except (KeyError, TypeError):
            continue
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


def describe_way_out(span: Span) -> str:
    """Return the operator's next step, if the tool stands still until then; otherwise nothing."""
    return span.cause.remedy if span.action >= Action.HOLD else ""


def _stages(record: Record) -> str:
    """Return the number of stages in the record and the time at which each begins."""
    count = len(record.time)
    begun = [f"{record.time[stage.first]:.2f} s" for stage in record.stages if stage.first < count]
    return f"{len(record.stages)}, begun at {', '.join(begun)}"


def _frames(frames: FrameCounts) -> str:
    parts = [f"{frames.used} used"]
    if frames.skipped:
        parts.append(f"{frames.skipped} skipped")
    if frames.rejected:
        parts.append(f"{frames.rejected} rejected")
    parts += [f"{why} at {_count(count, 'tick')}" for why, count in frames.dropped.items()]
    return ", ".join(parts)


def _count(count: int, word: str) -> str:
    return f"{count} {word}" if count == 1 else f"{count} {word}s"
