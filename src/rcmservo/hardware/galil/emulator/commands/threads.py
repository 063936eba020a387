"""Commands that lead a program's threads, and what threads do in a sample.

Source: command reference, XQ, HX, JP, JS, EN, IF, WT, #CMDERR, #POSERR, #LIMSWI.
"""

import re

from rcmservo.hardware.galil.emulator.commands.arguments import split
from rcmservo.hardware.galil.emulator.expressions import value_of
from rcmservo.hardware.galil.emulator.numbers import Refusal
from rcmservo.hardware.galil.emulator.program import Program
from rcmservo.hardware.galil.emulator.state import (
    THREADS,
    Caller,
    ControllerState,
    Execute,
    Host,
    Thread,
)

DEEPEST = 16
AT_ONCE = 20
"""Commands of each thread in a sample."""


def run_threads(state: ControllerState, execute: Execute) -> None:
    """Let a sample pass for every thread that runs."""
    for thread in state.threads:
        for _ in range(AT_ONCE):
            if not _turn(state, thread, execute):
                break


def _turn(state: ControllerState, thread: Thread, execute: Execute) -> bool:
    """One command of a thread; whether it can go on at once."""
    if thread.at is None or not thread.ready():
        return False
    if thread.at >= len(state.program.instructions):
        thread.halt()
        return False
    instruction = state.program.instructions[thread.at]
    thread.line, thread.at = instruction.line, thread.at + 1
    try:
        execute(state, instruction.text, thread)
    except Refusal as refused:
        _failed(state, thread, refused.code)
    return True


def _failed(state: ControllerState, thread: Thread, code: int) -> None:
    """A command of the program was refused: without #CMDERR every thread ends."""
    state.error = code
    state.error_line, state.error_thread = thread.line, thread.number
    state.tell(f"?{thread.line} {state.program.lines[thread.line]}")
    state.tell(state.words_of_error())
    if "CMDERR" not in state.program.labels:
        for one in state.threads:
            one.halt()
        return
    thread.halt()
    interrupt(state, "CMDERR")


def interrupt(state: ControllerState, label: str) -> None:
    """Have thread 0 do what stands at a label, if the program has it."""
    if label not in state.program.labels:
        return
    first = state.threads[0]
    first.returns.append((first.at, first.wait))
    first.at, first.wait = state.program.labels[label], None


def execute_program(state: ControllerState, rest: str, _: Caller) -> str:
    """XQ: start a thread at a label or a line."""
    parts = split(rest)
    number = int(value_of(parts[1], state)) if len(parts) > 1 else 0
    if not 0 <= number < THREADS:
        raise Refusal(6)
    at = target(state, parts[0]) if parts[0] else 0
    if not state.program.instructions:
        raise Refusal(10)
    thread = state.threads[number]
    if thread.at is not None:
        raise Refusal(19)
    thread.start(at)
    thread.line = state.program.instructions[min(at, len(state.program.instructions) - 1)].line
    return ""


def halt(state: ControllerState, rest: str, _: Caller) -> str:
    """HX: end a thread, all where none is named."""
    if not rest.strip():
        for thread in state.threads:
            thread.halt()
        return ""
    number = int(value_of(rest, state))
    if not 0 <= number < THREADS:
        raise Refusal(6)
    state.threads[number].halt()
    return ""


def target(state: ControllerState, text: str) -> int:
    """The instruction at a label or a line."""
    match = re.fullmatch(r"#\s*([A-Za-z][A-Za-z0-9]*)", text.strip())
    if match is not None:
        return state.program.at(match.group(1))
    return state.program.at_line(int(value_of(text, state)))


def jump(state: ControllerState, rest: str, caller: Caller) -> str:
    """JP: go on elsewhere, if a condition holds."""
    thread = _thread(caller)
    if _holds(state, rest):
        thread.at = target(state, split(rest)[0])
    return ""


def jump_subroutine(state: ControllerState, rest: str, caller: Caller) -> str:
    """JS: go on elsewhere until EN, if a condition holds."""
    thread = _thread(caller)
    if _holds(state, rest):
        if len(thread.returns) == DEEPEST:
            raise Refusal(12)
        at = target(state, split(rest)[0])
        thread.returns.append((thread.at, None))
        thread.at = at
    return ""


def _holds(state: ControllerState, rest: str) -> bool:
    parts = split(rest)
    return len(parts) == 1 or value_of(parts[1], state) != 0.0


def end(state: ControllerState, rest: str, caller: Caller) -> str:
    """EN, RE: end of a subroutine, an interrupt or a thread; EN1 waits again for what it waited."""
    thread = _thread(caller)
    if not thread.returns:
        thread.halt()
        return ""
    thread.at, waited = thread.returns.pop()
    first = split(rest)[0]
    thread.wait = waited if first and value_of(first, state) == 1.0 else None
    return ""


def if_(state: ControllerState, rest: str, caller: Caller) -> str:
    """IF: what follows up to ELSE or ENDIF, where a condition holds."""
    thread = _thread(caller)
    assert thread.at is not None
    if value_of(rest, state) == 0.0:
        thread.at = state.program.behind(thread.at, ("ELSE", "ENDIF"))
    return ""


def else_(state: ControllerState, _: str, caller: Caller) -> str:
    """ELSE: reached where the condition held."""
    thread = _thread(caller)
    assert thread.at is not None
    thread.at = state.program.behind(thread.at, ("ENDIF",))
    return ""


def end_if(_: ControllerState, __: str, caller: Caller) -> str:
    """ENDIF."""
    _thread(caller)
    return ""


def wait(state: ControllerState, rest: str, caller: Caller) -> str:
    """WT: go on so many ms later, to 2 ms."""
    thread = _thread(caller)
    parts = split(rest)
    until = state.samples + max(int(value_of(parts[0], state)) // 2 * 2, 2)
    thread.wait = lambda: state.samples >= until
    return ""


def load(state: ControllerState, rest: str, caller: Caller) -> str:
    """DL: the lines that come next are a program, up to a backslash."""
    if not isinstance(caller, Host):
        raise Refusal(3)
    if any(thread.at is not None for thread in state.threads):
        raise Refusal(17)
    caller.loading = Program()
    return ""


def _thread(caller: Caller) -> Thread:
    """The thread that executes the command: no host can."""
    if not isinstance(caller, Thread):
        raise Refusal(2)
    return caller
