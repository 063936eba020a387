"""What an arm's driver says to a Galil controller, in which order.

    set up      whoever has the arm already is left alone; the motors go off, settings and the
                watchdog program are sent
    define      a person says where the arm stands, after each reset of the controller
    start       settings and program are sent anew; it runs, the motors go on, and it has the axes
                servo at rest
    exchange    speeds, counted for the watchdog, and the data record behind them
    switch off  the axes come to rest by their own deceleration, then the motors go off

It waits for every answer. Source: command reference; docs/galil.md tells what was tried.
"""

import contextlib
from dataclasses import dataclass

import numpy as np

from rcmservo.errors import RcmServoError, require
from rcmservo.errors import told as words
from rcmservo.hardware.galil import amplifier, reasons
from rcmservo.hardware.galil import data_record as record
from rcmservo.hardware.galil import watchdog_program as program
from rcmservo.hardware.galil.sample_clock import MICROSECONDS, SampleClock
from rcmservo.hardware.galil.settings import GalilSettings
from rcmservo.hardware.galil.wire import Conversation, Rejected
from rcmservo.interfaces import Floats
from rcmservo.live.lab import NotReady
from rcmservo.method.kinematics import JointLimits

HOMED = "rcmhome"
"""A variable in the controller's memory: by which counts and axes somebody has said where the arm
stands. It is gone after a reset."""

LATEST = "rcmsess"
"""Another, the number of the newest session."""

BEATS = 1_000_000
"""So far apart the counts of two sessions begin,"""
SESSIONS = 2000
"""of which there are so many until they begin anew."""

USUAL = 1000.0
"""TM as it must be, and is where it is not told."""

CHECK = 0.05
"""s between two looks at the watchdog program."""
BEGUN_WITHIN = 0.02
"""s within which the axes are begun after the program was started."""
OFF_WITHIN = 0.2
"""s within which the motors are off once the axes have had the time to come to rest."""


@dataclass(frozen=True, eq=False)
class ArmReading:
    """What the controller told of the arm."""

    q: Floats
    """The joints (3,) rad, rad, mm."""
    on: bool
    """Whether all its motors are on."""
    off: bool
    """Whether all are off."""
    time: float
    """When that was, s on the conversation's clock."""
    rows: record.DataRecord
    """All of it."""


