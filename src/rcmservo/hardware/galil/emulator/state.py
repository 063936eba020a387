"""State of the emulated controller: axes, variables, program, threads, and values of operands."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field

from rcmservo.hardware.galil.data_record import AXIS_LETTERS, BLOCK_SIZES
from rcmservo.hardware.galil.emulator.axis import Axis
from rcmservo.hardware.galil.emulator.expressions import CommandError
from rcmservo.hardware.galil.emulator.program import Program
from rcmservo.hardware.galil.stop_reasons import ERROR_TEXTS
from rcmservo.hardware.galil.watchdog_program import THREAD_COUNT

OLD_TO_NEW_LETTERS = str.maketrans("XYZW", "ABCD")
"""Translation of the older names of the axes."""
HANDLE_COUNT, MAX_VARIABLES = 8, 510
SERIAL_NUMBER = 4040

Wait = Callable[[], bool]
"""Condition that ends a wait."""


@dataclass
class Caller:
    """Origin of a command: a thread of the program, or a host.

    Parameters
    ----------
    wait : Wait or None
        Condition for which the caller waits; None if it does not wait.
    """

    wait: Wait | None = None

    def can_continue(self) -> bool:
        """Return True if the caller does not wait, or its wait has just ended."""
        if self.wait is not None and self.wait():
            self.wait = None
        return self.wait is None


@dataclass
class Host(Caller):
    """Connected host.

    Parameters
    ----------
    handle : int
        Index of its handle.
    download : Program or None
        Program that it downloads (DL); None outside a download.
    """

    handle: int = 0
    download: Program | None = None


@dataclass
class Thread(Caller):
    """Thread of the program.

    Parameters
    ----------
    number : int
        Number of the thread.
    next_index : int or None
        Index of the next instruction; None if the thread does not run.
    line : int
        Line of the last instruction.
    return_stack : list[tuple[int or None, Wait or None]]
        Next instruction and wait condition of each interrupted level, for subroutines and
        interrupts.
    """

    number: int = 0
    next_index: int | None = None
    line: int = 0
    return_stack: list[tuple[int | None, Wait | None]] = field(
        default_factory=list[tuple[int | None, Wait | None]]
    )

    @property
    def is_running(self) -> bool:
        """True if the thread executes the program."""
        return self.next_index is not None

    def start(self, index: int) -> None:
        """Start at an instruction."""
        self.next_index, self.wait, self.return_stack = index, None, []

    def halt(self) -> None:
        """End the thread."""
        self.next_index, self.wait, self.return_stack = None, None, []


class ControllerState:
    """State of the controller that a reset clears.

    Parameters
    ----------
    axis_count : int
        Number of axes.
    """

    def __init__(self, axis_count: int) -> None:
        self.axes = [Axis() for _ in range(axis_count)]
        self.stored_settings: dict[str, list[float]] = {}
        self.variables: dict[str, float] = {}
        self.arrays: dict[str, list[float]] = {}
        self.program = Program()
        self.threads = [Thread(number=i) for i in range(THREAD_COUNT)]
        self.error = 0
        self.error_line, self.error_thread = 0, -1
        self.samples = 0
        self.mark_unsolicited = False
        self.message_destination = "S"
        self.switch_polarity = -1
        self.sample_time_us = 1000.0
        self.handles = [0] * HANDLE_COUNT
        self.messages: list[tuple[str, str]] = []
        self.amplifier = [0, 0, 0, 0]

    def send_message(self, text: str, destination: str = "") -> None:
        """Queue an unsolicited message for a host."""
        self.messages.append((destination or self.message_destination, text))

    def axis(self, letter: str) -> Axis:
        """Return the axis of a letter, or raise :class:`CommandError`."""
        index = AXIS_LETTERS.find(letter.translate(OLD_TO_NEW_LETTERS))
        if not 0 <= index < len(self.axes):
            raise CommandError(4)
        return self.axes[index]

    def error_text(self) -> str:
        """Return code and text of the last error (TC1)."""
        return f"{self.error} {ERROR_TEXTS.get(self.error, '')}".strip()

    # Values of the names in expressions

    def variable(self, name: str) -> float:
        """Return the value of a variable or of TIME."""
        if name == "TIME":
            return float(self.samples)
        if name not in self.variables:
            raise CommandError(9)
        return self.variables[name]

    def element(self, name: str, index: float) -> float:
        """Return an element of an array. Index -1 returns its length."""
        array = self.array(name)
        if index == -1:
            return float(len(array))
        return array[self.array_index(array, index)]

    def array(self, name: str) -> list[float]:
        """Return an array, or raise :class:`CommandError`."""
        if name not in self.arrays:
            raise CommandError(57)
        return self.arrays[name]

    def array_index(self, array: list[float], index: float) -> int:
        """Return a valid index of an array, or raise :class:`CommandError`."""
        if not 0 <= index < len(array):
            raise CommandError(56)
        return int(index)

    def input(self, function: str, number: float) -> float:
        """Return the value of an input or output. None is connected, and open inputs are 1."""
        return 1.0 if function == "@IN" and number >= 0 else 0.0

    def operand(self, name: str) -> float:
        """Return the value of an operand such as _TPA or _XQ0."""
        if name in _CONTROLLER_OPERANDS:
            return _CONTROLLER_OPERANDS[name](self)
        match = re.fullmatch(r"(_[A-Z]{2})([A-HW-Z]|\d)", name)
        if match is None:
            raise CommandError(58)
        kind, which = match.groups()
        if which.isdigit():
            return self._numbered_operand(kind, int(which))
        return self._axis_operand(kind, which)

    def _numbered_operand(self, kind: str, number: int) -> float:
        thread = self.threads[number] if number < THREAD_COUNT else None
        if kind in ("_XQ", "_HX") and thread is not None:
            line = thread.line if thread.is_running else -1
            return float(thread.is_running if kind == "_HX" else line)
        if kind == "_ED":
            return {0: float(self.error_line), 1: float(self.error_thread)}.get(number, 0.0)
        if kind == "_TA" and number < 4:
            return float(self.amplifier[number])
        if kind == "_QZ" and number < 4:
            return float((len(self.axes), *BLOCK_SIZES)[number])
        raise CommandError(58)

    def _axis_operand(self, kind: str, letter: str) -> float:
        axis = self.axis(letter)
        if kind in _AXIS_OPERANDS:
            return _AXIS_OPERANDS[kind](axis)
        name = kind[1:]
        if hasattr(axis.settings, name):
            return float(getattr(axis.settings, name))
        if name in self.stored_settings:
            index = AXIS_LETTERS.index(letter.translate(OLD_TO_NEW_LETTERS))
            return self.stored_settings[name][index]
        raise CommandError(58)


def running_thread_bits(state: ControllerState) -> int:
    """Return one bit per running thread."""
    return sum(1 << thread.number for thread in state.threads if thread.is_running)


_CONTROLLER_OPERANDS: dict[str, Callable[[ControllerState], float]] = {
    "_TC": lambda s: float(s.error),
    "_ED": lambda s: float(s.error_line),
    "_NO": lambda s: float(running_thread_bits(s)),
    "_BN": lambda s: float(SERIAL_NUMBER),
    "_BV": lambda s: float(len(s.axes)),
    "_TM": lambda s: s.sample_time_us,
    "_CN": lambda s: float(s.switch_polarity),
    "_CW": lambda s: 1.0 if s.mark_unsolicited else 2.0,
    "_CF": lambda s: float(ord(s.message_destination)),
    "_AB": lambda s: 1.0,
    "_UL": lambda s: float(MAX_VARIABLES - len(s.variables)),
}

_AXIS_OPERANDS: dict[str, Callable[[Axis], float]] = {
    "_TP": lambda a: float(round(a.position)),
    "_TD": lambda a: 0.0,
    "_TE": lambda a: float(round(a.error)),
    "_TV": lambda a: float(round(a.velocity)),
    "_TT": lambda a: 0.0,
    "_RP": lambda a: float(round(a.reference)),
    "_DP": lambda a: float(round(a.position)),
    "_BG": lambda a: float(a.moving),
    "_MO": lambda a: float(a.motor_off),
    "_SC": lambda a: float(a.stop_code),
    "_LF": lambda a: float(not a.forward_tripped),
    "_LR": lambda a: float(not a.reverse_tripped),
    "_JG": lambda a: abs(a.settings.JG),
}

CommandHandler = Callable[[ControllerState, str, Caller], str]
"""Function that executes a command for a caller, given the text after the command's name.
It returns the reply data."""
