"""The page in headless Chromium with the simulated arm.

One server serves all tests, and one browser stays open. Each test begins in the state that the
previous one left, with its own names of poses.
"""

import json
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from first_use import follow, reached, section, steps
from page_server import serve_page
from playwright.sync_api import Browser, Error, Page, TimeoutError, sync_playwright

from conftest import ROOT
from peers import mark_peer

CHROMIUM = shutil.which("chromium") or ""
pytestmark = [
    pytest.mark.alone,
    pytest.mark.slow,
    mark_peer("Chromium", bool(CHROMIUM), "apt-get install chromium"),
]
TIMEOUT_MS, RETRY_MS = 45_000, 2_000
"""Timeout on a busy machine, and time after which a button is pressed a second time, in ms."""
ATTEMPTS = 3
MAX_PRESSES = 8
"""Largest number of times that a button is pressed until it has its effect."""
BUSY_AT_STOP = """() => {  // messages of a browser that is busy during Resume and STOP
  const sent = [], send = WebSocket.prototype.send, end = performance.now() + 300;
  WebSocket.prototype.send = function (text) { sent.push(text); return send.call(this, text); };
  while (performance.now() < end);
  rcm.request("resume");
  rcm.stop();
  return new Promise((resolve) => setTimeout(() => resolve(sent), 1000));
}"""
CAN_CLEAR, CAN_ENABLE, CAN_PAUSE = (
    f"rcm.board.can.includes('{action}')" for action in ("clear", "enable", "pause")
)
PAUSED = "rcm.board.phase === 'PAUSED'"
MOVING = "phases.has('ACQUIRE') || phases.has('SERVO')"
"""Condition that the tool moved since the last press: a busy browser, silent, soon pauses it."""
NOTE_PHASES = "window.phases = new Set(); rcm.onBoard((board) => phases.add(board.phase))"
JOG_DISTANCE = [0.1, 0.1, 8.0]
"""Distance (rad, rad, mm) that a joint is jogged."""
TOLERANCE = 0.02, 1.5, 1.5
"""Errors (rad, px, px) at which the target counts as reached."""


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


