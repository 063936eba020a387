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
from rcmservo.page.view_model import as_points, encode_json
from rcmservo.recording import ros2_messages
from rcmservo.recording.mcap_recovery import MessageReader, read_chunk
from rcmservo.recording.reader import Record, read_record
from rcmservo.recording.summary_text import (
    describe_cause,
    describe_remedy,
    format_verdict,
    list_record_rows,
)
from rcmservo.recording.timeline import Span, list_spans, number_stages, summarise_record

PICTURE_TOPIC = "image_raw/compressed"
"""ROS topic of the pictures in a record."""
MOMENT_SPACING_S = 0.1
"""Time (s) between the moments of a run without pictures."""
MAX_MOMENTS = 20_000
"""Largest number of moments, and of spans, that a browser gets."""
MAX_IMAGE_SIDE_PX = 5000
"""Width and height (px) from which a record's image size counts as damaged."""
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
    spans, summary = list_spans(record), summarise_record(record)
    titles = {name: title for name, (title, _) in RUN_FIGURES.items()}
    content = {
        "verdict": format_verdict(record, summary),
        "missing": record.missing,
        "summary": list_record_rows(record, summary),
        "spans": [_list_span_values(span) for span in spans[:MAX_MOMENTS]],
        "moments": _list_moments(record, spans, exposures),
        "targets": [stage.target.points for stage in record.stages],
        "figures": titles if _has_finite_errors(record) else {},
        "size": _find_image_size(record),
    }
    return OpenedRun(encode_json(content), locations)


def draw_figures(path: Path, kind: str) -> dict[str, bytes]:
    """Draw the figures of a record. Return files of one kind, "svg" or "png", by figure name."""
    record = read_record(path)
    if not _has_finite_errors(record):
        return {}
    render = {"svg": _render_svg, "png": _render_png}[kind]
    return {name: render(plot(record)) for name, (_, plot) in RUN_FIGURES.items()}


def _render_svg(figure: charts.Figure) -> bytes:
    return charts.render_svg(figure).encode()


def _render_png(figure: charts.Figure) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        charts.save_figure(figure, png := Path(folder) / "figure.png")
        return png.read_bytes()


def read_picture(path: Path, location: PictureLocation) -> bytes:
    """Return a recorded picture as the JPEG file that was recorded."""
    chunk, index = location
    messages = read_chunk(path, chunk)
    if index >= len(messages):
        raise UnusableFile(path, "has changed since it was opened")
    try:
        return ros2_messages.decode_picture(messages[index].data)[1]
    except ValueError as error:
        raise UnusableFile(path, f"holds a frame that cannot be read: {error}") from error


def _has_finite_errors(record: Record) -> bool:
    """Return whether the record holds feature errors that can be drawn."""
    return bool(np.isfinite(record.ticks["delta"]).any())


def _locate_pictures(path: Path) -> tuple[list[PictureLocation], list[int]]:
    """Return the locations of a record's pictures and their exposure times in ns."""
    messages = MessageReader(path)
    locations, exposures = list[PictureLocation](), list[int]()
    for message in messages:
        if message.topic == PICTURE_TOPIC:
            locations.append(messages.location)
            exposures.append(ros2_messages.decode_picture(message.data)[0])
    return locations, exposures


def _list_span_values(span: Span) -> list[object]:
    """Return the values of a row of the time line."""
    cause, recovery = describe_cause(span), describe_remedy(span)
    return [span.start, span.duration, span.phase.value, cause, recovery, span.action.name]


def _list_moments(record: Record, spans: list[Span], exposures: list[int]) -> list[dict[str, Any]]:
    """Return the overlay of each picture, from the first tick that used it.

    A run without pictures has moments at regular times, with picture -1.
    """
    count, ticks = len(record.time), record.ticks
    if not count:
        return []
    if exposures:
        rows = {int(exposure): i for i, exposure in reversed([*enumerate(ticks["exposure"][:, 0])])}
        samples = [(rows[exposure], k) for k, exposure in enumerate(exposures) if exposure in rows]
    else:
        times = np.arange(0.0, float(record.time[-1]) + MOMENT_SPACING_S, MOMENT_SPACING_S)
        samples = [(int(i), -1) for i in np.minimum(np.searchsorted(record.time, times), count - 1)]
    samples = samples[:: -(-len(samples) // MAX_MOMENTS) or 1]
    starts = [span.start for span in spans]
    stage_numbers: list[int] = number_stages(record).tolist()
    return [
        {
            "t": round(float(record.time[row]), 3),
            "picture": picture,
            "span": bisect_right(starts, float(record.time[row])) - 1,
            "stage": stage_numbers[row],
            "points": as_points(ticks["points"][row].round(2)),
            "rcm": ticks["o_c"][row].round(2),
        }
        for row, picture in samples
    ]


def _find_image_size(record: Record) -> list[int]:
    """Return width and height in px of the blank image that replaces missing pictures."""
    rig: object = record.about.get("rig")
    size: list[Any] = [rig.get("width"), rig.get("height")] if is_table(rig) else []
    is_valid = size and all(type(side) is int and 0 < side < MAX_IMAGE_SIDE_PX for side in size)
    return size if is_valid else [640, 480]
