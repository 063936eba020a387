"""Commands that control the program's threads, and execution of the threads per sample.

Source: command reference, XQ, HX, JP, JS, EN, IF, WT, #CMDERR, #POSERR, #LIMSWI.
"""

import re

from rcmservo.hardware.galil.emulator.commands.arguments import split_arguments
from rcmservo.hardware.galil.emulator.expressions import evaluate
from rcmservo.hardware.galil.emulator.program import Program
from rcmservo.hardware.galil.emulator.state import (
    Caller,
    CommandHandler,
    ControllerState,
    Host,
    Thread,
)
from rcmservo.hardware.galil.error_codes import CommandError, ErrorCode
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


def _handle_error(state: ControllerState, thread: Thread, code: ErrorCode) -> None:
    """Report a refused command of the program and start #CMDERR; without it end all threads."""
    state.error = code.value
    state.error_line, state.error_thread = thread.line, thread.number
    state.send_message(f"?{thread.line} {state.program.lines[thread.line]}")
    state.send_message(state.error_text())
    if "CMDERR" in state.program.labels:
        thread.halt()
        interrupt(state, "CMDERR")
    else:
        state.halt_threads()


def interrupt(state: ControllerState, label: str) -> None:
    """Interrupt thread 0 with the code at a label, if the program has this label."""
    if label in state.program.labels:
        thread = state.threads[0]
        thread.return_stack.append((thread.next_index, thread.resume_condition))
        thread.next_index, thread.resume_condition = state.program.labels[label], None


def execute_program(state: ControllerState, arguments: str, _: Caller) -> None:
    """XQ: start a thread at a label or a line."""
    target, *others = split_arguments(arguments)
    thread = _find_thread(state, others[0] if others else "0")
    index = _find_jump_target(state, target) if target else 0
    instructions = state.program.instructions
    if not instructions:
        raise CommandError(ErrorCode.UNDEFINED_LABEL)
    if thread.is_running:
        raise CommandError(ErrorCode.THREAD_ALREADY_RUNS)
    thread.start(index)
    thread.line = instructions[min(index, len(instructions) - 1)].line


def halt(state: ControllerState, arguments: str, _: Caller) -> None:
    """HX: end a thread, or all threads if none is named."""
    if arguments.strip():
        _find_thread(state, arguments).halt()
    else:
        state.halt_threads()


def _find_thread(state: ControllerState, text: str) -> Thread:
    """Return the thread with the number to which a text evaluates."""
    number = int(evaluate(text, state))
    if not 0 <= number < THREAD_COUNT:
        raise CommandError(ErrorCode.NUMBER_OUT_OF_RANGE)
    return state.threads[number]


def _find_jump_target(state: ControllerState, text: str) -> int:
    """Return the index of the instruction at a label or a line."""
    match = re.fullmatch(r"#\s*([A-Za-z][A-Za-z0-9]*)", text.strip())
    if match is not None:
        return state.program.index_of_label(match.group(1))
    return state.program.index_of_line(int(evaluate(text, state)))


def jump(state: ControllerState, arguments: str, caller: Caller) -> None:
    """JP: jump if the condition holds."""
    thread = _require_thread(caller)
    if _condition_holds(state, arguments):
        thread.next_index = _find_jump_target(state, split_arguments(arguments)[0])


def jump_subroutine(state: ControllerState, arguments: str, caller: Caller) -> None:
    """JS: call a subroutine if the condition holds."""
    thread = _require_thread(caller)
    if _condition_holds(state, arguments):
        if len(thread.return_stack) == MAX_SUBROUTINE_DEPTH:
            raise CommandError(ErrorCode.TOO_MANY_SUBROUTINES)
        index = _find_jump_target(state, split_arguments(arguments)[0])
        thread.return_stack.append((thread.next_index, None))
        thread.next_index = index


def _condition_holds(state: ControllerState, arguments: str) -> bool:
    """Return True unless a jump has a condition that is zero."""
    parts = split_arguments(arguments)
    return len(parts) == 1 or evaluate(parts[1], state) != 0.0


def end(state: ControllerState, arguments: str, caller: Caller) -> None:
    """EN, RE: end a subroutine, an interrupt or a thread; EN1 restores the interrupted wait."""
    thread = _require_thread(caller)
    if not thread.return_stack:
        thread.halt()
        return
    thread.next_index, condition = thread.return_stack.pop()
    option = split_arguments(arguments)[0]
    thread.resume_condition = condition if option and evaluate(option, state) == 1.0 else None


def if_(state: ControllerState, arguments: str, caller: Caller) -> None:
    """IF: skip to ELSE or ENDIF unless the condition holds."""
    thread = _require_thread(caller)
    if evaluate(arguments, state) == 0.0:
        _skip_to(state, thread, "ELSE", "ENDIF")


def else_(state: ControllerState, _: str, caller: Caller) -> None:
    """ELSE: skip to ENDIF. Execution reaches ELSE only after a true condition."""
    _skip_to(state, _require_thread(caller), "ENDIF")


def _skip_to(state: ControllerState, thread: Thread, *ends: str) -> None:
    """Continue a thread after the first of these commands that ends its branch."""
    assert thread.next_index is not None
    thread.next_index = state.program.index_after(thread.next_index, ends)


def end_if(_: ControllerState, __: str, caller: Caller) -> None:
    """ENDIF: no effect in a thread."""
    _require_thread(caller)


def wait(state: ControllerState, arguments: str, caller: Caller) -> None:
    """WT: wait for a time in ms, rounded down to multiples of 2 ms."""
    thread = _require_thread(caller)
    duration_ms = int(evaluate(split_arguments(arguments)[0], state))
    end_sample = state.samples + max(duration_ms // 2 * 2, 2)
    thread.resume_condition = lambda: state.samples >= end_sample


def download(state: ControllerState, _: str, caller: Caller) -> None:
    """DL: begin the download of a program, which a backslash ends."""
    if not isinstance(caller, Host):
        raise CommandError(ErrorCode.NOT_IN_PROGRAM)
    if any(thread.is_running for thread in state.threads):
        raise CommandError(ErrorCode.NOT_WHILE_PROGRAM_RUNS)
    caller.download = Program()


def _require_thread(caller: Caller) -> Thread:
    """Return the thread of a command that a host cannot execute."""
    if not isinstance(caller, Thread):
        raise CommandError(ErrorCode.ONLY_FROM_PROGRAM)
    return caller
