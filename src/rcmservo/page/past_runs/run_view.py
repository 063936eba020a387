"""A run that is opened: what happened in words, what to draw on its pictures, and its figures."""

import tempfile
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.config.texts import is_table
from rcmservo.errors import UnusableFile
from rcmservo.figures import charts, plots
from rcmservo.page.json_text import json_of
from rcmservo.page.view_model import pairs
from rcmservo.recording import ros2_messages
from rcmservo.recording.mcap_recovery import MessageReader, read_chunk
from rcmservo.recording.reader import Record, read_record
from rcmservo.recording.summary_text import rows_of, verdict_of, way_out, why
from rcmservo.recording.timeline import Span, spans, stages, summary

PICTURE = "image_raw/compressed"
EVERY = 0.1
"""s between moments of a run without pictures."""
MOST = 20_000
"""Moments, and spans, that a browser is told of."""
FIGURES = {
    "timeline": ("Time line", plots.plot_timeline),
    "errors": ("Feature errors", plots.plot_errors),
    "path": ("Path", plots.plot_path),
    "estimate": ("Estimate", plots.plot_estimate),
}
"""Titles and plots by the names of their files, in the order in which they are shown."""

Where = tuple[int, int]
"""Chunk of a picture, and its place there."""


@dataclass(frozen=True)
class OpenedRun:
    """A run as a browser gets it.

    Parameters
    ----------
    told : bytes
        JSON: all but pictures and figures.
    pictures : list[Where]
        Where its pictures are.
    """

    told: bytes
    pictures: list[Where]


def opened(path: Path) -> OpenedRun:
    """Read a record, up to its end or its damage."""
    record = read_record(path)
    found, exposures = _pictures(path)
    lines = spans(record)
    titles = {name: title for name, (title, _) in FIGURES.items()}
    told = {
        "verdict": verdict_of(record, summary(record)),
        "missing": record.missing,
        "summary": rows_of(record, summary(record)),
        "spans": [_span(span) for span in lines[:MOST]],
        "moments": _moments(record, lines, exposures),
        "targets": [stage.target.points for stage in record.stages],
        "figures": titles if _drawable(record) else {},
        "size": _size(record),
    }
    return OpenedRun(json_of(told), found)


def figures(path: Path) -> dict[str, bytes]:
    """The figures of a record by their files' names, as SVG and PNG."""
    record, files = read_record(path), dict[str, bytes]()
    if not _drawable(record):
        return files
    with tempfile.TemporaryDirectory() as folder:
        for name, (_, figure) in FIGURES.items():
            drawn, png = figure(record), Path(folder) / f"{name}.png"
            files[f"{name}.svg"] = charts.render_svg(drawn).encode()
            charts.save_figure(drawn, png)
            files[png.name] = png.read_bytes()
    return files


def picture(path: Path, where: Where) -> bytes:
    """A picture as the JPEG file that it was kept as."""
    place, k = where
    messages = read_chunk(path, place)
    if k >= len(messages):
        raise UnusableFile(path, "has changed since it was opened")
    try:
        return ros2_messages.decode_picture(messages[k].data)[1]
    except ValueError as error:
        raise UnusableFile(path, f"holds a frame that cannot be read: {error}") from error


def _drawable(record: Record) -> bool:
    """Whether there is anything to draw."""
    return bool(np.isfinite(record.ticks["delta"]).any())


def _pictures(path: Path) -> tuple[list[Where], list[int]]:
    """Where a record's pictures are, and when they were exposed."""
    messages = MessageReader(path)
    found = [
        (messages.location, ros2_messages.decode_picture(message.data)[0])
        for message in messages
        if message.topic == PICTURE
    ]
    return [where for where, _ in found], [exposure for _, exposure in found]


def _span(span: Span) -> list[object]:
    return [span.start, span.duration, span.phase.value, why(span), way_out(span), span.asks.name]


def _moments(record: Record, lines: list[Span], exposures: list[int]) -> list[dict[str, Any]]:
    """What is shown at each picture, or now and then where there is none: the tick that used it."""
    count = len(record.time)
    if not count:
        return []
    if exposures:
        used = {int(one): i for i, one in reversed(list(enumerate(record.ticks["exposure"][:, 0])))}
        both = [(used[one], k) for k, one in enumerate(exposures) if one in used]
    else:
        whole = np.arange(0.0, float(record.time[-1]) + EVERY, EVERY)
        both = [(int(i), -1) for i in np.minimum(np.searchsorted(record.time, whole), count - 1)]
    both = both[:: -(-len(both) // MOST) or 1]
    starts = [span.start for span in lines]
    of: list[int] = stages(record).tolist()
    points, o_c = record.ticks["points"], record.ticks["o_c"]
    return [
        {
            "t": round(float(record.time[i]), 3),
            "picture": k,
            "span": bisect_right(starts, float(record.time[i])) - 1,
            "stage": of[i],
            "points": pairs(points[i].round(2)),
            "rcm": o_c[i].round(2),
        }
        for i, k in both
    ]


def _size(record: Record) -> list[int]:
    """Width and height px of what is drawn on where there is no picture."""
    rig: object = record.about.get("rig")
    told: list[Any] = [rig.get("width"), rig.get("height")] if is_table(rig) else []
    known = told and all(type(one) is int and 0 < one < 5000 for one in told)
    return told if known else [640, 480]