class Operator:
    """Operator at a browser."""

    def __init__(self, browser: Browser, address: str) -> None:
        self.page: Page = browser.new_page(viewport={"width": 1366, "height": 800})
        self.foreign_requests: list[str] = []
        self.page.on("request", lambda request: self._note(request.url, address))
        self.page.goto(address)
        self.until("rcm.board.phase")
        self.page.evaluate(f"() => {{ {NOTE_PHASES} }}")

    def _note(self, url: str, address: str) -> None:
        is_own = url.startswith((address, "data:", "blob:")) or "//127.0.0.1:" in url
        self.foreign_requests += [] if is_own else [url]

    def until(self, condition: str) -> None:
        self.page.wait_for_function(f"window.rcm && ({condition})", timeout=TIMEOUT_MS)

    def press(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).click(timeout=TIMEOUT_MS)

    def press_until(self, name: str, condition: str) -> None:
        """Press a button until a condition holds: servo and page refuse an old display."""
        outcome = f"({condition}) ? 'reached' : rcm.refusal"
        for _ in range(MAX_PRESSES):
            self.page.evaluate("phases.clear()")
            self.press(name)
            with suppress(TimeoutError):
                handle = self.page.wait_for_function(outcome, timeout=RETRY_MS)
                if handle.json_value() == "reached":
                    return
        self.until(condition)

    def read(self, what: str) -> Any:
        return self.page.evaluate(f"rcm.{what}")

    @property
    def phase(self) -> str:
        return self.read("board.phase")

    def enable(self) -> None:
        """Pause a motion, clear a stop and switch the drive on, if it is off.

        The page offers Clear, takes it back and offers it again while STOP ends the session.
        """
        self.press_offered(CAN_PAUSE, "Pause", PAUSED)
        for _ in range(MAX_PRESSES):
            self.until(f"rcm.hasControl && ({CAN_ENABLE} || {CAN_CLEAR} || {PAUSED})")
            if self.phase == "PAUSED":
                break
            self.press_offered(CAN_CLEAR, "Clear", f"!{CAN_CLEAR}")
            self.press_offered(CAN_ENABLE, "Enable", PAUSED)
        self.until(PAUSED)
        self.page.get_by_label("Jog speed").select_option("full")

    def press_offered(self, offered: str, name: str, condition: str) -> None:
        """Press a button if the page offers its action, and wait for a condition or in vain."""
        if self.page.evaluate(offered):
            with suppress(TimeoutError):
                button = self.page.get_by_role("button", name=name, exact=True)
                button.click(timeout=RETRY_MS)
                self.page.wait_for_function(f"({condition}) || rcm.refusal", timeout=RETRY_MS)

    def teach(self, name: str) -> None:
        self.page.get_by_label("Name of the pose").fill(name)
        self.press_until("Teach", f"rcm.board.poses.includes('{name}')")

    def jog(self, name: str) -> None:
        """Hold a button down until a joint has moved; repeat if a busy machine released it."""
        q = self.read("board.q")
        moved = f"rcm.board.q.some((one, k) => Math.abs(one - {q}[k]) > {JOG_DISTANCE}[k])"
        for _ in range(10):
            self.page.get_by_role("button", name=name, exact=True).hover()
            self.page.mouse.down()
            with suppress(TimeoutError):
                self.page.wait_for_function(moved, timeout=RETRY_MS)
            self.page.mouse.up()
            self.until(PAUSED)
            if self.page.evaluate(moved):
                return
        raise AssertionError(f"{name} moves nothing")

    def leave_pressed(self, name: str) -> None:
        """Press a jog button and move the pointer off it without a release."""
        self.page.get_by_role("button", name=name, exact=True).hover()
        self.page.mouse.down()
        self.until("rcm.board.phase === 'JOG'")
        self.page.mouse.move(10, 700)
        self.until(PAUSED)
        self.page.mouse.up()

    def is_at_target(self) -> bool:
        delta = self.read("board.delta")
        return self.phase == "SERVO" and bool((np.abs(delta) < TOLERANCE).all())

    def go(self, name: str) -> None:
        self.press_until(f"Go {name}", MOVING)

    def disturb(self, kind: str, **parameters: str) -> None:
        """Begin a disturbance from the menu."""
        self.page.get_by_role("tab", name="Simulated disturbances").click()
        self.page.get_by_label("Kind of disturbance").select_option(kind)
        for name, value in parameters.items():
            self.page.locator(f"#disturbance-parameters input[name={name}]").fill(value)
        self.press("Begin disturbance")

    def disturb_in_motion(self, condition: str, kind: str, **parameters: str) -> None:
        """Begin a disturbance at the target until it has an effect: not if a pause comes first."""
        outcome = f"({condition}) ? 'reached' : {PAUSED} ? 'paused' : ''"
        for _ in range(MAX_PRESSES):
            assert self.wait_for_arrival()
            self.disturb(kind, **parameters)
            if self.page.wait_for_function(outcome, timeout=TIMEOUT_MS).json_value() == "reached":
                return
        raise AssertionError(f"{kind} has no effect")

    def go_and_arrive(self, name: str) -> bool:
        """Go to a pose; return whether the tool arrives in time."""
        self.go(name)
        return self.wait_for_arrival()

    def wait_for_arrival(self) -> bool:
        """Return whether the tool arrives in time."""
        self.page.wait_for_timeout(300)  # until the errors are those of the new target
        end = time.monotonic() + 20.0
        while not self.is_at_target() and time.monotonic() < end:
            if self.phase == "PAUSED":
                self.press_until("Resume", MOVING)
            self.page.wait_for_timeout(50)
        return self.is_at_target()


def describe_pages(chromium: Browser, folder: Path) -> None:
    """Print what each browser knows, and save screenshots in the folder of the tests."""
    for k, context in enumerate(chromium.contexts):
        for page in context.pages:
            with suppress(TimeoutError, Error):
                print(page.evaluate("JSON.stringify([rcm.hasControl, rcm.board])"))
                page.screenshot(path=folder / f"{k}.png", timeout=RETRY_MS)


