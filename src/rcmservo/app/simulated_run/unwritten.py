"""What cannot be written at the end of a run is told with its result, which is not lost with it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

from rcmservo.errors import UnusableFile

Metrics = TypeVar("Metrics")


def written(metrics: Metrics, write: Callable[[], None]) -> Metrics:
    """The metrics of a run, with why something could not be written in ``not_written``."""
    told: Any = metrics
    try:
        write()
    except (UnusableFile, OSError) as error:
        parts = filter(None, (told.not_written, str(error)))
        return replace(told, not_written="; ".join(parts))
    return metrics
