"""An arm that speaks CRTK, as the loop has it: rates become positions that it is asked to be at.

Its drive is on or off by its own word alone. Whatever ends our having it (a command that is not
enabled, none before the last one's deadline, somebody else who moves it, words that cannot be
believed) is followed by "disable", again and again until it says that it is off. Many such arms
have no watchdog: one goes to where it was asked to be last, within its lead, and stands there.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from rcmservo.errors import one_line
from rcmservo.hardware.crtk import messages as m
from rcmservo.hardware.crtk.account import CommandAccount
from rcmservo.hardware.crtk.connection import open_transport
from rcmservo.hardware.crtk.hearsay import ENABLED, FRESH, Hearsay, ToldJoints
from rcmservo.hardware.crtk.lead import Lead
from rcmservo.hardware.crtk.settings import CrtkSettings
from rcmservo.hardware.crtk.transport import Transport
from rcmservo.interfaces import Command, Floats, Measured
from rcmservo.live.lab import NotReady
from rcmservo.method.kinematics import JointLimits

BEGIN = 1_000_000_000
"""ns after it was enabled within which commands must begin."""
FOUND_WITHIN = 10.0
"""s within which its topics must be heard."""
AGAIN = 100_000_000
"""ns after which an arm that is to be off is told so again,"""
OVERDUE = 2_000_000_000
"""ns, and after which a person is to see to it."""
WATCH = 0.005
"""s between two looks at the deadline."""
FOREIGN = 500_000_000
"""ns after which what somebody else sent counts no more."""

HOMES_ITSELF = "knows where it stands from its own homing: home it there"
JUMPED = "told a place far from where it was asked to be, or stands beyond a limit"
"""Of an arm whose next setpoint would be a jump."""


class CrtkArm:
    """An arm reached by a transport, which it closes in the end."""

    def __init__(
        self,
        settings: CrtkSettings,
        limits: JointLimits,
        transport: Transport,
        now: Callable[[], int] = time.monotonic_ns,
        real: Callable[[], int] = time.time_ns,
    ) -> None:
        self.settings = settings
        self._transport, self._now, self._real = transport, now, real
        self._signs = np.array(settings.signs)
        self._motion = m.SERVO_JV if settings.jv else m.SERVO_JP
        self._told = threading.Condition()
        self._hearsay = Hearsay(settings.namespace)
        self._lead = Lead(np.array(settings.lead), limits)
        self._wrist: tuple[float, ...] = ()
        self._account, self._why = CommandAccount(), ""
        self._having, self._number, self._deadline, self._silent = False, -1, 0, False
        self._off_since = self._off_said = self._foreign = 0
        self._insisting = self._overdue = False
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="crtk", daemon=True)
        try:
            self._listen()
        except BaseException:
            self._transport.close()
            raise
        self._thread.start()

    @property
    def why_off(self) -> str:
        """Why the drive went off by itself, in a sentence; empty where it did not."""
        on = f"{self._name} does not say that it is off: use its emergency stop"
        return "; ".join(
            filter(None, (self._hearsay.trouble or self._why, on if self._overdue else ""))
        )

    def account(self) -> CommandAccount:
        """What became of all commands so far."""
        with self._told:
            return replace(self._account, warned=self._hearsay.warnings, stale=self._hearsay.stale)

    def homed(self) -> bool:
        """Whether the arm says that it knows where it stands: if not, :class:`NotReady`, for no
        person can say it."""
        state = self._hearsay.state
        if state is not None and not state.is_homed:
            raise NotReady(f"{self._name} {HOMES_ITSELF}")
        return state is not None

    def define(self, q: Floats) -> None:
        """No: the arm homes itself."""
        raise NotReady(f"{self._name} {HOMES_ITSELF}")

    def enable(self) -> None:
        """Switch the drive on, at rest; if that fails, off again."""
        with self._told:
            self._ready()
            self._why, self._silent = "", False
            self._insisting = self._overdue = False
            try:
                if self._hearsay.state is not None and self._hearsay.state.state == ENABLED:
                    self._say("disable")
                    self._await(lambda: not self._hearsay.powered, "does not switch off")
                self._say("enable")
                self._await(lambda: self._hearsay.on, "does not switch on")
                here = self._awaited()
            except BaseException:
                self._off("")
                raise
            now = self._now()
            self._lead.anchor(m.in_rad_and_mm(here.position, self._signs), now)
            self._wrist = here.position[3:]
            self._having, self._number, self._deadline = True, -1, now + BEGIN

    def measure(self) -> Measured:
        """What the arm told last."""
        told = self._hearsay.joints
        assert told is not None
        q = m.in_rad_and_mm(told.position, self._signs)
        return Measured(told.time, q, self._hearsay.on)

    def apply(self, command: Command) -> Floats:
        """Pass a command on; the joint rates (3,) that are taken of it."""
        with self._told:
            if not command.enabled:
                if self._having:
                    self._off("")
                return np.zeros(3)
            if not self._valid(command):
                self._account = replace(self._account, refused=self._account.refused + 1)
                return np.zeros(3)
            self._number, self._deadline = command.number, command.deadline
            took = self._moved(command.rates)
            if took is None:
                self._account = replace(self._account, withheld=self._account.withheld + 1)
                return np.zeros(3)
            self._account = replace(self._account, sent=self._account.sent + 1)
            return took

    @property
    def by_speeds(self) -> bool:
        """Whether it is sent speeds."""
        return self.settings.jv

    def fall_silent(self) -> None:
        """Say nothing, as if this program were dead, until it is to be switched off or on."""
        with self._told:
            self._silent = True

    def close(self) -> None:
        """Switch off what we have, and hang up."""
        with self._told:
            if self._having:
                self._off("")
            if self._insisting:
                within = self.settings.answer_within
                self._overdue = not self._told.wait_for(lambda: not self._hearsay.powered, within)
        self._over.set()
        self._thread.join()
        self._transport.close()

    @property
    def _name(self) -> str:
        return self.settings.namespace

    @property
    def _last_words(self) -> str:
        """What it warned of last, to be added to a sentence."""
        warned = self._hearsay.warning
        return f"; it said last: {one_line(warned)}" if warned else ""

    def _listen(self) -> None:
        """Hear the arm until it has said where and how it is, and hears us."""
        mine: list[m.Topic[Any]] = [
            self._motion.under(self._name),
            m.STATE_COMMAND.under(self._name),
        ]
        for topic in mine:
            self._transport.offer(topic)
        self._transport.subscribe(m.MEASURED_JS.under(self._name), self._hear_joints)
        self._transport.subscribe(m.OPERATING_STATE.under(self._name), self._hear_state)
        for topic in (m.WARNING, m.ERROR):
            self._transport.subscribe(topic.under(self._name), self._hear_warning)
        with self._told:
            self._told.wait_for(lambda: not self._missing(mine), FOUND_WITHIN)
            missing = self._missing(mine)
            if missing:
                s = self.settings
                where = f"ROS 2, domain {s.domain} on {s.interface}" if s.ros == 2 else "ROS 1"
                raise NotReady(self._hearsay.trouble or f"{missing} by {where}")
        for topic in m.MOTIONS:
            self._transport.subscribe(topic.under(self._name), self._hear_motion)

    def _missing(self, mine: list[m.Topic[Any]]) -> str:
        """What has not been found yet, in words; empty where all was."""
        deaf = [topic.name for topic in mine if not self._transport.listeners(topic)]
        return self._hearsay.missing or (f"nobody hears {deaf[0]}" if deaf else "")

    def _hear_joints(self, said: m.JointState, writer: str) -> None:
        with self._told:
            self._hearsay.hear_joints(said, writer, self._now(), self._real())
            self._believe()

    def _hear_state(self, said: m.OperatingState, writer: str) -> None:
        with self._told:
            self._hearsay.hear_state(said, writer, self._real())
            if self._having and self._hearsay.powered and not self._hearsay.on:
                self._off(f"{self._name} is no longer homed, and it was switched off")
            elif self._having and not self._hearsay.on:
                self._having = False
                self._why = f"{self._name} went {said.state} by itself{self._last_words}"
            self._believe()

    def _hear_warning(self, said: m.StringStamped, writer: str) -> None:
        with self._told:
            self._hearsay.hear_warning(said, writer)

    def _hear_motion(self, said: m.RosMessage, writer: str) -> None:
        """Somebody else would move the arm."""
        with self._told:
            self._foreign = self._now()
            if self._having:
                self._off(f"somebody else sends {self._name} where to go, and it was switched off")

    def _believe(self) -> None:
        if self._having and self._hearsay.trouble:
            self._off(self._hearsay.trouble)
        self._told.notify_all()

    def _ready(self) -> None:
        """Whether it may be enabled at all."""
        hearsay = self._hearsay
        if hearsay.trouble:
            raise NotReady(hearsay.trouble)
        if self._over.is_set():
            raise NotReady(f"{self._name} was hung up: connect again")
        self._awaited()
        state = hearsay.state
        if state is None or not state.is_homed:
            raise NotReady(f"{self._name} is not homed: home it with its own software")
        if state.state not in ("DISABLED", ENABLED):
            words = f"{self._name} is {state.state}: a person must clear that first"
            raise NotReady(words + self._last_words)
        if self._foreign and self._now() - self._foreign < FOREIGN:
            raise NotReady(f"somebody else moves {self._name}: end that first")

    def _here(self) -> ToldJoints | None:
        """Where it is, if it has just said so."""
        told = self._hearsay.joints
        return told if told is not None and self._now() - told.time <= FRESH else None

    def _awaited(self) -> ToldJoints:
        """Where it is, as soon as it says so."""
        doubt = self._hearsay.doubts.get(m.MEASURED_JS.name)
        words = "does not say where it is" + (f": {doubt}" if doubt else "")
        self._await(lambda: self._here() is not None, words)
        told = self._hearsay.joints
        assert told is not None
        return told

    def _await(self, reached: Callable[[], bool], otherwise: str) -> None:
        if not self._told.wait_for(reached, self.settings.answer_within):
            raise NotReady(f"{self._name} {otherwise}{self._last_words}")

    def _valid(self, command: Command) -> bool:
        return (
            self._having
            and not self._silent
            and command.number > self._number
            and self._now() <= min(command.deadline, self._deadline)
            and command.rates.shape == (3,)
            and bool(np.isfinite(command.rates).all())
        )

    def _moved(self, rates: Floats) -> Floats | None:
        """Send what these rates come to; what is taken of them, None where nothing went out."""
        told = self._here()
        if self.settings.jv:
            sent = self._sent_speeds(np.zeros(3) if told is None else rates)
            return rates.copy() if sent and told is not None else None
        if told is None:
            return None
        now, stamp = self._now(), self._real()
        measured = m.in_rad_and_mm(told.position, self._signs)
        step = self._lead.step(rates, measured, now)
        if step is None:
            self._off(f"{self._name} {JUMPED}, and it was switched off")
            return None
        setpoint, took = step
        position = (*m.in_rad_and_m(setpoint, self._signs), *self._wrist)
        return took if self._publish(m.JointState(stamp, told.name, position)) else None

    def _sent_speeds(self, rates: Floats) -> bool:
        """Whether these rates went out."""
        told = self._hearsay.joints
        names = () if told is None else told.name
        velocity = (*m.in_rad_and_m(rates, self._signs), *(0.0 for _ in self._wrist))
        return self._publish(m.JointState(self._real(), names, velocity=velocity))

    def _publish(self, said: m.JointState) -> bool:
        return self._transport.publish(self._motion.under(self._name), said)

    def _say(self, word: str) -> None:
        said = m.StringStamped(self._real(), word)
        self._transport.publish(m.STATE_COMMAND.under(self._name), said)

    def _off(self, why: str) -> None:
        """Have it no more, and have it switched off: one that goes on by its last speed first comes
        to rest."""
        if self._having and self.settings.jv:
            self._sent_speeds(np.zeros(3))
        self._having, self._silent, self._why = False, False, why or self._why
        self._insisting, self._off_since = True, self._now()
        self._say_off()

    def _say_off(self) -> None:
        self._off_said = self._now()
        self._say("disable")

    def _watch(self) -> None:
        """Switch off what no command came for in time, and see to it that it goes off."""
        while not self._over.wait(WATCH):
            with self._told:
                self.look_after()

    def look_after(self) -> None:
        """One look at the deadline, and at an arm that is to be off."""
        now = self._now()
        if self._silent:
            return
        if self._having and not now <= self._deadline:
            self._off(f"no command came in time, and {self._name} was switched off")
        elif self._insisting and now - self._off_said >= AGAIN:
            self._insisting = self._hearsay.powered
            self._overdue = self._insisting and now - self._off_since >= OVERDUE
            if self._insisting:
                self._say_off()


def crtk_arm(settings: CrtkSettings, limits: JointLimits) -> CrtkArm:
    """Connect to the arm by the ROS that its settings name."""
    transport = open_transport(settings)
    return CrtkArm(settings, limits, transport)
