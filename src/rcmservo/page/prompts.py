"""Questions to the operator at the page before the drive is enabled, such as the joints' values."""

from rcmservo.live.servo_process import HeartbeatPlant, raise_if_stopped
from rcmservo.loop.clock import ticks
from rcmservo.page.channels import PageChannels
from rcmservo.page.messages import Note, Reply, Standby

MIN_READING_TIME_NS = 500_000_000
"""Time (ns) to read a question. An earlier answer is ignored: it was meant for another question."""

POLL_RATE_HZ = 50.0
"""Rate (1/s) at which answers are read."""


class PagePrompts:
    """Operator at the page. Only new answers from the browser in control count."""

    def __init__(self, channels: PageChannels, plant: HeartbeatPlant) -> None:
        self._channels, self._plant = channels, plant
        self._statement = "the drive is off"

    def notify(self, message: str) -> None:
        """Set the statement that stands above the next question."""
        self._statement = message

    def ask(self, question: str) -> str:
        """Display a question and return the answer.

        Raises
        ------
        Stopped
            If a stop is requested.
        """
        plant, displayed_ns = self._plant, self._plant.clock.now()
        self._channels.requests.receive_all()  # discards answers to an earlier question
        self._channels.status.send(Standby(self._statement, question=question))
        for _ in ticks(plant.clock, POLL_RATE_HZ):
            raise_if_stopped(plant.stop_requested)
            for message in self._channels.requests.receive_all():
                if not isinstance(message, Reply):
                    self._channels.status.send(Note("the drive is off: answer the question first"))
                    continue
                could_be_read = plant.clock.now() - displayed_ns >= MIN_READING_TIME_NS
                if message.question == question and could_be_read:
                    return message.words.strip()
        raise AssertionError("ticks without a duration never end")
