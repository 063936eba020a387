"""The emulated controller: samples that pass, and hosts that are heard and answered.

Every command of a host gets its own prompt: a colon where it was taken, a question mark where it
was refused. Source: command reference, Communications; motorapp/Galil, GalilConnector.cpp.
"""

from collections import deque
from dataclasses import dataclass, field

from rcmservo.hardware.galil.emulator.commands import reports
from rcmservo.hardware.galil.emulator.commands.arguments import split
from rcmservo.hardware.galil.emulator.commands.threads import interrupt, run_threads
from rcmservo.hardware.galil.emulator.expressions import value_of
from rcmservo.hardware.galil.emulator.interpreter import execute, word_of
from rcmservo.hardware.galil.emulator.motors import Motors
from rcmservo.hardware.galil.emulator.numbers import Refusal
from rcmservo.hardware.galil.emulator.program import WIDTH
from rcmservo.hardware.galil.emulator.state import HANDLES, LETTERS, Caller, ControllerState, Host

SAMPLE = 1.0 / 1024.0
"""s of one sample: TM 1000 is 976 us."""

AVERAGED = 0.125
"""s, the time constant of TV's filter."""

SILENCE = 3072
"""Samples for which BZ keeps the controller from answering."""

TCP, UDP = 2, 1
"""How a handle is used, as the data record tells."""

SERIAL = HANDLES
"""The place of the serial port among the lines, behind the handles."""


@dataclass
class Line:
    """What one host has sent, and what it is to be told."""

    host: Host
    """Who it is."""
    kind: int
    """TCP or UDP."""
    typed: str = ""
    """The command that has not ended yet."""
    length: int = 0
    """Characters of its line so far."""
    ended: bool = False
    """Whether the last character ended a program: an end of line behind it counts for nothing."""
    due: deque[str] = field(default_factory=deque[str])
    """Commands that wait for an earlier one."""
    answers: bytearray = field(default_factory=bytearray)
    """What it has not been sent yet."""
    echoes: bool = False
    """Whether what is heard is sent back."""


