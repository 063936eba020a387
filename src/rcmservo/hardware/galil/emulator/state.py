"""State of the emulated controller: axes, variables, program, threads, and values of operands."""

import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache

from rcmservo.hardware.galil.data_record import AXIS_LETTERS, BLOCK_SIZES
from rcmservo.hardware.galil.emulator.axis import Axis
from rcmservo.hardware.galil.emulator.program import Program
from rcmservo.hardware.galil.error_codes import ERROR_TEXTS, CommandError, ErrorCode
from rcmservo.hardware.galil.watchdog_program import THREAD_COUNT

OLD_TO_NEW_LETTERS = str.maketrans("XYZW", "ABCD")
"""Translation of the older names of the axes."""
HANDLE_COUNT, MAX_VARIABLES = 8, 510
SERIAL_NUMBER = 4040

CACHED_TEXTS = 1024
"""Number of texts whose analysis is kept: a program repeats the same ones every 2 ms."""

Condition = Callable[[], bool]


@dataclass
class Caller:
    """Origin of a command: a thread of the program, or a host.

    Parameters
    ----------
    resume_condition : Condition or None
        Condition for which the caller waits; None if it does not wait.
    """

    resume_condition: Condition | None = None

    def can_continue(self) -> bool:
        """Return True if the caller does not wait, or its wait has just ended."""
        if self.resume_condition is not None and self.resume_condition():
            self.resume_condition = None
        return self.resume_condition is None