class ServedPage:
    """Server and operator that are started when they are needed, and again after a failure.

    Failures are possible: a browser without a GPU draws on the processors that also simulate, and a
    stalled machine stops the arm. `close` it at the end.
    """

    def __init__(self, chromium: Browser, folder: Path) -> None:
        self._browser, self._folder, self._count = chromium, folder, 0
        self._serving, self._address = ExitStack(), ""
        self.operator: Operator
        """Operator in control."""
        self._watcher: Operator | None = None

    @property
    def out(self) -> Path:
        """Folder of the records of the present server."""
        return self._folder / str(self._count)

    @property
    def watcher(self) -> Operator:
        """Operator at a second browser, without control."""
        self._watcher = self._watcher or Operator(self._browser, self._address)
        return self._watcher

    def hand_over(self) -> None:
        """Close the browser of the operator in control; the watcher is the next one."""
        self.operator.page.close()
        self.operator, self._watcher = self.watcher, None

    def close(self) -> None:
        for context in self._browser.contexts:  # an open page would reconnect forever
            context.close()
        self._serving.close()
        self._address = ""

    def find_failure(self, play: Callable[[Operator], None]) -> str:
        """Run a test at the server, several times if it fails; return the last failure or ""."""
        failure = ""
        for k in range(ATTEMPTS):
            failure = self._attempt(play)
            if not failure:
                break
            self.close()
            print(f"attempt {k + 1} of {ATTEMPTS}: {failure}")
        return failure

    def _attempt(self, play: Callable[[Operator], None]) -> str:
        try:
            if not self._address:
                self._start()
            play(self.operator)
        except (AssertionError, TimeoutError) as error:
            describe_pages(self._browser, self._folder)
            return f"{type(error).__name__}: {error}"
        return ""

    def _start(self) -> None:
        self._count += 1
        self._address = self._serving.enter_context(serve_page(self.out))
        self.operator, self._watcher = Operator(self._browser, self._address), None


@pytest.fixture(scope="module")
def site(chromium: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedPage]:
    with closing(ServedPage(chromium, tmp_path_factory.mktemp("page"))) as site:
        yield site


def test_the_first_steps_in_the_documents_lead_to_a_taught_pose(site: ServedPage) -> None:
    text = section((ROOT / "docs/page.md").read_text(), "First steps")

    def play(operator: Operator) -> None:
        todo = steps(text)
        assert [verb for verb, _ in todo] == ["press", "type", "press", "hold", "press"]
        follow(operator.page, todo, held=1.0)
        reached(operator.page)

    assert site.find_failure(play) == ""


def test_marker_1_is_jogged_and_a_sequence_of_two_poses_is_completed(site: ServedPage) -> None:
    def play(operator: Operator) -> None:
        page = operator.page
        operator.enable()
        operator.teach("first")
        operator.jog("Jog marker 1 along x plus")
        operator.teach("second")
        page.locator("#sequence summary").click()
        page.get_by_label("Dwell in seconds").fill("1")
        for pose in ("first", "second"):
            page.get_by_label("Pose to visit").select_option(pose)
            operator.press("Add")
        operator.press("Move second up")
        operator.press_until("Start the sequence", "rcm.board.sequence !== null")
        operator.until(
            "rcm.board.sequence?.pose === 'second' && rcm.board.sequence.remaining_s === 1"
        )
        operator.until("document.getElementById('sequence-progress').textContent.includes('first')")
        operator.until("rcm.board.sequence === null && rcm.board.phase === 'PAUSED'")
        assert "the pose sequence is complete" in operator.read("board.notes.join()")

    assert site.find_failure(play) == ""


def test_two_poses_are_taught_and_reached_and_a_watcher_can_only_stop(
    site: ServedPage,
) -> None:
    def play(operator: Operator) -> None:
        operator.enable()
        operator.teach("near")
        q = np.array(operator.read("board.q"))
        operator.page.get_by_role("button", name="Jog joint 1 plus", exact=True).hover()
        operator.page.mouse.down(button="right")
        operator.page.wait_for_timeout(300)
        assert operator.phase == "PAUSED"
        operator.page.mouse.up(button="right")
        operator.jog("Jog joint 1 plus")
        operator.jog("Jog joint 3 plus")
        moved = np.array(operator.read("board.q")) - q
        assert moved[0] > JOG_DISTANCE[0] and abs(moved[1]) < 1e-3 and moved[2] > JOG_DISTANCE[2]
        operator.teach("far")
        for pose in ("near", "far"):
            assert operator.go_and_arrive(pose), (pose, operator.read("board"))
        watcher = site.watcher
        watcher.until("rcm.board.phase && !rcm.hasControl")
        assert watcher.page.get_by_role("button", name="Go near").is_disabled()
        target = operator.read("board.target")
        watcher.page.evaluate("rcm.request('go', { name: 'near' })")
        watcher.until("document.getElementById('notes').textContent.includes('has control')")
        assert operator.read("board.target") == target
        watcher.until("rcm.drawn > 20")
        operator.go("near")
        watcher.page.keyboard.press("Space")
        operator.until(
            "rcm.board.phase === 'FAULT' && rcm.board.words.includes('STOP was pressed')"
        )
        assert "drive went off" in operator.read("board.words")

    assert site.find_failure(play) == ""


