"""`rcmservo serve --rig lab.toml` through the page's websockets, with an emulated controller.

A second connection to the emulator shows the state of the arm.
"""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from page_forged import Holder
from page_lab import awaited
from terminal_process import Laboratory, typed_joints, wait_for

from conftest import INTERRUPTIBLE_COMMAND, SMALL_30_HZ_RIG_TOML, make_environment
from rcmservo.config.rig_file import load_rig_file
from rcmservo.page.prompts import MIN_READING_TIME_NS
from rcmservo.recording.reader import read_record

pytestmark = [pytest.mark.alone, pytest.mark.slow]
ATTEMPTS = 3
READ_S = 0.1 + MIN_READING_TIME_NS * 1e-9
"""Time in s after which an answer is repeated: an answer given at once is ignored."""


@contextmanager
def serving(lab: Laboratory, folder: Path) -> Iterator[tuple[Any, str]]:
    """Yield the running command and the address of its page."""
    out = "--out", str(folder / "out"), "--poses", str(folder / "poses")
    command = [
        sys.executable,
        "-c",
        INTERRUPTIBLE_COMMAND,
        "serve",
        "--port",
        "0",
        "--no-browser",
        *out,
    ]
    command += ["--teaching-frames", "30"]
    process = subprocess.Popen(
        [*command, "--rig", str(lab.lab())],
        stdout=subprocess.PIPE,
        text=True,
        env=make_environment(COLUMNS="300", TERM="dumb", XDG_STATE_HOME=str(folder)),
    )
    assert process.stdout is not None
    try:
        line = next(line for line in process.stdout if "rcmservo page at" in line)
        address = re.search(r"http://127\.0\.0\.1:\d+", line)
        assert address is not None and "at 10 % of the speed until `rig check` passes" in line
        yield process, address[0]
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0


class PageOperator(Holder):
    """Operator who has control of the page."""

    def __init__(self, address: str) -> None:
        server: Any = SimpleNamespace(address=address, token="")
        super().__init__(server)

    def answered(self, words: str, by: str) -> None:
        """Answer until the page displays some words."""
        question = self.now["question"]
        request = {"do": "answer", "question": question, "words": words}
        self.insist(request, lambda: by in self.now["words"] + self.now["question"], READ_S)

    def insist(
        self, request: dict[str, Any], reached: Callable[[], bool], within: float = 1.5
    ) -> None:
        """Repeat a request until a condition holds, because a busy computer drops late ones."""
        for _ in range(120):
            self.say(request)
            with suppress(TimeoutError):
                return awaited(reached, within)
        raise TimeoutError(f"{request} leads to {self.now}")

    def cleared(self) -> None:
        """Clear until the drive can be enabled."""
        self.insist({"do": "clear"}, lambda: "clear" not in self.now["can"])
        wait_for(lambda: "enable" in self.now["can"])

    def until_words(self, words: str) -> None:
        wait_for(lambda: words in self.now["words"] and "clear" in self.now["can"])

    def jogs_until_stop(self, lab: Laboratory) -> bool:
        """Jog and press STOP; return False if the controller's watchdog acted before STOP.

        It acts if the computer stalls for longer than its time-out.
        """
        counts = lab.counts
        for _ in range(60):
            self.press, self.jogs = next(self.presses), True
            with suppress(TimeoutError):
                awaited(lambda: self.now["phase"] == "FAULT" or lab.counts != counts, 1.0)
                break
        self.stop()
        self.jogs = False
        wait_for(lambda: "clear" in self.now["can"])
        return "STOP was pressed" in self.now["words"]

    def stop(self) -> None:
        with self.client.open("/stop") as wire:
            wire.send("stop")
            assert wire.recv(20.0) == "heard"


def servo_process(process: Any) -> int:
    """Return the servo process: the one that was started last."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text()
    return max(map(int, children.split()))


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Laboratory]:
    with closing(Laboratory(tmp_path_factory.mktemp("lab"), 1, SMALL_30_HZ_RIG_TOML)) as lab:
        lab.ask("MO ABC")
        yield lab


def test_a_lab_is_homed_enabled_jogged_and_stopped_at_the_page(
    lab: Laboratory, tmp_path: Path
) -> None:
    lab.forget()
    with serving(lab, tmp_path) as (process, address):
        at = PageOperator(address)

        # joint values: typed within the limits, and confirmed
        wait_for(lambda: at.now["question"].startswith("Joint values at the mark"))
        at.say({"do": "enable"})
        at.answered("9 0 100", "the joints must be within theta")
        at.answered(typed_joints(lab.start), "The arm is at theta")
        assert lab.off and not lab.homed and "enable" not in at.now["can"]
        at.answered("", "the drive is off")
        wait_for(lambda: "enable" in at.now["can"])
        assert lab.off and lab.homed and np.abs(lab.q - lab.start).max() < 0.01
        counts = lab.counts
        assert "0.1 rad/s, 0.1 rad/s and 8 mm/s, which is 10 % of the full" in at.now["intent"]
        wait_for(lambda: None not in (at.now["points"] or [None]) and at.now["frame"] > 0)

        # once enabled, the arm is at rest until a jog button is held; then STOP
        at.enable()
        assert not lab.off and lab.counts == counts
        for _ in range(ATTEMPTS):
            if at.jogs_until_stop(lab):
                break
            at.cleared()
            at.enable()
        assert "the servo switched the arm's drive off" in at.now["words"] and lab.off

        # STOP while the servo hangs: the controller's watchdog stops the arm, the servo is killed
        at.cleared()
        at.enable()
        servo = servo_process(process)
        os.kill(servo, signal.SIGSTOP)
        at.stop()
        at.until_words("killed")
        assert lab.off and not Path(f"/proc/{servo}").exists()

        # the drive goes off by itself: the reason is shown, and a clear is required
        at.cleared()
        at.enable()
        counts = lab.counts
        assert "?" not in lab.ask("AB 1;MO ABC")
        wait_for(lambda: at.now["phase"] == "FAULT")
        wait_for(
            lambda: any(note.startswith("the arm's drive is off: ") for note in at.now["notes"])
        )
        at.insist({"do": "clear"}, lambda: "the session is over: " in at.now["words"])
        assert "enable" not in at.now["can"] and lab.off
        at.cleared()
        assert lab.off and np.abs(np.subtract(lab.counts, counts)).max() < 50

        # another program has enabled the drive
        lab.ask("SH ABC")
        at.insist({"do": "enable"}, lambda: "clear" in at.now["can"])
        assert "another program has switched the arm's drive on" in at.now["words"]
        lab.ask("MO ABC")

    assert lab.off
    first = read_record(tmp_path / "out/session-1")
    speeds = np.abs(first.ticks["command"]) / np.array(load_rig_file(lab.lab()).gate.speed)
    assert first.complete and 0.0 < speeds.max() <= 0.1 * 0.2 * (1.0 + 1e-9)
