"""Who may move the arm by the page, and what counts as said by that person.

One browser has control and the others watch. Every message tells the newest moment that the server
has shown to that browser: what was said to a page long gone is said no more.
"""

import json
import secrets
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from rcmservo.config.strict_decoding import decode
from rcmservo.config.texts import Table, is_table
from rcmservo.constraints import Checked, Limit
from rcmservo.errors import BadInput
from rcmservo.interfaces import Target
from rcmservo.page.messages import (
    BrowserMessage,
    DeletePose,
    DisturbanceRequest,
    Enable,
    Go,
    Heartbeat,
    JogJoints,
    JogMarker,
    ReleaseJog,
    Reply,
    TeachPose,
)
from rcmservo.page.pose_sequence import RunSequence, SequencePlan
from rcmservo.page.settings import decode_change
from rcmservo.safety.state_machine import Request

MAX_MESSAGE_AGE_NS, MAX_JOG_AGE_NS = 300_000_000, 150_000_000
"""ns for which what the server has shown counts as seen now; by a hand that jogs."""

HOLDER_TIMEOUT_NS = 2_000_000_000
"""ns without a fresh message after which who has control loses it to whoever asks."""

MAX_MESSAGE_CHARACTERS = 2000
"""Characters of a message."""

MAX_NAME_CHARACTERS = 40
"""Characters of a pose's name."""


def _is_pose_name(text: str) -> bool:
    return 0 < len(text) <= MAX_NAME_CHARACTERS and text.isprintable() and text == text.strip()


@dataclass(frozen=True)
class PoseArgument(Checked):
    """Arguments of a message that names a pose.

    Parameters
    ----------
    name : str
        The pose.
    """

    name: Annotated[str, Limit(_is_pose_name, f"a name of 1 to {MAX_NAME_CHARACTERS} characters")]


PLAIN_MESSAGES: dict[str, BrowserMessage] = {
    "beat": Heartbeat(),
    "enable": Enable(),
    "show": TeachPose(""),
    "pause": Request.PAUSE,
    "resume": Request.RESUME,
    "clear": Request.CLEAR,
}
"""Messages without arguments."""

FindPose = Callable[[str], Target | None]


class MessageRefused(Exception):
    """A message that is not heeded, and why."""


@dataclass
class ControlOwnership:
    """Who has control: a browser by what it was named at random, or nobody.

    Parameters
    ----------
    holder : str
        Its name; empty where nobody has control.
    asking : str
        Who asks for it while somebody else has it.
    heard : int
        ns, when the holder last said something fresh, or came to be the holder.
    """

    holder: str = ""
    requester: str = ""
    last_message_at: int = 0

    def join(self, now: int) -> str:
        """Another browser; it has control if nobody has."""
        name = secrets.token_hex(16)
        if not self.holder:
            self._assign(name, now)
        return name

    def leave(self, name: str, now: int) -> None:
        """A browser is gone; who asks for control gets what it had."""
        self.requester = "" if self.requester == name else self.requester
        if self.holder == name:
            self._assign(self.requester, now)

    def request(self, name: str, now: int) -> None:
        """A browser asks for control; it has it at once where the holder is silent."""
        if not self.holder or now - self.last_message_at > HOLDER_TIMEOUT_NS:
            self._assign(name, now)
        elif self.holder != name:
            self.requester = name

    def hand_over(self, name: str, now: int) -> None:
        """Who has control gives it to who asks for it."""
        if self.holder == name and self.requester:
            self._assign(self.requester, now)

    def _assign(self, name: str, now: int) -> None:
        self.holder, self.requester, self.last_message_at = name, "", now


def interpret_message(
    text: str, name: str, control: ControlOwnership, find: FindPose, now: int
) -> BrowserMessage | None:
    """What a browser wants of the servo; None for what is settled between browsers, and for a sign
    of life that comes too late: nobody pressed anything. `find` finds a target by its name.
    """
    message = _parse_message(text)
    action, shown_at = message.pop("do", None), message.pop("at", None)
    if action == "ask":
        return control.request(name, now)
    if action == "give":
        return control.hand_over(name, now)
    if name != control.holder:
        raise MessageRefused("another browser has control: ask for it")
    if action == "release":
        return ReleaseJog()
    if type(shown_at) is not int or not 0 <= now - shown_at <= (
        MAX_JOG_AGE_NS if action == "jog" else MAX_MESSAGE_AGE_NS
    ):
        if action == "beat":
            return None
        raise MessageRefused("it came too late to count")
    control.last_message_at = now
    try:
        return _decode_action(action, message, find)
    except BadInput as error:
        raise MessageRefused(str(error)) from error


def _decode_action(action: object, message: Table, find: FindPose) -> BrowserMessage:
    """Return a fresh message of the browser in control. `message` holds its arguments."""
    if isinstance(action, str) and action in PLAIN_MESSAGES:
        return PLAIN_MESSAGES[action]
    if isinstance(action, str) and action in DECODERS:
        return DECODERS[action](message, find)
    raise MessageRefused(f"nobody knows what {str(action)[:MAX_NAME_CHARACTERS]!r} is")


def _parse_message(text: str) -> Table:
    if len(text) > MAX_MESSAGE_CHARACTERS:
        raise MessageRefused("it is too long")
    try:
        message: object = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise MessageRefused("it is no JSON") from error
    if not is_table(message):
        raise MessageRefused("it is no JSON object")
    return message


def _pose_name(message: Table) -> str:
    return decode(PoseArgument, message, "pose").name


def _find_target(name: str, find: FindPose) -> Target:
    target = find(name)
    if target is None:
        raise MessageRefused(f"there is no pose {name[:MAX_NAME_CHARACTERS]!r}")
    return target


def _decode_sequence(message: Table, find: FindPose) -> RunSequence:
    """All its poses are known before it begins."""
    plan = decode(SequencePlan, message, "tour")
    return RunSequence(plan, tuple(_find_target(stop.pose, find) for stop in plan.waypoints))


DECODERS: dict[str, Callable[[Table, FindPose], BrowserMessage]] = {
    "jog": lambda message, _: decode(
        JogMarker if "velocity" in message else JogJoints, message, "jog"
    ),
    "teach": lambda message, _: TeachPose(_pose_name(message)),
    "delete": lambda message, _: DeletePose(_pose_name(message)),
    "go": lambda message, find: Go(_find_target(_pose_name(message), find)),
    "tour": _decode_sequence,
    "set": lambda message, _: decode_change(message.get("box"), message.get("table")),
    "trouble": lambda message, _: decode(DisturbanceRequest, message, "trouble"),
    "answer": lambda message, _: decode(Reply, message, "answer"),
}
"""Messages with arguments."""
