"""What the controller knows: its axes, variables, program and threads, and what names stand for."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field

from rcmservo.hardware.galil.codes import ERRORS
from rcmservo.hardware.galil.data_record import LETTERS, SIZES
from rcmservo.hardware.galil.emulator.axis import Axis
from rcmservo.hardware.galil.emulator.numbers import Refusal
from rcmservo.hardware.galil.emulator.program import Program

OTHER_LETTERS = str.maketrans("XYZW", "ABCD")
"""The older names of the axes."""
THREADS, HANDLES, VARIABLES = 8, 8, 510
SERIAL_NUMBER = 4040

Wait = Callable[[], bool]


@dataclass
class Caller:
    """Who has a command executed: a thread of the program, or a host by a handle."""

    wait: Wait | None = None
    """Where it waits: whether that for which it waits has come."""

    def ready(self) -> bool:
        """Whether it can go on."""
        if self.wait is not None and self.wait():
            self.wait = None
        return self.wait is None


@dataclass
class Host(Caller):
    """A host that is connected."""

    handle: int = 0
    """Its place among the handles."""
    loading: Program | None = None
    """The program that it is sending (DL)."""


@dataclass
class Thread(Caller):
    """A thread of the program."""

    number: int = 0
    """Its place among the threads."""
    at: int | None = None
    """The instruction that it executes next; None where it does not run."""
    line: int = 0
    """The line of the instruction that it executed last."""
    returns: list[tuple[int | None, Wait | None]] = field(
        default_factory=list[tuple[int | None, Wait | None]]
    )
    """Where subroutines and interrupts return to, and what was waited for there."""

    def start(self, at: int) -> None:
        """Run from an instruction on."""
        self.at, self.wait, self.returns = at, None, []

    def halt(self) -> None:
        """Run no more."""
        self.at, self.wait, self.returns = None, None, []


class ControllerState:
    """All that is gone when the controller is reset."""

    def __init__(self, axes: int) -> None:
        self.axes = [Axis() for _ in range(axes)]
        self.kept: dict[str, list[float]] = {}
        self.variables: dict[str, float] = {}
        self.arrays: dict[str, list[float]] = {}
        self.program = Program()
        self.threads = [Thread(number=i) for i in range(THREADS)]
        self.error = 0
        self.error_line, self.error_thread = 0, -1
        self.samples = 0
        self.mark_unsolicited = False
        self.messages_to = "S"
        self.polarity = -1
        self.sample_time = 1000.0
        self.handles = [0] * HANDLES
        self.messages: list[tuple[str, str]] = []
        self.amplifier = [0, 0, 0, 0]

    def tell(self, text: str, to: str = "") -> None:
        """Say something that no host asked for."""
        self.messages.append((to or self.messages_to, text))

    def axis(self, letter: str) -> Axis:
        """The axis of a letter, or Refusal."""
        place = LETTERS.find(letter.translate(OTHER_LETTERS))
        if not 0 <= place < len(self.axes):
            raise Refusal(4)
        return self.axes[place]

    def words_of_error(self) -> str:
        """What TC1 tells."""
        return f"{self.error} {ERRORS.get(self.error, '')}".strip()

    # What expressions are made of

    def variable(self, name: str) -> float:
        """A variable's value, or the TIME."""
        if name == "TIME":
            return float(self.samples)
        if name not in self.variables:
            raise Refusal(9)
        return self.variables[name]

    def element(self, name: str, index: float) -> float:
        """An array's element; [-1] is its length."""
        array = self.array(name)
        if index == -1:
            return float(len(array))
        return array[self.place(array, index)]

    def array(self, name: str) -> list[float]:
        """An array, or Refusal."""
        if name not in self.arrays:
            raise Refusal(57)
        return self.arrays[name]

    def place(self, array: list[float], index: float) -> int:
        """A place in an array, or Refusal."""
        if not 0 <= index < len(array):
            raise Refusal(56)
        return int(index)

    def input(self, function: str, number: float) -> float:
        """An input or output: nothing is wired to any, and inputs that are not wired are 1."""
        return 1.0 if function == "@IN" and number >= 0 else 0.0

    def operand(self, name: str) -> float:
        """What an operand such as _TPA or _XQ0 tells."""
        if name in _ALONE:
            return _ALONE[name](self)
        match = re.fullmatch(r"(_[A-Z]{2})([A-HW-Z]|\d)", name)
        if match is None:
            raise Refusal(58)
        kind, which = match.groups()
        if which.isdigit():
            return self._numbered(kind, int(which))
        return self._of_axis(kind, which)

    def _numbered(self, kind: str, which: int) -> float:
        thread = self.threads[which] if which < THREADS else None
        if kind in ("_XQ", "_HX") and thread is not None:
            running = thread.at is not None
            return float(running) if kind == "_HX" else float(thread.line if running else -1)
        if kind == "_ED":
            return {0: float(self.error_line), 1: float(self.error_thread)}.get(which, 0.0)
        if kind == "_TA" and which < 4:
            return float(self.amplifier[which])
        if kind == "_QZ" and which < 4:
            return float((len(self.axes), *SIZES)[which])
        raise Refusal(58)

    def _of_axis(self, kind: str, letter: str) -> float:
        axis = self.axis(letter)
        if kind in _OF_AXIS:
            return _OF_AXIS[kind](axis)
        name = kind[1:]
        if hasattr(axis.settings, name):
            return float(getattr(axis.settings, name))
        if name in self.kept:
            return self.kept[name][LETTERS.index(letter.translate(OTHER_LETTERS))]
        raise Refusal(58)


def running(state: ControllerState) -> int:
    """A bit for each thread that runs."""
    return sum(1 << thread.number for thread in state.threads if thread.at is not None)


_ALONE: dict[str, Callable[[ControllerState], float]] = {
    "_TC": lambda s: float(s.error),
    "_ED": lambda s: float(s.error_line),
    "_NO": lambda s: float(running(s)),
    "_BN": lambda s: float(SERIAL_NUMBER),
    "_BV": lambda s: float(len(s.axes)),
    "_TM": lambda s: s.sample_time,
    "_CN": lambda s: float(s.polarity),
    "_CW": lambda s: 1.0 if s.mark_unsolicited else 2.0,
    "_CF": lambda s: float(ord(s.messages_to)),
    "_AB": lambda s: 1.0,
    "_UL": lambda s: float(VARIABLES - len(s.variables)),
}

_OF_AXIS: dict[str, Callable[[Axis], float]] = {
    "_TP": lambda a: float(round(a.position)),
    "_TD": lambda a: 0.0,
    "_TE": lambda a: float(round(a.error)),
    "_TV": lambda a: float(round(a.velocity)),
    "_TT": lambda a: 0.0,
    "_RP": lambda a: float(round(a.reference)),
    "_DP": lambda a: float(round(a.position)),
    "_BG": lambda a: float(a.moving),
    "_MO": lambda a: float(a.off),
    "_SC": lambda a: float(a.stop_code),
    "_LF": lambda a: float(not a.forward),
    "_LR": lambda a: float(not a.reverse),
    "_JG": lambda a: abs(a.settings.JG),
}

Execute = Callable[[ControllerState, str, Caller], str]
"""Does what a command says for a caller, from the text behind its name; what it answers."""
