"""Control of the arm by one browser, and validation of the messages from browsers.

One browser has control; the others watch. The server sends its time with each state that a browser
displays, and the browser returns the newest one in each message. A message about an outdated state
is refused.
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
from rcmservo.page.selected_settings import decode_change
from rcmservo.safety.state_machine import Request

MAX_MESSAGE_AGE_NS = 300_000_000
"""Largest age (ns) of the displayed state in a message."""

MAX_JOG_AGE_NS = 150_000_000
"""Largest age (ns) of the displayed state in a message that a jog button is held down."""

HOLDER_TIMEOUT_NS = 2_000_000_000
"""Time (ns) without a valid message after which the browser in control loses control on request."""

MAX_MESSAGE_CHARACTERS = 2000
"""Longest message in characters."""

MAX_NAME_CHARACTERS = 40
"""Longest name of a pose in characters."""

FindPose = Callable[[str], Target | None]
"""Function that returns the target of a pose by its name, or None."""


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
    last_message_ns : int
        Time (ns) of the holder's last valid message, or of the transfer of control.
    """

    holder: str = ""
    requester: str = ""
    last_message_ns: int = 0

    def join(self, now_ns: int) -> str:
        """Register a browser and return its name; it gets control if no browser has it."""
        name = secrets.token_hex(16)
        if not self.holder:
            self._assign(name, now_ns)
        return name

    def leave(self, name: str, now_ns: int) -> None:
        """Remove a browser; its control passes to the requester."""
        self.requester = "" if self.requester == name else self.requester
        if self.holder == name:
            self._assign(self.requester, now_ns)

    def request(self, name: str, now_ns: int) -> None:
        """Request control; it is transferred at once if the holder has been silent."""
        if not self.holder or now_ns - self.last_message_ns > HOLDER_TIMEOUT_NS:
            self._assign(name, now_ns)
        elif self.holder != name:
            self.requester = name

    def hand_over(self, name: str, now_ns: int) -> None:
        """Hand control over from the browser `name`, if it is the holder, to the requester."""
        if self.holder == name and self.requester:
            self._assign(self.requester, now_ns)

    def _assign(self, name: str, now_ns: int) -> None:
        self.holder, self.requester, self.last_message_ns = name, "", now_ns


def interpret_message(
    text: str, name: str, ownership: ControlOwnership, find_pose: FindPose, now_ns: int
) -> BrowserMessage | None:
    """Return the request in a browser's message.

    Parameters
    ----------
    text : str
        Message: a JSON object with `do` (action), `at` (time of the displayed state in ns) and
        arguments.
    name : str
        Name of the browser.
    ownership : ControlOwnership
        Ownership, which this call updates.
    find_pose : callable
        Returns the target of a pose by its name, or None.
    now_ns : int
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
    arguments = _parse_message(text)
    action, displayed_ns = arguments.pop("do", None), arguments.pop("at", None)
    if action == "request_control":
        return ownership.request(name, now_ns)
    if action == "hand_over":
        return ownership.hand_over(name, now_ns)
    if name != ownership.holder:
        raise MessageRefused("another browser has control: request control first")
    if action == "release":
        return ReleaseJog()
    max_age_ns = MAX_JOG_AGE_NS if action == "jog" else MAX_MESSAGE_AGE_NS
    if type(displayed_ns) is not int or not 0 <= now_ns - displayed_ns <= max_age_ns:
        if action == "beat":
            return None
        raise MessageRefused("the displayed state is too old: press again")
    ownership.last_message_ns = now_ns
    if not isinstance(action, str) or action not in DECODERS:
        raise MessageRefused(f"unknown action {str(action)[:MAX_NAME_CHARACTERS]!r}")
    try:
        return DECODERS[action](arguments, find_pose)
    except BadInput as error:
        raise MessageRefused(str(error)) from error


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


def _decode_pose_name(arguments: Table) -> str:
    return decode_settings(PoseArgument, arguments, "pose").name


def _find_target(name: str, find_pose: FindPose) -> Target:
    target = find_pose(name)
    if target is None:
        raise MessageRefused(f"there is no pose {name[:MAX_NAME_CHARACTERS]!r}")
    return target


def _decode_sequence(arguments: Table, find_pose: FindPose) -> RunSequence:
    """Decode a pose sequence; all its poses must exist before it starts."""
    plan = decode_settings(SequencePlan, arguments, "sequence")
    targets = (_find_target(waypoint.pose, find_pose) for waypoint in plan.waypoints)
    return RunSequence(plan, tuple(targets))


DECODERS: dict[str, Callable[[Table, FindPose], BrowserMessage]] = {
    "beat": lambda _, __: Heartbeat(),
    "enable": lambda _, __: Enable(),
    "teach_again": lambda _, __: TeachPose(""),
    "pause": lambda _, __: Request.PAUSE,
    "resume": lambda _, __: Request.RESUME,
    "clear": lambda _, __: Request.CLEAR,
    "jog": lambda arguments, _: decode_settings(
        JogMarker if "velocity" in arguments else JogJoints, arguments, "jog"
    ),
    "teach": lambda arguments, _: TeachPose(_decode_pose_name(arguments)),
    "delete": lambda arguments, _: DeletePose(_decode_pose_name(arguments)),
    "go": lambda arguments, find_pose: Go(_find_target(_decode_pose_name(arguments), find_pose)),
    "sequence": _decode_sequence,
    "set": lambda arguments, _: decode_change(arguments.get("part"), arguments.get("table")),
    "disturb": lambda arguments, _: decode_settings(DisturbanceRequest, arguments, "disturbance"),
    "answer": lambda arguments, _: decode_settings(Reply, arguments, "answer"),
}
"""Decoders of a message's arguments, by its action `do`."""
