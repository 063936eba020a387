"""What a person is asked at the page before the drive can go on, such as where the arm stands."""

from rcmservo.live.servo_process import HeartbeatPlant, go_on
from rcmservo.loop.clock import ticks
from rcmservo.page.channels import Desk
from rcmservo.page.messages import Note, Reply, Standby

MIN_READING_TIME_NS = 500_000_000
"""ns that a person needs at least to read a question: what comes before was meant for another."""

POLL_RATE_HZ = 50.0
"""Looks for an answer, 1/s."""


class PagePerson:
    """A person at the page, whose answers come from the browser that has control, and are fresh."""

    def __init__(self, channels: Desk, plant: HeartbeatPlant) -> None:
        self._channels, self._plant = channels, plant
        self._statement = "the drive is off"

    def tell(self, words: str) -> None:
        """Say something that needs no answer: it stands above the next question."""
        self._statement = words

    def ask(self, question: str) -> str:
        """What the person answers to this question."""
        plant, displayed_at = self._plant, self._plant.clock.now()
        list(self._channels.wants.heard())
        self._channels.said.put(Standby(self._statement, question=question))
        for _ in ticks(plant.clock, POLL_RATE_HZ):
            go_on(plant.told_to_end)
            for message in self._channels.wants.heard():
                if not isinstance(message, Reply):
                    self._channels.said.put(Note("the drive is off: answer first"))
                elif (
                    message.question == question
                    and plant.clock.now() - displayed_at >= MIN_READING_TIME_NS
                ):
                    return message.words.strip()
        raise AssertionError("the clock has ended")
