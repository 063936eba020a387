"""Consecutive sessions on one arm, and the stop requests that end them.

preparing ─► drive off ─ Enable ─► servo loop ─ end of the session ─► preparing
    ▲                                  │ STOP, or an error
    └────────────── Clear ◄────── stopped, with the drive off

A session is one servo process, from its start to its end. `SessionLoop` runs in the supervisor.
"""

from collections.abc import Callable, Mapping
from multiprocessing.connection import wait
from typing import Any

from rcmservo.errors import RcmServoError, Stopped
from rcmservo.live.loop_statistics import Report
from rcmservo.live.servo_process import Session
from rcmservo.live.supervisor import NO_HANDLERS, EventHandlers, SwitchOff, run_live
from rcmservo.page.channels import PageChannels
from rcmservo.page.messages import CLEAR, STOP, Note, SettingsChange, Standby


class SessionRestart(Stopped):
    """End of a session that was not enabled yet, to restart it with changed settings."""


class StopPressed(Stopped):
    """End of a session by a stop request."""


class SessionLoop:
    """Loop that runs one session after another until an exception ends it.

    Parameters
    ----------
    channels : PageChannels
        Channels to the page.
    create_session : callable
        Returns the next session.
    switch_off : callable
        Switches the drive off from outside the servo process and returns the result in words.
    needed_processes : mapping
        Names of the processes that every session needs, by their sentinels.
    change_settings : callable
        Applies changed settings to the next session.
    handlers : mapping, optional
        Functions to call when further channels have a message.
    """

    def __init__(
        self,
        channels: PageChannels,
        create_session: Callable[[], Session],
        switch_off: SwitchOff,
        needed_processes: Mapping[int, str],
        change_settings: Callable[[SettingsChange], None],
        handlers: EventHandlers = NO_HANDLERS,
    ) -> None:
        self._channels, self._switch_off = channels, switch_off
        self._create_session, self._change_settings = create_session, change_settings
        self._has_been_enabled, self._can_restart = False, False
        self._handlers: dict[Any, Callable[[], None]] = {
            **handlers,
            channels.stop_requests: self._handle_stop_request,
            channels.settings_changes: self._apply_changes,
        }
        for sentinel, name in needed_processes.items():
            self._handlers[sentinel] = lambda name=name: self._raise_lost_process(name)

    def run(self) -> None:
        """Run sessions until an exception ends them."""
        while True:
            reason = self._run_session()
            if reason:
                self._await_clear(reason)

    def _run_session(self) -> str:
        """Run one session. Return the reason if the operator must clear first, or ""."""
        self._apply_changes()
        self._has_been_enabled, self._can_restart = False, True
        self._channels.status.send(Standby("preparing"))
        try:
            result = run_live(
                self._create_session(), self._switch_off, self._note_enabled, self._handlers
            )
        except StopPressed as stop:
            return str(stop)
        except SessionRestart:
            return ""
        except Stopped:  # by a signal, or because a process has ended
            raise
        except RcmServoError as error:
            return str(error)
        if result.loop is None:
            return result.cause
        if result.drive_off:
            return f"the session is over: {result.drive_off}"
        self._channels.status.send(Note("the session is over and the drive is off"))
        return ""

    def _note_enabled(self, _: Report) -> None:
        """Note at a report of the servo loop that the drive has been enabled."""
        self._has_been_enabled, self._can_restart = True, False

    def _handle_stop_request(self) -> None:
        """End the running session if STOP was pressed."""
        if STOP in self._channels.stop_requests.receive_all():
            reason = f"STOP was pressed: {self._switch_off(self._has_been_enabled)}"
            self._channels.status.send(Standby(reason, is_latched=True))
            raise StopPressed(reason)

    def _apply_changes(self) -> None:
        """Apply changed settings to the next session, and restart one that is not enabled yet."""
        changes = self._channels.settings_changes.receive_all()
        for change in changes:
            self._change_settings(change)
        if changes and self._can_restart:
            self._can_restart = False
            raise SessionRestart("the settings have changed")

    def _raise_lost_process(self, name: str) -> None:
        raise Stopped(f"{name} has ended by itself; {self._switch_off(self._has_been_enabled)}")

    def _await_clear(self, reason: str) -> None:
        """Display the reason of a stop and wait until the operator clears it."""
        self._can_restart = False
        self._channels.stop_requests.receive_all()  # discards requests from before this display
        self._channels.status.send(Standby(reason, is_latched=True, can_clear=True))
        while True:
            for channel in wait(list(self._handlers)):
                if channel is not self._channels.stop_requests:
                    self._handlers[channel]()
            if self._channels.stop_requests.receive_all()[-1:] == [CLEAR]:
                return
