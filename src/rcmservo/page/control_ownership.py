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
    Beat,
    Delete,
    Enable,
    Go,
    Held,
    Led,
    Released,
    Reply,
    TeachAs,
    Told,
    Wrong,
)
from rcmservo.page.settings import change_of
from rcmservo.page.pose_sequence import GoOnTour, Plan
from rcmservo.safety.state_machine import Request

FRESH, FRESH_JOG = 300_000_000, 150_000_000
"""ns for which what the server has shown counts as seen now; by a hand that jogs."""

SILENT = 2_000_000_000
"""ns without a fresh message after which who has control loses it to whoever asks."""

LONGEST = 2000
"""Characters of a message."""

NAME = 40
"""Characters of a pose's name."""


def _is_name(text: str) -> bool:
    return 0 < len(text) <= NAME and text.isprintable() and text == text.strip()


@dataclass(frozen=True)
class Named(Checked):
    """Arguments of a message that names a pose.

    Parameters
    ----------
    name : str
        The pose.
    """

    name: Annotated[str, Limit(_is_name, f"a name of 1 to {NAME} characters")]


PLAIN: dict[str, Told] = {
    "beat": Beat(),
    "enable": Enable(),
    "show": TeachAs(""),
    "pause": Request.PAUSE,
    "resume": Request.RESUME,
    "clear": Request.CLEAR,
}
"""Messages without arguments."""

FindPose = Callable[[str], Target | None]


class Unheeded(Exception):
    """A message that is not heeded, and why."""


@dataclass
class Control:
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
    asking: str = ""
    heard: int = 0

    def join(self, now: int) -> str:
        """Another browser; it has control if nobody has."""
        name = secrets.token_hex(16)
        if not self.holder:
            self._hand(name, now)
        return name

    def leave(self, name: str, now: int) -> None:
        """A browser is gone; who asks for control gets what it had."""
        self.asking = "" if self.asking == name else self.asking
        if self.holder == name:
            self._hand(self.asking, now)

    def ask(self, name: str, now: int) -> None:
        """A browser asks for control; it has it at once where the holder is silent."""
        if not self.holder or now - self.heard > SILENT:
            self._hand(name, now)
        elif self.holder != name:
            self.asking = name

    def give(self, name: str, now: int) -> None:
        """Who has control gives it to who asks for it."""
        if self.holder == name and self.asking:
            self._hand(self.asking, now)

    def _hand(self, name: str, now: int) -> None:
        self.holder, self.asking, self.heard = name, "", now


def heard(text: str, name: str, control: Control, find: FindPose, now: int) -> Told | None:
    """What a browser wants of the servo; None for what is settled between browsers, and for a sign
    of life that comes too late: nobody pressed anything. `find` finds a target by its name.
    """
    message = _message(text)
    do, at = message.pop("do", None), message.pop("at", None)
    if do == "ask":
        return control.ask(name, now)
    if do == "give":
        return control.give(name, now)
    if name != control.holder:
        raise Unheeded("another browser has control: ask for it")
    if do == "release":
        return Released()
    if type(at) is not int or not 0 <= now - at <= (FRESH_JOG if do == "jog" else FRESH):
        if do == "beat":
            return None
        raise Unheeded("it came too late to count")
    control.heard = now
    try:
        return _told(do, message, find)
    except BadInput as error:
        raise Unheeded(str(error)) from error


def _told(do: object, message: Table, find: FindPose) -> Told:
    """Return a fresh message of the browser in control. `message` holds its arguments."""
    if isinstance(do, str) and do in PLAIN:
        return PLAIN[do]
    if isinstance(do, str) and do in READERS:
        return READERS[do](message, find)
    raise Unheeded(f"nobody knows what {str(do)[:NAME]!r} is")


def _message(text: str) -> Table:
    if len(text) > LONGEST:
        raise Unheeded("it is too long")
    try:
        message: object = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise Unheeded("it is no JSON") from error
    if not is_table(message):
        raise Unheeded("it is no JSON object")
    return message


def _name(message: Table) -> str:
    return decode(Named, message, "pose").name


def _known(name: str, find: FindPose) -> Target:
    target = find(name)
    if target is None:
        raise Unheeded(f"there is no pose {name[:NAME]!r}")
    return target


def _tour(message: Table, find: FindPose) -> GoOnTour:
    """All its poses are known before it begins."""
    plan = decode(Plan, message, "tour")
    return GoOnTour(plan, tuple(_known(stop.pose, find) for stop in plan.stops))


READERS: dict[str, Callable[[Table, FindPose], Told]] = {
    "jog": lambda message, _: decode(Led if "velocity" in message else Held, message, "jog"),
    "teach": lambda message, _: TeachAs(_name(message)),
    "delete": lambda message, _: Delete(_name(message)),
    "go": lambda message, find: Go(_known(_name(message), find)),
    "tour": _tour,
    "set": lambda message, _: change_of(message.get("box"), message.get("table")),
    "trouble": lambda message, _: decode(Wrong, message, "trouble"),
    "answer": lambda message, _: decode(Reply, message, "answer"),
}
"""Messages with arguments."""
