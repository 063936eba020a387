"""Commands that control the program's threads, and execution of the threads per sample.

Source: command reference, XQ, HX, JP, JS, EN, IF, WT, #CMDERR, #POSERR, #LIMSWI.
"""

import re

from rcmservo.hardware.galil.emulator.commands.arguments import split_arguments
from rcmservo.hardware.galil.emulator.expressions import CommandError, evaluate
from rcmservo.hardware.galil.emulator.program import Program
from rcmservo.hardware.galil.emulator.state import (
    Caller,
    CommandHandler,
    ControllerState,
    Host,
    Thread,
)
from rcmservo.hardware.galil.watchdog_program import THREAD_COUNT

MAX_SUBROUTINE_DEPTH = 16
MAX_COMMANDS_PER_SAMPLE = 20
"""Commands of each thread in one sample."""


def run_threads(state: ControllerState, execute: CommandHandler) -> None:
    """Execute every running thread for one sample."""
    for thread in state.threads:
        for _ in range(MAX_COMMANDS_PER_SAMPLE):
            if not _execute_next(state, thread, execute):
                break


def _execute_next(state: ControllerState, thread: Thread, execute: CommandHandler) -> bool:
    """Execute one command of a thread; return False if the thread waits or does not run."""
    if thread.next_index is None or not thread.can_continue():
        return False
    if thread.next_index >= len(state.program.instructions):
        thread.halt()
        return False
    instruction = state.program.instructions[thread.next_index]
    thread.line, thread.next_index = instruction.line, thread.next_index + 1
    try:
        execute(state, instruction.text, thread)
    except CommandError as error:
        _handle_error(state, thread, error.code)
    return True


def _handle_error(state: ControllerState, thread: Thread, code: int) -> None:
    """Report a refused command of the program and start #CMDERR; without it end all threads."""
    state.error = code
    state.error_line, state.error_thread = thread.line, thread.number
    state.send_message(f"?{thread.line} {state.program.lines[thread.line]}")
    state.send_message(state.error_text())
    if "CMDERR" not in state.program.labels:
        for one in state.threads:
            one.halt()
        return
    thread.halt()
    interrupt(state, "CMDERR")


def interrupt(state: ControllerState, label: str) -> None:
    """Interrupt thread 0 with the code at a label, if the program has this label."""
    if label not in state.program.labels:
        return
    first = state.threads[0]
    first.return_stack.append((first.next_index, first.wait))
    first.next_index, first.wait = state.program.labels[label], None


def execute_program(state: ControllerState, rest: str, _: Caller) -> str:
    """XQ: start a thread at a label or a line."""
    parts = split_arguments(rest)
    number = int(evaluate(parts[1], state)) if len(parts) > 1 else 0
    if not 0 <= number < THREAD_COUNT:
        raise CommandError(6)
    index = jump_target(state, parts[0]) if parts[0] else 0
    if not state.program.instructions:
        raise CommandError(10)
    thread = state.threads[number]
    if thread.is_running:
        raise CommandError(19)
    thread.start(index)
    thread.line = state.program.instructions[min(index, len(state.program.instructions) - 1)].line
    return ""


def halt(state: ControllerState, rest: str, _: Caller) -> str:
    """HX: end a thread, or all threads if none is named."""
    if not rest.strip():
        for thread in state.threads:
            thread.halt()
        return ""
    number = int(evaluate(rest, state))
    if not 0 <= number < THREAD_COUNT:
        raise CommandError(6)
    state.threads[number].halt()
    return ""


def jump_target(state: ControllerState, text: str) -> int:
    """Return the index of the instruction at a label or a line."""
    match = re.fullmatch(r"#\s*([A-Za-z][A-Za-z0-9]*)", text.strip())
    if match is not None:
        return state.program.index_of_label(match.group(1))
    return state.program.index_of_line(int(evaluate(text, state)))


def jump(state: ControllerState, rest: str, caller: Caller) -> str:
    """JP: jump if the condition holds."""
    thread = _require_thread(caller)
    if _condition_holds(state, rest):
        thread.next_index = jump_target(state, split_arguments(rest)[0])
    return ""


def jump_subroutine(state: ControllerState, rest: str, caller: Caller) -> str:
    """JS: call a subroutine if the condition holds."""
    thread = _require_thread(caller)
    if _condition_holds(state, rest):
        if len(thread.return_stack) == MAX_SUBROUTINE_DEPTH:
            raise CommandError(12)
        index = jump_target(state, split_arguments(rest)[0])
        thread.return_stack.append((thread.next_index, None))
        thread.next_index = index
    return ""


def _condition_holds(state: ControllerState, rest: str) -> bool:
    parts = split_arguments(rest)
    return len(parts) == 1 or evaluate(parts[1], state) != 0.0


def end(state: ControllerState, rest: str, caller: Caller) -> str:
    """EN, RE: end a subroutine, an interrupt or a thread; EN1 restores the interrupted wait."""
    thread = _require_thread(caller)
    if not thread.return_stack:
        thread.halt()
        return ""
    thread.next_index, wait_condition = thread.return_stack.pop()
    first = split_arguments(rest)[0]
    thread.wait = wait_condition if first and evaluate(first, state) == 1.0 else None
    return ""


def if_(state: ControllerState, rest: str, caller: Caller) -> str:
    """IF: skip to ELSE or ENDIF unless the condition holds."""
    thread = _require_thread(caller)
    assert thread.next_index is not None
    if evaluate(rest, state) == 0.0:
        thread.next_index = state.program.index_after(thread.next_index, ("ELSE", "ENDIF"))
    return ""


def else_(state: ControllerState, _: str, caller: Caller) -> str:
    """ELSE: skip to ENDIF. Execution reaches ELSE only after a true condition."""
    thread = _require_thread(caller)
    assert thread.next_index is not None
    thread.next_index = state.program.index_after(thread.next_index, ("ENDIF",))
    return ""


def end_if(_: ControllerState, __: str, caller: Caller) -> str:
    """ENDIF: no effect in a thread."""
    _require_thread(caller)
    return ""


def wait(state: ControllerState, rest: str, caller: Caller) -> str:
    """WT: wait for a time in ms, rounded down to multiples of 2 ms."""
    thread = _require_thread(caller)
    parts = split_arguments(rest)
    until = state.samples + max(int(evaluate(parts[0], state)) // 2 * 2, 2)
    thread.wait = lambda: state.samples >= until
    return ""


def download(state: ControllerState, rest: str, caller: Caller) -> str:
    """DL: begin the download of a program, which a backslash ends."""
    if not isinstance(caller, Host):
        raise CommandError(3)
    if any(thread.is_running for thread in state.threads):
        raise CommandError(17)
    caller.download = Program()
    return ""


def _require_thread(caller: Caller) -> Thread:
    """Return the thread of a command that a host cannot execute."""
    if not isinstance(caller, Thread):
        raise CommandError(2)
    return caller
