"""The figures of a run, from its record."""

from pathlib import Path

import numpy as np

from rcmservo.figures import charts, plots
from rcmservo.record.reader import Record


def draw_figures(record: Record, folder: Path) -> None:
    """The figures of a run's record, where it came to hold anything to draw."""
    if np.isfinite(record.ticks["delta"]).any():
        charts.save(plots.errors(record), folder / "errors.png")
        charts.save(plots.estimate(record), folder / "estimate.png")