class Controller:
    """A controller of so many axes, that drives `motors`. `sample` lets time pass."""

    def __init__(self, motors: Motors, axes: int = 4) -> None:
        self.motors = motors
        self.lines: dict[int, Line] = {}
        self.stuck: int | None = None
        """An axis that does not move, whatever its motor does."""
        self._axes, self._encoders = axes, [0.0] * axes
        self.reset()

    def reset(self) -> None:
        """As after the power came on: nothing is known any more, nobody is connected."""
        self.state = ControllerState(self._axes)
        self.lines.clear()
        self._origins = list(self._encoders)
        self._silent_until, self._record_every, self._record_to = 0, 0, 0

    # Time

    def sample(self) -> None:
        """Let one sample pass."""
        state = self.state
        state.samples += 1
        self._move()
        run_threads(state, self._execute)
        for line in list(self.lines.values()):  # RS, behind a wait, leaves none
            self._serve(line)
        self._send_messages()
        if self._record_every and state.samples % self._record_every == 0:
            line = self.lines.get(self._record_to)
            if line is not None:
                line.answers += reports.data_record(state)

    def _move(self) -> None:
        axes = self.state.axes
        for axis, (forward, reverse) in zip(axes, self.motors.switches(), strict=True):
            axis.forward, axis.reverse = forward, reverse
        before = [(axis.off, axis.stopping and axis.stop_code in (2, 3)) for axis in axes]
        speeds = [axis.step(SAMPLE, self.motors.lag) for axis in axes]
        if self.stuck is not None:
            speeds[self.stuck] = 0.0
        self._encoders = list(self.motors.step(speeds, [not axis.off for axis in axes], SAMPLE))
        for axis, count, origin in zip(axes, self._encoders, self._origins, strict=True):
            last, axis.position = axis.position, count - origin
            now = (axis.position - last) / SAMPLE
            axis.velocity += (now - axis.velocity) * SAMPLE / AVERAGED
            axis.watch()
        after = [(axis.off, axis.stopping and axis.stop_code in (2, 3)) for axis in axes]
        if any(now[0] and not then[0] for then, now in zip(before, after, strict=True)):
            interrupt(self.state, "POSERR")
        if any(now[1] and not then[1] for then, now in zip(before, after, strict=True)):
            interrupt(self.state, "LIMSWI")

    def _execute(self, state: ControllerState, text: str, caller: Caller) -> str:
        """A command of anybody's; those that need more than the state are done here."""
        word, rest = word_of(text), text[2:]
        match word:
            case "DP":
                before = [axis.position for axis in state.axes]
                answer = execute(state, text, caller)
                for i, (axis, then) in enumerate(zip(state.axes, before, strict=True)):
                    self._origins[i] -= axis.position - then
                return answer
            case "DR":
                return self._stream_records(rest)
            case "CF":
                return self._route_messages(rest, caller)
            case "EO":
                return self._echo(rest, caller)
            case "BZ":
                if "=" in rest:
                    self._silent_until = state.samples + SILENCE
                return ""
            case _:
                return execute(state, text, caller)

    def _stream_records(self, rest: str) -> str:
        parts = split(rest)
        every = int(value_of(parts[0], self.state))
        if every == 0:
            self._record_every = 0
            return ""
        if every < 2 or every > 30000:
            raise Refusal(6)
        handle = int(value_of(parts[1], self.state)) if len(parts) > 1 else -1
        line = self.lines.get(handle)
        if line is None or line.kind != UDP:
            raise Refusal(133)
        self._record_every, self._record_to = every // 2 * 2, handle
        return ""

    def _route_messages(self, rest: str, caller: Caller) -> str:
        to = rest.strip()
        if to == "I" and isinstance(caller, Host):
            to = "S" if caller.handle == SERIAL else LETTERS[caller.handle]
        if len(to) != 1 or to not in LETTERS + "ST":
            raise Refusal(6)
        self.state.messages_to = to
        return ""

    def _echo(self, rest: str, caller: Caller) -> str:
        """EO: whether the serial port repeats what it hears; taken from there alone."""
        if not isinstance(caller, Host) or caller.handle != SERIAL:
            raise Refusal(1)
        self.lines[SERIAL].echoes = value_of(rest, self.state) != 0.0
        return ""

    def _send_messages(self) -> None:
        for to, text in self.state.messages:
            line = self.lines.get(SERIAL if to == "S" else LETTERS.find(to))
            if line is not None:
                sent = f"{text}\r\n".encode("latin-1")
                marked = bytes(byte | 0x80 for byte in sent)
                line.answers += marked if self.state.mark_unsolicited else sent
        self.state.messages.clear()

    # Hosts

    def connect_serial(self) -> None:
        """A host is at the serial port, which repeats what it hears until EO 0."""
        self.lines[SERIAL] = Line(Host(handle=SERIAL), kind=0, echoes=True)

    def connect(self, kind: int = TCP) -> int | None:
        """The handle that a new host gets; None where all are in use."""
        free = next((i for i in range(HANDLES) if i not in self.lines), None)
        if free is not None:
            self.lines[free] = Line(Host(handle=free), kind)
            self.state.handles[free] = kind
        return free

    def disconnect(self, handle: int) -> None:
        """A host is gone."""
        if self.lines.pop(handle, None) is not None and handle != SERIAL:
            self.state.handles[handle] = 0

    def hear(self, handle: int, data: bytes) -> None:
        """What a host sends; all of it that can be is done at once."""
        line = self.lines[handle]
        if line.echoes:
            line.answers += data
        for character in data.decode("latin-1"):
            if line.host.loading is not None:
                self._load(line, character)
            elif character not in "\r\n" or not line.ended:
                line.ended = False
                self._type(line, character)
        if handle in self.lines:
            self._serve(line)

    def answers(self, handle: int) -> bytes:
        """What a host is to be sent, once."""
        line = self.lines[handle]
        told = bytes(line.answers)
        line.answers.clear()
        return told

    def _type(self, line: Line, character: str) -> None:
        if character == "\r" or (character == ";" and line.typed.count('"') % 2 == 0):
            line.due.append(line.typed)
            line.typed, line.length = "", 0 if character == "\r" else line.length + 1
            self._serve(line)
        elif character != "\n" and line.length < WIDTH:
            line.typed, line.length = line.typed + character, line.length + 1

    def _load(self, line: Line, character: str) -> None:
        program = line.host.loading
        assert program is not None
        if character == "\\":
            self.state.program = program
            line.host.loading, line.typed, line.length, line.ended = None, "", 0, True
            line.answers += b"::"
        elif character == "\r":
            self._add(line, line.typed)
            line.typed = ""
        elif character != "\n":
            line.typed += character

    def _add(self, line: Line, text: str) -> None:
        assert line.host.loading is not None
        try:
            line.host.loading.add(text)
        except Refusal as refused:
            self.state.error = refused.code
            line.host.loading = None
            line.answers += b"?"

    def _serve(self, line: Line) -> None:
        """Do what a host has asked for, up to what has to wait."""
        host = line.host
        while self.state.samples >= self._silent_until:
            waited = host.wait is not None
            if not host.ready():
                return
            line.answers += b":" * waited
            if not line.due:
                return
            self._answer(line, line.due.popleft().strip())

    def _answer(self, line: Line, text: str) -> None:
        word = word_of(text)
        try:
            if word == "RS":
                self.reset()
            elif word == "QR":
                line.answers += reports.data_record(self.state) + b":"
            elif word == "UL":
                told = "".join(f"{one}\r\n" for one in self.state.program.lines)
                line.answers += told.encode("latin-1") + b"\x1a:"
            else:
                told = self._execute(self.state, text, line.host)
                if line.host.wait is None and line.host.loading is None:
                    line.answers += (f"{told}\r\n:" if told else ":").encode("latin-1")
        except Refusal as refused:
            self.state.error = refused.code
            line.answers += b"?"
