"""Session after session on one arm, and the bell that stops them.

preparing ─► drive off ─ enable ─► the loop ─ its end ─► preparing
    ▲                                │ STOP, or it cannot go on
    └────────────── clear ◄── stopped, with the drive off
"""

from collections.abc import Callable
from multiprocessing.connection import wait
from typing import Any, cast

from rcmservo.errors import RcmServoError
from rcmservo.live.lab import Stopped
from rcmservo.live.servo_process import Session
from rcmservo.live.supervisor import SwitchOff, run_live
from rcmservo.page.desk import Desk
from rcmservo.page.wants import CLEAR, END, STOP, Between


class Rung(Stopped):
    """The bell has ended a session."""


class Sessions:
    """Runs session after session until it is told to end."""

    def __init__(self, desk: Desk, session: Callable[[], Session], off: SwitchOff) -> None:
        self._desk, self._session, self._off = desk, session, off
        self._ended = self._cleared = False

    def keep(self) -> None:
        """Run them."""
        while not self._ended:
            why = self._run()
            if why and not self._ended:
                self._latch(why)

    def _run(self) -> str:
        """One session; why there can be no other before a person clears, empty where there can."""
        self._desk.said.put(Between("preparing"))
        try:
            result = run_live(self._session(), self._off, beside={self._desk.bell: self._rung})
        except Rung as rung:
            return str(rung)
        except Stopped:  # by a signal
            raise
        except RcmServoError as error:
            return str(error)
        return "" if result.timing is not None else result.outcome.cause

    def _rung(self) -> None:
        """Hear the bell while a session runs."""
        for told in self._desk.bell.heard():
            if told == STOP:
                why = f"STOP was pressed: {self._off(True)}"
                self._desk.said.put(Between(why, latched=True))
                raise Rung(why)
            if told == END:
                self._ended = True
                raise Rung("ended")

    def _latch(self, why: str) -> None:
        """Say why all stands still, until a person clears it."""
        self._desk.said.put(Between(why, latched=True))
        self._cleared = False
        while not (self._cleared or self._ended):
            wait([cast(Any, self._desk.bell)])
            for told in self._desk.bell.heard():
                self._cleared |= told == CLEAR
                self._ended |= told == END
