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
from rcmservo.page.messages import CLEAR, STOP, Change, Note, Standby


class SessionRestart(Stopped):
    """A session that was not enabled yet, and begins again with other settings."""


class StopPressed(Stopped):
    """The bell has ended a session."""


class Sessions:
    """Runs session after session. ``needed`` are processes without which none goes on, by their
    sentinels, and what they are. ``change`` takes other settings for the next one; ``beside`` is
    heard meanwhile.
    """

    def __init__(
        self,
        channels: Desk,
        session: Callable[[], Session],
        switch_off: SwitchOff,
        needed: Mapping[int, str],
        change: Callable[[Change], None],
        handlers: Beside = NOTHING,
    ) -> None:
        self._channels, self._session, self._switch_off = channels, session, switch_off
        self._change = change
        self._has_begun, self._is_waiting = False, False
        self._handlers: dict[Any, Callable[[], None]] = {
            **handlers,
            channels.bell: self._handle_stop_request,
            channels.changes: self._apply_changes,
        }
        for sentinel, name in needed.items():
            self._handlers[sentinel] = lambda name=name: self._report_lost_process(name)

    def keep(self) -> None:
        """Run them, until something raises."""
        while True:
            reason = self._run()
            if reason:
                self._latch(reason)

    def _run(self) -> str:
        """One session; why there can be no other before a person clears, empty where there can."""
        self._apply_changes()
        self._has_begun, self._is_waiting = False, True
        self._channels.said.put(Standby("preparing"))
        try:
            result = run_live(self._session(), self._switch_off, self._report, self._handlers)
        except StopPressed as rung:
            return str(rung)
        except SessionRestart:
            return ""
        except Stopped:  # by a signal, or for want of a process
            raise
        except RcmServoError as error:
            return str(error)
        if result.loop is None:
            return result.cause
        if result.drive_off:
            return f"the session is over: {result.drive_off}"
        self._channels.said.put(Note("the session is over, and the drive off"))
        return ""

    def _report(self, report: Report) -> None:
        self._has_begun, self._is_waiting = True, False

    def _handle_stop_request(self) -> None:
        """Hear the bell while a session runs."""
        if STOP in list(self._channels.bell.heard()):
            reason = f"STOP was pressed: {self._switch_off(self._has_begun)}"
            self._channels.said.put(Standby(reason, latched=True))
            raise StopPressed(reason)

    def _apply_changes(self) -> None:
        """Take other settings: a session that is not enabled begins again with them, one that is
        goes on, and the next one has them.
        """
        changes = list(self._channels.changes.heard())
        for change in changes:
            self._change(change)
        if changes and self._is_waiting:
            self._is_waiting = False
            raise SessionRestart("other settings were set")

    def _report_lost_process(self, name: str) -> None:
        raise Stopped(f"{name} has ended by itself; {self._switch_off(self._has_begun)}")

    def _latch(self, reason: str) -> None:
        """Say why all stands still, until a person clears it."""
        self._is_waiting = False
        list(self._channels.bell.heard())  # from before it could be cleared
        self._channels.said.put(Standby(reason, latched=True, can_clear=True))
        while True:
            for handle in wait(list(self._handlers)):
                if handle is not self._channels.bell:
                    self._handlers[handle]()
            requests = list(self._channels.bell.heard())
            if requests and requests[-1] == CLEAR:
                return
