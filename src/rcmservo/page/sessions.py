"""Session after session on one arm, and the bell that stops them.

preparing ─► drive off ─ enable ─► the loop ─ its end ─► preparing
    ▲                                │ STOP, or it cannot go on
    └────────────── clear ◄── stopped, with the drive off
"""

from collections.abc import Callable, Mapping
from multiprocessing.connection import wait
from typing import Any

from rcmservo.errors import RcmServoError, Stopped
from rcmservo.live.loop_statistics import Report
from rcmservo.live.servo_process import Session
from rcmservo.live.supervisor import NOTHING, Beside, SwitchOff, run_live
from rcmservo.page.channels import Desk
from rcmservo.page.messages import CLEAR, STOP, Between, Change, Note


class Again(Stopped):
    """A session that was not enabled yet, and begins again with other settings."""


class Rung(Stopped):
    """The bell has ended a session."""


class Sessions:
    """Runs session after session. ``needed`` are processes without which none goes on, by their
    sentinels, and what they are. ``change`` takes other settings for the next one; ``beside`` is
    heard meanwhile.
    """

    def __init__(
        self,
        desk: Desk,
        session: Callable[[], Session],
        off: SwitchOff,
        needed: Mapping[int, str],
        change: Callable[[Change], None],
        beside: Beside = NOTHING,
    ) -> None:
        self._desk, self._session, self._off = desk, session, off
        self._change = change
        self._began, self._waits = False, False
        self._beside: dict[Any, Callable[[], None]] = {
            **beside,
            desk.bell: self._rung,
            desk.changes: self._changed,
        }
        for sentinel, name in needed.items():
            self._beside[sentinel] = lambda name=name: self._lost(name)

    def keep(self) -> None:
        """Run them, until something raises."""
        while True:
            why = self._run()
            if why:
                self._latch(why)

    def _run(self) -> str:
        """One session; why there can be no other before a person clears, empty where there can."""
        self._changed()
        self._began, self._waits = False, True
        self._desk.said.put(Between("preparing"))
        try:
            result = run_live(self._session(), self._off, self._report, self._beside)
        except Rung as rung:
            return str(rung)
        except Again:
            return ""
        except Stopped:  # by a signal, or for want of a process
            raise
        except RcmServoError as error:
            return str(error)
        if result.loop is None:
            return result.cause
        if result.drive_off:
            return f"the session is over: {result.drive_off}"
        self._desk.said.put(Note("the session is over, and the drive off"))
        return ""

    def _report(self, report: Report) -> None:
        self._began, self._waits = True, False

    def _rung(self) -> None:
        """Hear the bell while a session runs."""
        if STOP in list(self._desk.bell.heard()):
            why = f"STOP was pressed: {self._off(self._began)}"
            self._desk.said.put(Between(why, latched=True))
            raise Rung(why)

    def _changed(self) -> None:
        """Take other settings: a session that is not enabled begins again with them, one that is
        goes on, and the next one has them.
        """
        changes = list(self._desk.changes.heard())
        for change in changes:
            self._change(change)
        if changes and self._waits:
            self._waits = False
            raise Again("other settings were set")

    def _lost(self, name: str) -> None:
        raise Stopped(f"{name} has ended by itself; {self._off(self._began)}")

    def _latch(self, why: str) -> None:
        """Say why all stands still, until a person clears it."""
        self._waits = False
        list(self._desk.bell.heard())  # from before it could be cleared
        self._desk.said.put(Between(why, latched=True, clears=True))
        while True:
            for one in wait(list(self._beside)):
                if one is not self._desk.bell:
                    self._beside[one]()
            told = list(self._desk.bell.heard())
            if told and told[-1] == CLEAR:
                return
