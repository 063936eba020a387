"""Progress of a live run, on simulated devices and on those of a lab."""

from rich.live import Live
from rich.text import Text

from rcmservo.live.loop_statistics import Report


class LiveProgress:
    """Progress of a run: a status line, and a printed line for each new phase or cause.

    The status line begins with the first report.
    """

    def __init__(self, line: Live, duration: float) -> None:
        self._line, self._duration, self._printed = line, duration, ""

    def __call__(self, report: Report) -> None:
        self._line.start()
        time = report.time * 1e-9
        if report.words != self._printed:
            self._printed = report.words
            words = f"{time:6.2f} s  {report.words}"
            self._line.console.print(words, soft_wrap=True, highlight=False)
        self._line.update(
            Text(f"{time:6.2f} / {self._duration:g} s  {report.words}"), refresh=False
        )
