"""Control of the arm by one browser, and validation of the messages from browsers.

One browser has control; the others watch. Every message carries the newest time that the server has
displayed in that browser, so that a message about an outdated display is refused.
"""

import json
import secrets
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from rcmservo.config.strict_decoding import decode_settings
from rcmservo.config.toml_json_parsing import Table, is_table
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
"""Age (ns) of the displayed state up to which a message counts; the same for a jog."""

HOLDER_TIMEOUT_NS = 2_000_000_000
"""Time (ns) without a valid message after which the browser in control loses control on request."""

MAX_MESSAGE_CHARACTERS = 2000
"""Longest message in characters."""

MAX_NAME_CHARACTERS = 40
"""Longest name of a pose in characters."""


def _is_pose_name(text: str) -> bool:
    return 0 < len(text) <= MAX_NAME_CHARACTERS and text.isprintable() and text == text.strip()


@dataclass(frozen=True)
class PoseArgument(Checked):
    """Arguments of a message about a pose.

    Parameters
    ----------
    name : str
        Name of the pose.
    """

    name: Annotated[str, Limit(_is_pose_name, f"a name of 1 to {MAX_NAME_CHARACTERS} characters")]


PLAIN_MESSAGES: dict[str, BrowserMessage] = {
    "beat": Heartbeat(),
    "enable": Enable(),
    "teach_again": TeachPose(""),
    "pause": Request.PAUSE,
    "resume": Request.RESUME,
    "clear": Request.CLEAR,
}
"""Messages without arguments, by their action."""

FindPose = Callable[[str], Target | None]


class MessageRefused(Exception):
    """Refusal of a message, with the reason."""


@dataclass
class ControlOwnership:
    """Ownership of control. Browsers have random names.

    Parameters
    ----------
    holder : str
        Name of the browser in control; empty if there is none.
    requester : str
        Name of the browser that requests control from the holder.
    last_message_at : int
        Time (ns) of the holder's last valid message, or of the transfer of control.
    """

    holder: str = ""
    requester: str = ""
    last_message_at: int = 0

    def join(self, now: int) -> str:
        """Register a browser and return its name; it gets control if no browser has it."""
        name = secrets.token_hex(16)
        if not self.holder:
            self._assign(name, now)
        return name

    def leave(self, name: str, now: int) -> None:
        """Remove a browser; its control passes to the requester."""
        self.requester = "" if self.requester == name else self.requester
        if self.holder == name:
            self._assign(self.requester, now)

    def request(self, name: str, now: int) -> None:
        """Request control; it is transferred at once if the holder has been silent."""
        if not self.holder or now - self.last_message_at > HOLDER_TIMEOUT_NS:
            self._assign(name, now)
        elif self.holder != name:
            self.requester = name

    def hand_over(self, name: str, now: int) -> None:
        """Hand control over from its holder to the requester."""
        if self.holder == name and self.requester:
            self._assign(self.requester, now)

    def _assign(self, name: str, now: int) -> None:
        self.holder, self.requester, self.last_message_at = name, "", now


def interpret_message(
    text: str, name: str, control: ControlOwnership, find: FindPose, now: int
) -> BrowserMessage | None:
    """Return the request in a browser's message.

    Parameters
    ----------
    text : str
        Message: a JSON object with `do` (action), `at` (displayed time in ns) and arguments.
    name : str
        Name of the browser.
    control : ControlOwnership
        Ownership, which this call updates.
    find : callable
        Returns the target of a pose's name, or None.
    now : int
        Present time in ns.

    Returns
    -------
    BrowserMessage or None
        None for messages about ownership, and for a heartbeat that is too old: the user pressed
        nothing, so that no refusal is displayed.

    Raises
    ------
    MessageRefused
        If the message is invalid or too old, or the browser does not have control.
    """
    message = _parse_message(text)
    action, shown_at = message.pop("do", None), message.pop("at", None)
    if action == "request_control":
        return control.request(name, now)
    if action == "hand_over":
        return control.hand_over(name, now)
    if name != control.holder:
        raise MessageRefused("another browser has control: request control first")
    if action == "release":
        return ReleaseJog()
    max_age = MAX_JOG_AGE_NS if action == "jog" else MAX_MESSAGE_AGE_NS
    if type(shown_at) is not int or not 0 <= now - shown_at <= max_age:
        if action == "beat":
            return None
        raise MessageRefused("the displayed state is too old: press again")
    control.last_message_at = now
    try:
        return _decode_action(action, message, find)
    except BadInput as error:
        raise MessageRefused(str(error)) from error


def _decode_action(action: object, message: Table, find: FindPose) -> BrowserMessage:
    """Decode a valid message of the browser in control. `message` holds its arguments."""
    if isinstance(action, str) and action in PLAIN_MESSAGES:
        return PLAIN_MESSAGES[action]
    if isinstance(action, str) and action in DECODERS:
        return DECODERS[action](message, find)
    raise MessageRefused(f"unknown action {str(action)[:MAX_NAME_CHARACTERS]!r}")


def _parse_message(text: str) -> Table:
    if len(text) > MAX_MESSAGE_CHARACTERS:
        raise MessageRefused(f"the message is longer than {MAX_MESSAGE_CHARACTERS} characters")
    try:
        message: object = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise MessageRefused("the message is not JSON") from error
    if not is_table(message):
        raise MessageRefused("the message is not a JSON object")
    return message


def _pose_name(message: Table) -> str:
    return decode_settings(PoseArgument, message, "pose").name


def _find_target(name: str, find: FindPose) -> Target:
    target = find(name)
    if target is None:
        raise MessageRefused(f"there is no pose {name[:MAX_NAME_CHARACTERS]!r}")
    return target


def _decode_sequence(message: Table, find: FindPose) -> RunSequence:
    """Decode a pose sequence; all its poses must exist before it starts."""
    plan = decode_settings(SequencePlan, message, "sequence")
    return RunSequence(plan, tuple(_find_target(one.pose, find) for one in plan.waypoints))


DECODERS: dict[str, Callable[[Table, FindPose], BrowserMessage]] = {
    "jog": lambda message, _: decode_settings(
        JogMarker if "velocity" in message else JogJoints, message, "jog"
    ),
    "teach": lambda message, _: TeachPose(_pose_name(message)),
    "delete": lambda message, _: DeletePose(_pose_name(message)),
    "go": lambda message, find: Go(_find_target(_pose_name(message), find)),
    "sequence": _decode_sequence,
    "set": lambda message, _: decode_change(message.get("part"), message.get("table")),
    "disturb": lambda message, _: decode_settings(DisturbanceRequest, message, "disturbance"),
    "answer": lambda message, _: decode_settings(Reply, message, "answer"),
}
"""Decoders of the messages with arguments, by their action."""