class GalilSession:
    """The arm's use of a controller."""

    def __init__(
        self,
        talk: Conversation,
        messages: Conversation | None,
        settings: GalilSettings,
        limits: JointLimits,
    ) -> None:
        self.settings, self.limits = settings, limits
        self.why_off = ""
        """Why the controller switched the motors off, in a sentence; empty where it did not."""
        self.said = ""
        """What the controller said last of its own accord; empty where nothing since it was
        enabled."""
        self.watched = False
        """Whether this session has switched motors on that are not known to be off again."""
        self._talk, self._messages = talk, messages
        self._places = [record.LETTERS.index(axis) for axis in settings.axes]
        self._axes = self._beat = 0
        self._checked, self._sent, self._fastest = 0.0, np.zeros(3), np.zeros(3)
        self._clock = SampleClock(USUAL * MICROSECONDS)

    def set_up(self) -> None:
        """Look who it is, and make it ready, with the motors off."""
        self._talk.ask("CW 1")
        self._axes = self._know()
        self._require_free()
        self._require_usual_samples()
        self._make_ready()

    def _make_ready(self) -> None:
        """Motors off, and all that the controller must know, in the place of what others have left
        there."""
        if self._messages is not None:
            self._messages.ask("CF I")
        self._talk.ask(f"MO {self.settings.axes}")
        self._configure()
        self._talk.ask(*self._speeds(np.zeros(3)))
        self._download()

    def _require_usual_samples(self) -> None:
        """The watchdog program and the joints' times reckon by them."""
        told = self._talk.known("_TM") or USUAL
        if told != USUAL:
            raise NotReady(
                f"TM is {told:g} on the controller: set it to {USUAL:g}, by which the watchdog "
                "program reckons its patience"
            )

    def _download(self) -> None:
        """Put the watchdog program in its place."""
        names = self.settings.axes
        try:
            self._talk.download(program.lines(names, round(1e3 * self.settings.patience)))
        except Rejected:
            self._talk.ask("AB 1")  # its lines may have been taken for commands
            self._talk.ask(f"MO {names}")
            raise

    def _require_free(self) -> None:
        """Leave the arm to whoever has it."""
        names = self.settings.axes
        asked = f"MG {','.join(f'_XQ{thread}' for thread in range(program.THREADS))}"
        lines = self._talk.numbers(asked)
        if len(lines) != program.THREADS:
            raise NotReady(f"{asked} must tell {program.THREADS} numbers, got {words(lines)}")
        if lines[program.THREAD] >= 0.0:
            raise NotReady("another host has the arm: end it there, or its program with HX")
        for thread, line in enumerate(lines):
            if line >= 0.0:
                raise NotReady(
                    f"a program runs on the controller, in thread {thread}: it must end before the "
                    "watchdog program can be put in its place"
                )
        if any(self._talk.number(f"_BG{axis}") for axis in names):
            raise NotReady(f"the axes {names} move: whoever moves them must stop them first")

    def homed(self) -> bool:
        """Whether a person has said where the arm stands since the controller was reset, and by
        these counts and axes: by others it stands elsewhere."""
        return self._talk.known(HOMED) == self.settings.scale_number

    def define(self, q: Floats) -> None:
        """A person says that the joints (3,) stand at q, at rest and with the drive off."""
        require(bool(np.isfinite(q).all()), "q", q.tolist(), "three numbers")
        counts = np.round(q * np.array(self.settings.counts)).astype(int).tolist()
        self._talk.ask(*self._each("DP", counts))
        self._talk.ask(f"{HOMED}={self.settings.scale_number}")

    def start(self) -> None:
        """Servo at rest, and be watched over."""
        if not self.homed():
            raise NotReady(
                "nobody has said where the arm stands since the controller was reset or its counts "
                "and axes were changed: bring it to a mark and define its position"
            )
        if self.watched:
            self.switch_off()
        self._require_free()
        self._require_usual_samples()
        wrong = amplifier.asked(self._talk, self.settings.axes)
        if wrong:
            raise NotReady(f"the amplifiers are not ready: {', '.join(wrong)}")
        names, talk = self.settings.axes, self._talk
        if not all(talk.number(f"_MO{axis}") for axis in names):
            raise NotReady("somebody else has switched the motors on since: the arm is theirs")
        self._make_ready()
        session = int(self._talk.known(LATEST)) % SESSIONS + 1
        self._beat, self.why_off, self.said = session * BEATS, "", ""
        self._fastest = np.zeros(3)
        talk.ask(f"{LATEST}={session}", f"hb={self._beat}", "TC")
        self.watched, self._checked = True, talk.now()
        try:
            # in one line: SH that is held up on its way would come when the program has ended
            talk.ask(f"XQ #RCMWD,{program.THREAD}", f"SH {names}")
            self._await_begun()
            self._beat += 1
            talk.ask(f"hb={self._beat}")  # its patience counts from here, not from what that took
        except RcmServoError:
            with contextlib.suppress(RcmServoError):
                self.switch_off()
            raise

    def _await_begun(self) -> None:
        """Wait until the watchdog program has begun the jog."""
        end = self._talk.now() + BEGUN_WITHIN
        while not all(self._talk.number(f"_BG{axis}") for axis in self.settings.axes):
            if self._talk.now() > end:
                cause = reasons.refused(self._talk) or self._stopped(self.look())
                raise NotReady(f"the axes do not begin: {self._reason(cause)}")

    def look(self, *commands: str) -> ArmReading:
        """Send some commands, and read how the arm is."""
        asked = self._talk.now()
        rows = self._talk.record(self._axes, *commands)
        time = self._clock.time_of(int(rows.general["sample"]), asked, self._talk.now())
        self._overhear()
        axes = rows.axes[self._places]
        q = axes["position"] / np.array(self.settings.counts)
        off = axes["status"] & record.OFF != 0
        told = ArmReading(q, not off.any(), bool(off.all()), time, rows)
        self._watch(told)
        return told

    def _overhear(self) -> None:
        """Note what the controller says of its own accord; unread it would fill its buffers."""
        if self._messages is not None:
            self.said = [self.said, *self._messages.overheard()][-1]

    def exchange(self, rates: Floats) -> ArmReading:
        """Jog with these joint rates (3,), and read how the arm is.

        Before that the speeds are asked for: who else has sent some is told, though these take
        their place at once. JG tells sizes alone: others of the same size go unnoticed, for 10 ms.
        Where the controller has switched a motor off, none are sent.
        """
        if self.why_off:
            return self.look()
        if self.watched and self._foreign():
            self.switch_off()
            self.why_off = program.WHYS[program.FOREIGN]
            return self.look()
        self._beat += 1
        return self.look(*self._speeds(self.steps(rates)), f"hb={self._beat}")

    def _foreign(self) -> bool:
        """Whether the controller has other speeds than were sent last."""
        told = self._talk.numbers("MG " + ",".join(f"_JG{axis}" for axis in self.settings.axes))
        return told != np.abs(self._sent).tolist()

    def steps(self, rates: Floats) -> Floats:
        """Joint rates (3,) in counts/s as the controller can jog: even, and never faster."""
        return 2.0 * np.trunc(rates * np.array(self.settings.counts) / 2.0)

    def switch_off(self) -> None:
        """Come to rest, then the motors off: the watchdog program does it, or else an abort."""
        names, talk = self.settings.axes, self._talk
        talk.ask(f"ST {names}", "hb=-1")
        end = talk.now() + self.settings.rest_time(self._fastest) + OFF_WITHIN
        while not all(talk.number(f"_MO{axis}") for axis in names):
            if talk.now() > end:
                talk.ask(f"HX {program.THREAD}", "AB 1")
                talk.ask(f"MO {names}")
        self.watched = False

    def _know(self) -> int:
        """How many axes it has, if it is a DMC-40x0."""
        told = self._talk.ask("QZ")[0]
        try:
            axes, *sizes = (int(part) for part in told.split(","))
        except ValueError:
            axes, sizes = 0, []
        if tuple(sizes) != record.SIZES or not max(self._places) < axes <= len(record.LETTERS):
            model = self._talk.ask("\x12\x16")[0]
            right = f"?, {', '.join(map(str, record.SIZES))} with axes {self.settings.axes}"
            raise NotReady(f"QZ of a DMC-40x0 must be {right}, got {words(told)} of {words(model)}")
        return axes

    def _configure(self) -> None:
        s = self.settings
        ends = np.array([self.limits.lower, self.limits.upper]) * np.array(s.counts)
        lower, upper = np.sort(ends, axis=0).round()
        for name, values in (
            ("AC", s.in_counts(s.acceleration)),
            ("DC", s.in_counts(s.deceleration)),
            ("SD", s.in_counts(s.deceleration)),
            ("ER", s.in_counts(s.following_error)),
            ("OE", np.ones(3)),
            ("BL", lower),
            ("FL", upper),
        ):
            self._talk.ask(*self._each(name, [int(value) for value in values]))

    def _each(self, name: str, values: list[int]) -> list[str]:
        return [f"{name}{axis}={v}" for axis, v in zip(self.settings.axes, values, strict=True)]

    def _speeds(self, counts: Floats) -> list[str]:
        """Commands that jog with these counts/s (3,), noted for the watchdog program."""
        self._sent, self._fastest = counts, np.maximum(self._fastest, np.abs(counts))
        letters = [axis.lower() for axis in self.settings.axes]
        noted = [f"v{a}={int(n)}" for a, n in zip(letters, counts, strict=True)]
        fields = [""] * (max(self._places) + 1)
        for place, letter in zip(self._places, letters, strict=True):
            fields[place] = f"v{letter}"
        return ["up=1", *noted, "JG " + ",".join(fields), "up=0"]

    def _watch(self, told: ArmReading) -> None:
        """Notice that the controller switched motors off, or that its program has ended: where
        some are on and it does not run, nobody else stops them."""
        if not self.watched:
            return
        if not told.on:
            self.why_off = self.why_off or self._reason(self._stopped(told))
        if told.off:
            self.watched = False
        elif not told.on or self._talk.now() - self._checked > CHECK:
            self._checked = self._talk.now()
            if self._talk.number(f"_XQ{program.THREAD}") < 0.0:
                self.switch_off()
                self.why_off = self.why_off or "the watchdog program on the controller has ended"

    def _stopped(self, told: ArmReading) -> str:
        """Why the axes stand."""
        stops = told.rows.axes[self._places]["stop"].tolist()
        return reasons.stopped(self._talk, self.settings.axes, stops)

    def _reason(self, cause: str) -> str:
        self._overhear()
        return reasons.told(cause, self._talk, self.settings.axes, self.said)