def test_the_curves_and_the_mechanism_are_drawn_in_their_tabs(site: ServedPage) -> None:
    chart, scene = "getElement(RCMSERVO.curves)?.chart", "getElement(RCMSERVO.scene.id)?.renderer"

    def play(operator: Operator) -> None:
        operator.enable()
        operator.page.get_by_role("tab", name="3-D").click()
        operator.until(f"{scene}?.info.render.triangles > 2000")
        operator.page.get_by_role("tab", name="Curves").click()  # which takes less to draw
        operator.until(
            f"{chart}?.getOption().series?.filter((one) => one.data.length > 20).length > 10"
        )

    assert site.find_failure(play) == ""


def test_closing_the_browser_pauses_the_motion_and_another_one_resumes(site: ServedPage) -> None:
    def play(first: Operator) -> None:
        first.enable()
        first.teach("back")
        first.jog("Jog joint 2 minus")
        first.leave_pressed("Jog joint 2 minus")
        second = site.watcher
        first.go("back")
        assert not first.foreign_requests
        site.hand_over()
        second.until("rcm.board.phase === 'PAUSED' && rcm.board.holder === ''")
        second.press_until("Take control", "rcm.hasControl")
        q = np.array(second.read("board.q"))
        second.page.wait_for_timeout(500)
        assert np.allclose(q, second.read("board.q"), atol=2e-3)
        second.press_until("Resume", MOVING)

    assert site.find_failure(play) == ""


def test_an_operator_recovers_from_a_lost_marker_a_moved_camera_and_an_emergency_stop(
    site: ServedPage,
) -> None:
    def play(operator: Operator) -> None:
        operator.enable()
        operator.teach("middle")
        operator.jog("Jog joint 2 minus")
        assert operator.go_and_arrive("middle")
        lost = "rcm.board.phase === 'HOLD' || rcm.board.why.includes('marker 1')"
        operator.disturb_in_motion(lost, "occlusion", **{"marker": "1", "for": "1"})
        operator.until(f"{PAUSED} || rcm.board.phase === 'SERVO' && !rcm.board.why")
        assert operator.phase == "SERVO", operator.read("board.why")
        operator.disturb("relocate")
        operator.until("rcm.board.phase === 'PAUSED' && rcm.board.recovery.includes('teach_again')")
        operator.press("Teach again")
        operator.until("rcm.board.notes.at(-1) === 'the target was taught again'")
        operator.press_until("Resume", MOVING)
        assert operator.wait_for_arrival()
        operator.disturb("drive_off")
        operator.until(f"rcm.board.phase === 'FAULT' && {CAN_CLEAR}")
        operator.press("End all disturbances")
        operator.page.wait_for_timeout(300)
        assert operator.phase == "FAULT" and operator.read("board.recovery") == ["clear"]
        operator.enable()
        log = (site.out / "trouble.jsonl").read_text().splitlines()
        assert len(log) >= 4 and all(json.loads(line)["time"] > 0 for line in log)

    assert site.find_failure(play) == ""


def test_a_stopped_run_is_opened_replayed_and_downloaded(site: ServedPage) -> None:
    def play(operator: Operator) -> None:
        page = operator.page
        operator.enable()
        operator.jog("Jog joint 1 plus")
        sent = page.evaluate(BUSY_AT_STOP)
        assert "stop" in sent and not any("resume" in one for one in sent)
        operator.until("rcm.board.phase === 'FAULT'")
        page.get_by_role("tab", name="Runs").click()
        page.get_by_role("button", name="session-").first.click(timeout=TIMEOUT_MS)
        slider = page.get_by_label("Time in the past run")
        slider.wait_for(timeout=TIMEOUT_MS)
        moment = page.locator(".run-moment")
        before = moment.inner_text()
        slider.press("End")
        assert moment.inner_text() != before and " s · " in moment.inner_text()
        drawn = "[...document.querySelectorAll('.run-figures img')].map(one => one.naturalWidth)"
        operator.until(f"{drawn}.length === 4 && {drawn}.every(one => one > 0)")
        for words, start in (
            ("Download the record (MCAP)", b"\x89MCAP"),
            ("Path as SVG", b"<?xml"),
        ):
            with page.expect_download(timeout=TIMEOUT_MS) as download:
                page.get_by_text(words, exact=True).click()
            assert Path(download.value.path()).read_bytes().startswith(start)
        assert not operator.foreign_requests

    assert site.find_failure(play) == ""
