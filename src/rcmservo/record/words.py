"""A run in words, as a person is told of it."""

from typing import Any

import numpy as np

from rcmservo.guard.causes import Action, Cause
from rcmservo.guard.states import Request
from rcmservo.record.reader import Record
from rcmservo.record.timeline import RunSummary, Span


def verdict_of(record: Record, told: RunSummary) -> str:
    """Whether it settled, and whether that is known for the whole run."""
    so_far = ", as far as the record can be read" if record.missing else ""
    return ("settled" if told.outcome.settled else "not settled") + so_far


def rows_of(record: Record, told: RunSummary) -> list[tuple[str, str]]:
    """A summary, as names and words."""
    outcome = told.outcome
    rows = [("what", what(record.about, record.stages[-1].servo if record.stages else {}))]
    if outcome.cause:
        rows.append(("cause", outcome.cause))
    if outcome.remark:
        rows.append(("at the end", outcome.remark))
    if outcome.settle_time is not None:
        rows.append(("settle time", f"{outcome.settle_time:.2f} s"))
    rows.append(("duration", f"{told.duration:.2f} s, {_count(told.ticks, 'tick')}"))
    if len(record.stages) > 1:
        rows.append(("stages", _stages(record)))
    if np.isfinite(outcome.error).all():
        s, r, d = np.degrees(outcome.error[0]), outcome.error[1], outcome.error[2]
        words = f"s {s:.3f} °, r {r:.2f} px, d {d:.2f} px"
        rows.append(("feature error (rms, last second)", words))
    if np.isfinite(told.latency).all():
        median, high, worst = told.latency * 1e3
        words = f"median {median:.1f} ms, p99 {high:.1f} ms, at most {worst:.1f} ms"
        rows.append(("latency, exposure to tick", words))
    rows.append(("late ticks", f"{told.late}, at most {told.longest * 1e3:.1f} ms between two"))
    rows.append(("frames", _frames(told)))
    return rows


def what(about: dict[str, Any], servo: Any) -> str:
    """Of which arm, by which estimator, drawn from which seed and by which version."""
    parts = ["simulation" if about.get("simulation") else "run"]
    if "seed" in about:
        parts[0] += f" with seed {about['seed']}"
    for box in ("mechanism", "tool", "estimator"):
        try:
            parts.append(f"{box} {servo[box]['kind']}")
        except (KeyError, TypeError):
            continue
    versions: Any = about.get("versions")
    if isinstance(versions, dict) and "rcmservo" in versions:
        parts.append(f"rcmservo {versions['rcmservo']}")
    return ", ".join(parts)


def why(span: Span) -> str:
    """The cause of a span, after what a person asked for."""
    if span.request is Request.NONE or span.cause is Cause.ASKED:
        return span.why
    asked = f"after a person's {span.request.value}"
    return f"{asked}: {span.why}" if span.cause is not Cause.NONE else asked


def way_out(span: Span) -> str:
    """What a person can do, where the tool stands still until then."""
    return span.cause.way_out if span.asks >= Action.HOLD else ""


def _stages(record: Record) -> str:
    """How many stages the record holds, and when each of them began."""
    count = len(record.time)
    begun = [f"{record.time[stage.first]:.2f} s" for stage in record.stages if stage.first < count]
    return f"{len(record.stages)}, begun at {', '.join(begun)}"


def _frames(told: RunSummary) -> str:
    parts = [f"{told.seen} used"]
    if told.skipped:
        parts.append(f"{told.skipped} passed over")
    if told.disbelieved:
        parts.append(f"{told.disbelieved} not believed")
    parts += [
        f"{reason.words} at {_count(count, 'tick')}" for reason, count in told.dropped.items()
    ]
    return ", ".join(parts)


def _count(count: int, word: str) -> str:
    return f"{count} {word}" if count == 1 else f"{count} {word}s"
