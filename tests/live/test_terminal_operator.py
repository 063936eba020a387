"""Operator at the terminal: only a line typed there after the question is an answer."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from terminal_process import AtTerminal

ASK_SCRIPT = """
import sys, time
from rcmservo.errors import RcmServoError
from rcmservo.live.terminal_operator import Terminal
end = {end}
try:
    terminal = Terminal(lambda: end and time.monotonic_ns() > end)
    print("ready", flush=True)
    for question in sys.argv[1:]:
        answer = terminal.ask(question)
        late = time.monotonic_ns() - terminal.typed > 10**9
        terminal.notify(f"<{{answer}}> {{'late' if late else 'fresh'}}")
except RcmServoError as error:
    print(f"[{{error}}]", flush=True)
"""


def ask_command(*questions: str, end: str = "0") -> list[str]:
    return [sys.executable, "-c", ASK_SCRIPT.format(end=end), *questions]


def test_the_operator_answers_a_question() -> None:
    with AtTerminal(ask_command("one?", "two?")) as process:
        process.until("one? ")
        process.type("  yes, this \n")
        process.until("<yes, this> fresh")
        process.until("two? ")
        process.type("\n")
        process.until("<> fresh")
        assert process.end() == 0


def test_input_typed_before_a_question_is_no_answer() -> None:
    with AtTerminal(ask_command("one?", "two?")) as process:
        process.type("enable\nenable\nena")
        process.until("one? ")
        process.type("ble\nenable\nenable\nena")
        process.until("<ble> fresh")
        process.until("two? ")
        process.type("ble\n")
        process.until("<ble> fresh")


@pytest.mark.parametrize("typed", ["\x04", "enable\x04\x04"])
def test_ctrl_d_ends_the_program_also_within_a_word(typed: str) -> None:
    with AtTerminal(ask_command("one?")) as process:
        process.until("one? ")
        process.type(typed)
        process.until("[stopped at the terminal before the drive was on]")


def test_a_stop_request_ends_the_wait_for_the_operator() -> None:
    with AtTerminal(ask_command("one?", end="time.monotonic_ns() + 5 * 10**8")) as process:
        process.until("[stopped before the drive was on]")


def test_an_answer_typed_while_the_process_was_suspended_is_recognized_as_old() -> None:
    with AtTerminal(ask_command("one?", "two?")) as process:
        process.until("one? ")
        process.process.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, process.process.pid, os.WSTOPPED)
        process.type("enable\n")
        with pytest.raises(subprocess.TimeoutExpired):
            process.process.wait(1.5)
        process.process.send_signal(signal.SIGCONT)
        process.until("<enable> late")


def test_neither_standard_input_nor_a_missing_terminal_can_answer() -> None:
    done = subprocess.run(
        ask_command("one?"),
        input=b"enable\n",
        capture_output=True,
        start_new_session=True,
        check=True,
    )
    words = b"hardware is enabled only by an operator at a terminal, and this program has none"
    assert done.stdout == b"[%s]\n" % words


def test_a_program_in_the_background_asks_no_question(tmp_path: Path) -> None:
    """The shell that started it stays in the foreground."""
    script = tmp_path / "ask.py"
    script.write_text(ASK_SCRIPT.format(end="0"))
    shell = f"set -m; {sys.executable} {script} one? & wait $!"
    with AtTerminal(["bash", "-c", shell]) as process:
        process.until("[this program runs in the background: bring it to the foreground (fg)]")
