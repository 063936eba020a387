"""Questions to the operator at the page before the drive can go on, such as the joints' values."""

from rcmservo.live.servo_process import HeartbeatPlant, go_on
from rcmservo.loop.clock import ticks
from rcmservo.page.channels import Desk
from rcmservo.page.messages import Note, Reply, Standby

MIN_READING_TIME_NS = 500_000_000
"""Time (ns) to read a question. An earlier answer is ignored: it was meant for another question."""

POLL_RATE_HZ = 50.0
"""Rate (1/s) at which answers are read."""


class PagePerson:
    """Operator at the page. Only new answers from the browser in control count."""

    def __init__(self, channels: Desk, plant: HeartbeatPlant) -> None:
        self._channels, self._plant = channels, plant
        self._statement = "the drive is off"

    def tell(self, words: str) -> None:
        """Set the statement that stands above the next question."""
        self._statement = words

    def ask(self, question: str) -> str:
        """Display a question and return the answer.

        Raises
        ------
        Stopped
            If a stop is requested.
        """
        plant, displayed_at = self._plant, self._plant.clock.now()
        list(self._channels.wants.heard())
        self._channels.said.put(Standby(self._statement, question=question))
        for _ in ticks(plant.clock, POLL_RATE_HZ):
            go_on(plant.told_to_end)
            for message in self._channels.wants.heard():
                if not isinstance(message, Reply):
                    self._channels.said.put(Note("the drive is off: answer the question first"))
                    continue
                has_been_read = plant.clock.now() - displayed_at >= MIN_READING_TIME_NS
                if message.question == question and has_been_read:
                    return message.words.strip()
        raise AssertionError("the clock has ended")
