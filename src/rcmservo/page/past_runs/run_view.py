"""Content of an opened run: time line in words, overlays of its pictures, and its figures."""

import tempfile
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.config.toml_json_parsing import is_table
from rcmservo.errors import UnusableFile
from rcmservo.figures import charts, plots
from rcmservo.page.json_text import encode_json
from rcmservo.page.view_model import as_points
from rcmservo.recording import ros2_messages
from rcmservo.recording.mcap_recovery import MessageReader, read_chunk
from rcmservo.recording.reader import Record, read_record
from rcmservo.recording.summary_text import (
    describe_cause,
    describe_way_out,
    format_verdict,
    list_record_rows,
)
from rcmservo.recording.timeline import Span, list_spans, number_stages, summarise

PICTURE_TOPIC = "image_raw/compressed"

MOMENT_SPACING_S = 0.1
"""Time (s) between the moments of a run without pictures."""
MAX_MOMENTS = 20_000
"""Largest number of moments, and of spans, that a browser gets."""
RUN_FIGURES = {
    "timeline": ("Time line", plots.plot_timeline),
    "errors": ("Feature errors", plots.plot_errors),
    "path": ("Path", plots.plot_path),
    "estimate": ("Estimate", plots.plot_estimate),
}
"""Titles and plots by the names of their files, in the order of the page."""

PictureLocation = tuple[int, int]
"""Chunk of a picture, and its index there."""


@dataclass(frozen=True)
class OpenedRun:
    """Content of a run for a browser.

    Parameters
    ----------
    json : bytes
        JSON of everything except pictures and figures.
    pictures : list[PictureLocation]
        Locations of its pictures.
    """

    json: bytes
    pictures: list[PictureLocation]


def open_run(path: Path) -> OpenedRun:
    """Read a record up to its end or its damage."""
    record = read_record(path)
    locations, exposures = _locate_pictures(path)
    lines = list_spans(record)
    titles = {name: title for name, (title, _) in RUN_FIGURES.items()}
    content = {
        "verdict": format_verdict(record, summarise(record)),
        "missing": record.missing,
        "summary": list_record_rows(record, summarise(record)),
        "spans": [_span(span) for span in lines[:MAX_MOMENTS]],
        "moments": _moments(record, lines, exposures),
        "targets": [stage.target.points for stage in record.stages],
        "figures": titles if _has_errors_to_draw(record) else {},
        "size": _size(record),
    }
    return OpenedRun(encode_json(content), locations)


def draw_figures(path: Path) -> dict[str, bytes]:
    """Draw the figures of a record. Return SVG and PNG files by their names."""
    record, files = read_record(path), dict[str, bytes]()
    if not _has_errors_to_draw(record):
        return files
    with tempfile.TemporaryDirectory() as folder:
        for name, (_, figure) in RUN_FIGURES.items():
            drawn, png = figure(record), Path(folder) / f"{name}.png"
            files[f"{name}.svg"] = charts.render_svg(drawn).encode()
            charts.save_figure(drawn, png)
            files[png.name] = png.read_bytes()
    return files


def read_picture(path: Path, location: PictureLocation) -> bytes:
    """Return a recorded picture as the JPEG file that was recorded."""
    chunk, k = location
    messages = read_chunk(path, chunk)
    if k >= len(messages):
        raise UnusableFile(path, "has changed since it was opened")
    try:
        return ros2_messages.decode_picture(messages[k].data)[1]
    except ValueError as error:
        raise UnusableFile(path, f"holds a frame that cannot be read: {error}") from error


def _has_errors_to_draw(record: Record) -> bool:
    """Return whether the record holds finite errors."""
    return bool(np.isfinite(record.ticks["delta"]).any())


def _locate_pictures(path: Path) -> tuple[list[PictureLocation], list[int]]:
    """Return the locations of a record's pictures and their exposure times in ns."""
    messages = MessageReader(path)
    located = [
        (messages.location, ros2_messages.decode_picture(message.data)[0])
        for message in messages
        if message.topic == PICTURE_TOPIC
    ]
    return [location for location, _ in located], [exposure for _, exposure in located]


def _span(span: Span) -> list[object]:
    return [
        span.start,
        span.duration,
        span.phase.value,
        describe_cause(span),
        describe_way_out(span),
        span.action.name,
    ]


def _moments(record: Record, lines: list[Span], exposures: list[int]) -> list[dict[str, Any]]:
    """Return the overlay of each picture, from the tick that used it.

    A run without pictures has moments at regular times.
    """
    count = len(record.time)
    if not count:
        return []
    if exposures:
        used = {int(one): i for i, one in reversed(list(enumerate(record.ticks["exposure"][:, 0])))}
        samples = [(used[one], k) for k, one in enumerate(exposures) if one in used]
    else:
        whole = np.arange(0.0, float(record.time[-1]) + MOMENT_SPACING_S, MOMENT_SPACING_S)
        samples = [(int(i), -1) for i in np.minimum(np.searchsorted(record.time, whole), count - 1)]
    samples = samples[:: -(-len(samples) // MAX_MOMENTS) or 1]
    starts = [span.start for span in lines]
    stage_numbers: list[int] = number_stages(record).tolist()
    points, o_c = record.ticks["points"], record.ticks["o_c"]
    return [
        {
            "t": round(float(record.time[i]), 3),
            "picture": k,
            "span": bisect_right(starts, float(record.time[i])) - 1,
            "stage": stage_numbers[i],
            "points": as_points(points[i].round(2)),
            "rcm": o_c[i].round(2),
        }
        for i, k in samples
    ]


def _size(record: Record) -> list[int]:
    """Return width and height in px of the blank image that replaces missing pictures."""
    rig: object = record.about.get("rig")
    size: list[Any] = [rig.get("width"), rig.get("height")] if is_table(rig) else []
    is_valid = size and all(type(one) is int and 0 < one < 5000 for one in size)
    return size if is_valid else [640, 480]