@dataclass
class Host(Caller):
    """Connected host, with its input and output.

    Parameters
    ----------
    handle : int
        Index of its handle.
    kind : int
        TCP, UDP, or 0 for the serial port.
    download : Program or None
        Program that it downloads (DL); None outside a download.
    download_ended : bool
        True if the last character ended a download. Line ends after it are ignored.
    text : str
        Characters of the incomplete command.
    line_length : int
        Characters of the present line so far.
    pending : deque[str]
        Commands that wait for an earlier one.
    output : bytearray
        Bytes to send.
    echo : bool
        True if received bytes are sent back.
    """

    handle: int = 0
    kind: int = 0
    download: Program | None = None
    download_ended: bool = False
    text: str = ""
    line_length: int = 0
    pending: deque[str] = field(default_factory=deque[str])
    output: bytearray = field(default_factory=bytearray)
    echo: bool = False


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
    return_stack : list[tuple[int or None, Condition or None]]
        Next instruction and resume condition of each interrupted level, for subroutines and
        interrupts.
    """

    number: int = 0
    next_index: int | None = None
    line: int = 0
    return_stack: list[tuple[int | None, Condition | None]] = field(
        default_factory=list[tuple[int | None, Condition | None]]
    )

    @property
    def is_running(self) -> bool:
        """True if the thread executes the program."""
        return self.next_index is not None

    def start(self, index: int | None) -> None:
        """Start at an instruction. None ends the thread."""
        self.next_index, self.resume_condition, self.return_stack = index, None, []

    def halt(self) -> None:
        """End the thread."""
        self.start(None)


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

    def halt_threads(self) -> None:
        """End every thread of the program."""
        for thread in self.threads:
            thread.halt()

    def error_text(self) -> str:
        """Return code and text of the last error (TC1)."""
        return f"{self.error} {ERROR_TEXTS.get(self.error, '')}".strip()

    def running_thread_bits(self) -> int:
        """Return one bit per running thread (_NO)."""
        return sum(1 << thread.number for thread in self.threads if thread.is_running)

    # Values of the names in expressions

    def variable(self, name: str) -> float:
        """Return the value of a variable or of TIME."""
        if name == "TIME":
            return float(self.samples)
        if name not in self.variables:
            raise CommandError(ErrorCode.VARIABLE_ERROR)
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
            raise CommandError(ErrorCode.BAD_FUNCTION_OR_ARRAY)
        return self.arrays[name]

    def array_index(self, array: list[float], index: float) -> int:
        """Return a valid index of an array, or raise :class:`CommandError`."""
        if not 0 <= index < len(array):
            raise CommandError(ErrorCode.INVALID_ARRAY_INDEX)
        return int(index)

    def input(self, function: str, number: float) -> float:
        """Return the value of an input or output. None is connected, and open inputs are 1."""
        return 1.0 if function == "@IN" and number >= 0 else 0.0

    def operand(self, name: str) -> float:
        """Return the value of an operand such as _TPA or _XQ0."""
        if name in _CONTROLLER_OPERANDS:
            return float(_CONTROLLER_OPERANDS[name](self))
        command, index = _split_operand(name)
        if index.isdigit():
            return float(self._numbered_operand(command, int(index)))
        return self._axis_operand(command, index)

    def _numbered_operand(self, command: str, number: int) -> float:
        thread = self.threads[number] if number < THREAD_COUNT else None
        if command == "XQ" and thread is not None:
            return thread.line if thread.is_running else -1
        if command == "HX" and thread is not None:
            return thread.is_running
        if command == "ED":
            return {0: self.error_line, 1: self.error_thread}.get(number, 0)
        if command == "TA" and number < len(self.amplifier):
            return self.amplifier[number]
        if command == "QZ" and number <= len(BLOCK_SIZES):
            return (len(self.axes), *BLOCK_SIZES)[number]
        raise CommandError(ErrorCode.BAD_COMMAND_RESPONSE)

    def _axis_operand(self, command: str, letter: str) -> float:
        index = AXIS_LETTERS.find(letter.translate(OLD_TO_NEW_LETTERS))
        if not 0 <= index < len(self.axes):
            raise CommandError(ErrorCode.OPERAND_ERROR)
        axis = self.axes[index]
        if command in AXIS_OPERANDS:
            return float(AXIS_OPERANDS[command](axis))
        if hasattr(axis.settings, command):
            return float(getattr(axis.settings, command))
        if command in self.stored_settings:
            return self.stored_settings[command][index]
        raise CommandError(ErrorCode.BAD_COMMAND_RESPONSE)


@lru_cache(CACHED_TEXTS)
def _split_operand(name: str) -> tuple[str, str]:
    """Return command and axis or number of an operand, or raise :class:`CommandError`."""
    match = re.fullmatch(r"_([A-Z]{2})([A-HW-Z]|\d)", name)
    if match is None:
        raise CommandError(ErrorCode.BAD_COMMAND_RESPONSE)
    return match[1], match[2]


_CONTROLLER_OPERANDS: dict[str, Callable[[ControllerState], float]] = {
    "_TC": lambda state: state.error,
    "_ED": lambda state: state.error_line,
    "_NO": ControllerState.running_thread_bits,
    "_BN": lambda _: SERIAL_NUMBER,
    "_BV": lambda state: len(state.axes),
    "_TM": lambda state: state.sample_time_us,
    "_CN": lambda state: state.switch_polarity,
    "_CW": lambda state: 1 if state.mark_unsolicited else 2,
    "_CF": lambda state: ord(state.message_destination),
    "_AB": lambda _: 1,
    "_UL": lambda state: MAX_VARIABLES - len(state.variables),
}

AXIS_OPERANDS: dict[str, Callable[[Axis], float]] = {
    "TP": lambda axis: round(axis.position),
    "TD": lambda _: 0,
    "TE": lambda axis: round(axis.error),
    "TV": lambda axis: round(axis.velocity),
    "TT": lambda _: 0,
    "RP": lambda axis: round(axis.reference),
    "DP": lambda axis: round(axis.position),
    "BG": lambda axis: axis.moving,
    "MO": lambda axis: axis.motor_off,
    "SC": lambda axis: axis.stop_code,
    "LF": lambda axis: not axis.forward_tripped,
    "LR": lambda axis: not axis.reverse_tripped,
    "JG": lambda axis: abs(axis.settings.JG),
}
"""Values of the operands of an axis, by the command after which they are named (TP for _TPA)."""

CommandHandler = Callable[[ControllerState, str, Caller], str | None]
"""Function that executes a command for a caller, given the command's arguments as text.
It returns the reply data, None if there are none."""
