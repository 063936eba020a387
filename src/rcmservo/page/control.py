"""Who may move the arm by the page, and what counts as said by that person.

One browser has control and the others watch. Every message tells the newest moment that the server
has shown to that browser: what was said to a page long gone is said no more.
"""

import json
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rcmservo.config.decode import decode
from rcmservo.config.texts import is_table
from rcmservo.errors import BadInput
from rcmservo.guard.states import Request
from rcmservo.interfaces import Target
from rcmservo.page.settings import change_of
from rcmservo.page.tour import GoOnTour, Plan
from rcmservo.page.wants import (
    Beat,
    Change,
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

FRESH, FRESH_JOG = 300_000_000, 150_000_000
"""ns for which what the server has shown counts as seen now; by a hand that jogs."""

SILENT = 2_000_000_000
"""ns without a fresh message after which who has control loses it to whoever asks."""

LONGEST = 2000
"""Characters of a message."""

NAME = 40
"""Characters of a pose's name."""

PLAIN: dict[str, Told] = {
    "beat": Beat(),
    "enable": Enable(),
    "show": TeachAs(""),
    "pause": Request.PAUSE,
    "resume": Request.RESUME,
    "clear": Request.CLEAR,
}
"""What messages want that say no more,"""

NAMED: dict[str, Callable[[str], Told]] = {"teach": TeachAs, "delete": Delete}
"""and those that name a pose."""


class Unheeded(Exception):
    """A message that is not heeded, and why."""


@dataclass
class Control:
    """Who has control: a browser by what it was named at random, or nobody."""

    holder: str = ""
    """Its name; empty where nobody has control."""
    asking: str = ""
    """Who asks for it while somebody else has it."""
    heard: int = 0
    """ns, when the holder last said something fresh, or came to be the holder."""

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


def heard(
    text: str, name: str, control: Control, pose: Callable[[str], Target | None], now: int
) -> Told | None:
    """What a browser wants of the servo; None for what is settled between browsers, and for a sign
    of life that comes too late: nobody pressed anything. `pose` finds a target by its name."""
    message = _message(text)
    do = message.get("do")
    if do == "ask":
        return control.ask(name, now)
    if do == "give":
        return control.give(name, now)
    if name != control.holder:
        raise Unheeded("another browser has control: ask for it")
    if do == "release":
        return Released()
    at = message.get("at")
    if type(at) is not int or not 0 <= now - at <= (FRESH_JOG if do == "jog" else FRESH):
        if do == "beat":
            return None
        raise Unheeded("it came too late to count")
    control.heard = now
    return _told(do, message, pose)


def _told(do: object, message: dict[str, Any], pose: Callable[[str], Target | None]) -> Told:
    if not isinstance(do, str):
        raise Unheeded(f"nobody knows what {str(do)[:NAME]!r} is")
    if do == "go":
        return Go(_known(_name(message.get("name")), pose))
    if do == "tour":
        return _tour(message, pose)
    if do in NAMED:
        return NAMED[do](_name(message.get("name")))
    if do in PLAIN:
        return PLAIN[do]
    if do in (read := {"jog": _held, "set": _change, "trouble": _wrong, "answer": _answer}):
        return read[do](message)
    raise Unheeded(f"nobody knows what {do[:NAME]!r} is")


def _message(text: str) -> dict[str, Any]:
    if len(text) > LONGEST:
        raise Unheeded("it is too long")
    try:
        message: object = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise Unheeded("it is no JSON") from error
    if not is_table(message):
        raise Unheeded("it is no JSON object")
    return message


def _held(message: dict[str, Any]) -> Held | Led:
    """The joints by their rates, or marker 1 by its velocity."""
    table = {key: value for key, value in message.items() if key not in ("do", "at")}
    try:
        return decode(Led if "velocity" in table else Held, table, "jog")
    except BadInput as error:
        raise Unheeded(str(error)) from error


def _change(message: dict[str, Any]) -> Change:
    try:
        return change_of(message.get("box"), message.get("table"))
    except BadInput as error:
        raise Unheeded(str(error)) from error


def _wrong(message: dict[str, Any]) -> Wrong:
    try:
        return decode(Wrong, {"what": message.get("what")}, "trouble")
    except BadInput as error:
        raise Unheeded(str(error)) from error


def _answer(message: dict[str, Any]) -> Reply:
    try:
        told = {key: message.get(key) for key in ("question", "words")}
        return decode(Reply, told, "answer")
    except BadInput as error:
        raise Unheeded(str(error)) from error


def _name(name: object) -> str:
    good = isinstance(name, str) and 0 < len(name) <= NAME and name.isprintable()
    if not good or str(name) != str(name).strip():
        raise Unheeded(f"a pose's name has 1 to {NAME} characters")
    return str(name)


def _known(called: str, pose: Callable[[str], Target | None]) -> Target:
    target = pose(called)
    if target is None:
        raise Unheeded(f"there is no pose {called[:NAME]!r}")
    return target


def _tour(message: dict[str, Any], pose: Callable[[str], Target | None]) -> GoOnTour:
    """All its poses are known before it begins."""
    try:
        plan = decode(Plan, {key: message.get(key) for key in ("stops", "rounds")}, "tour")
    except BadInput as error:
        raise Unheeded(str(error)) from error
    return GoOnTour(plan, tuple(_known(stop.pose, pose) for stop in plan.stops))


def moment() -> int:
    """Now, ns, as it is shown to browsers."""
    return time.monotonic_ns()
