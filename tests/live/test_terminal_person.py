"""The person at the terminal: only what is typed there, after the question, is an answer."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from at_terminal import AtTerminal

pytestmark = pytest.mark.alone

ASKING = """
import sys, time
from rcmservo.errors import RcmServoError
from rcmservo.live.terminal_operator import Terminal
end = {end}
try:
    person = Terminal(lambda: end and time.monotonic_ns() > end)
    print("ready", flush=True)
    for question in sys.argv[1:]:
        answer = person.ask(question)
        late = time.monotonic_ns() - person.typed > 10**9
        person.tell(f"<{{answer}}> {{'late' if late else 'fresh'}}")
except RcmServoError as error:
    print(f"[{{error}}]", flush=True)
"""


def asking(*questions: str, end: str = "0") -> list[str]:
    return [sys.executable, "-c", ASKING.format(end=end), *questions]


def test_a_person_answers_what_is_asked() -> None:
    with AtTerminal(asking("one?", "two?")) as at:
        at.until("one? ")
        at.type("  yes, this \n")
        at.until("<yes, this> fresh")
        at.until("two? ")
        at.type("\n")
        at.until("<> fresh")
        assert at.end() == 0


def test_what_was_typed_before_a_question_is_no_answer_to_it() -> None:
    with AtTerminal(asking("one?", "two?")) as at:
        at.type("enable\nenable\nena")
        at.until("one? ")
        at.type("ble\nenable\nenable\nena")
        at.until("<ble> fresh")
        at.until("two? ")
        at.type("ble\n")
        at.until("<ble> fresh")


@pytest.mark.parametrize("typed", ["\x04", "enable\x04\x04"])
def test_ctrl_d_ends_it_also_within_a_word(typed: str) -> None:
    with AtTerminal(asking("one?")) as at:
        at.until("one? ")
        at.type(typed)
        at.until("[ended at the terminal, before the drive was on]")


def test_who_waits_for_a_person_is_told_to_end() -> None:
    with AtTerminal(asking("one?", end="time.monotonic_ns() + 5 * 10**8")) as at:
        at.until("[stopped before the drive was on]")


def test_an_answer_that_was_typed_while_nobody_looked_is_known_to_be_late() -> None:
    with AtTerminal(asking("one?", "two?")) as at:
        at.until("one? ")
        at.process.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, at.process.pid, os.WSTOPPED)
        at.type("enable\n")
        with pytest.raises(subprocess.TimeoutExpired):
            at.process.wait(1.5)
        at.process.send_signal(signal.SIGCONT)
        at.until("<enable> late")


def test_neither_standard_input_nor_a_program_without_a_terminal_is_a_person() -> None:
    done = subprocess.run(
        asking("one?"), input=b"enable\n", capture_output=True, start_new_session=True, check=True
    )
    words = b"hardware is enabled only by a person at a terminal, and this program has none"
    assert done.stdout == b"[%s]\n" % words


def test_a_program_in_the_background_asks_nobody(tmp_path: Path) -> None:
    """The shell that began it stays in front."""
    script = tmp_path / "ask.py"
    script.write_text(ASKING.format(end="0"))
    shell = f"set -m; {sys.executable} {script} one? & wait $!"
    with AtTerminal(["bash", "-c", shell]) as at:
        at.until("[this program runs in the background: bring it to the foreground (fg)]")
