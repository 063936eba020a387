"""The operator's page as a person uses it: headless Chromium, the real page, the simulated arm. One
server serves all tests; each begins where the one before left it, with poses of its own names.
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
from playwright.sync_api import Browser, Page, TimeoutError, sync_playwright

from conftest import ROOT
from peers import peer

CHROMIUM = shutil.which("chromium") or ""
pytestmark = [
    pytest.mark.alone,
    pytest.mark.slow,
    peer("Chromium", bool(CHROMIUM), "apt-get install chromium"),
]
TIMEOUT_MS, RETRY_MS = 45_000, 5_000
"""ms for what must come on a busy machine; after which a person presses once more."""
ATTEMPTS = 3
BUSY_AT_STOP = """() => {  // what is said where a busy browser comes to Resume and then to STOP
  const said = [], send = WebSocket.prototype.send, end = performance.now() + 300;
  WebSocket.prototype.send = function (words) { said.push(words); return send.call(this, words); };
  while (performance.now() < end);
  rcm.want("resume");
  rcm.stop();
  return new Promise((told) => setTimeout(() => told(said), 1000));
}"""
CAN_CLEAR, CAN_ENABLE = (f"rcm.board.can.includes('{action}')" for action in ("clear", "enable"))
PAUSED = "rcm.board.phase === 'PAUSED'"
MOVING = "rcm.board.phase === 'ACQUIRE' || rcm.board.phase === 'SERVO'"
JOG_DISTANCE = [0.1, 0.1, 8.0]
"""rad, rad, mm by which a joint is jogged."""
TOLERANCE = 0.02, 1.5, 1.5
"""rad, px, px within which the features are those of the target."""


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


class Operator:
    """Somebody at a browser."""

    def __init__(self, browser: Browser, address: str) -> None:
        self.page: Page = browser.new_page(viewport={"width": 1366, "height": 800})
        self.foreign_requests: list[str] = []
        self.page.on("request", lambda request: self._note(request.url, address))
        self.page.goto(address)
        self.until("rcm.board.phase")

    def _note(self, url: str, address: str) -> None:
        own = url.startswith((address, "data:", "blob:")) or "//127.0.0.1:" in url
        self.foreign_requests += [] if own else [url]

    def until(self, condition: str) -> None:
        self.page.wait_for_function(f"window.rcm && ({condition})", timeout=TIMEOUT_MS)

    def press(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).click(timeout=TIMEOUT_MS)

    def press_until(self, name: str, condition: str) -> None:
        """Press a button until it leads somewhere: where the picture hangs, the servo refuses."""
        for _ in range(4):
            self.press(name)
            with suppress(TimeoutError):
                self.page.wait_for_function(condition, timeout=RETRY_MS)
                return
        self.until(condition)

    def read(self, what: str) -> Any:
        return self.page.evaluate(f"rcm.{what}")

    @property
    def phase(self) -> str:
        return self.read("board.phase")

    def enable(self) -> None:
        """Have the drive on, which may be on already."""
        self.until(f"rcm.holds && ({CAN_ENABLE} || {CAN_CLEAR} || {PAUSED})")
        if self.page.evaluate(CAN_CLEAR):
            self.press_until("Clear", f"!{CAN_CLEAR}")
            self.until(CAN_ENABLE)
        if self.phase != "PAUSED":
            self.press_until("Enable", PAUSED)
        self.page.get_by_label("Jog speed").select_option("full")

    def teach(self, name: str) -> None:
        self.page.get_by_label("Name of the pose").fill(name)
        self.press_until("Teach", f"rcm.board.poses.includes('{name}')")

    def jog(self, name: str) -> None:
        """Hold a button down until a joint has moved well away; where a busy machine let go of it,
        press anew.
        """
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
        """Press a jog button and leave it without letting go."""
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
        """Have something go wrong, from the menu."""
        self.page.get_by_role("tab", name="Simulated trouble").click()
        self.page.get_by_label("Kind of trouble").select_option(kind)
        for name, value in parameters.items():
            self.page.locator(f"#trouble-parameters input[name={name}]").fill(value)
        self.press("Begin trouble")

    def go_and_arrive(self, name: str) -> bool:
        """Whether the tool arrives at a pose within a while."""
        self.go(name)
        return self.wait_for_arrival()

    def wait_for_arrival(self) -> bool:
        """Whether it arrives within a while."""
        end = time.monotonic() + 20.0
        while not self.is_at_target() and time.monotonic() < end:
            if self.phase == "PAUSED":
                self.press_until("Resume", MOVING)
            self.page.wait_for_timeout(50)
        return self.is_at_target()


def take_screenshots(chromium: Browser, folder: Path) -> None:
    """Keep what the browser shows in the end, for whoever reads the tests' folders."""
    for k, context in enumerate(chromium.contexts):
        for page in context.pages:
            with suppress(TimeoutError):
                page.screenshot(path=folder / f"{k}.png", timeout=RETRY_MS)


class ServedPage:
    """A server that is started when it is needed, and again after something went wrong: a browser
    without a GPU draws on the processors of all that is simulated, and a machine that stands still
    stops the arm. `close` it at the end.
    """

    def __init__(self, chromium: Browser, folder: Path) -> None:
        self.browser, self._folder, self._count = chromium, folder, 0
        self._serving, self._address = ExitStack(), ""

    @property
    def out(self) -> Path:
        """Where the records of the present server are."""
        return self._folder / str(self._count)

    def close(self) -> None:
        self._serving.close()
        self._address = ""

    def find_failure(self, play: Callable[[str], None]) -> str:
        """What went wrong in the last attempt at what is played at a server; empty where nothing
        did.
        """
        wrong = ""
        for k in range(ATTEMPTS):
            wrong = self._attempt(play)
            if not wrong:
                break
            self.close()
            print(f"attempt {k + 1} of {ATTEMPTS}: {wrong}")
        return wrong

    def _attempt(self, play: Callable[[str], None]) -> str:
        if not self._address:
            self._count += 1
            self._address = self._serving.enter_context(serve_page(self.out))
        try:
            play(self._address)
        except (AssertionError, TimeoutError) as error:
            return f"{type(error).__name__}: {error}"
        finally:
            take_screenshots(self.browser, self._folder)
            for context in self.browser.contexts:  # a page that is left would go on knocking
                context.close()
        return ""


@pytest.fixture(scope="module")
def site(chromium: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedPage]:
    with closing(ServedPage(chromium, tmp_path_factory.mktemp("page"))) as site:
        yield site


def test_the_first_steps_in_the_documents_lead_to_a_taught_pose(site: ServedPage) -> None:
    text = section((ROOT / "docs/page.md").read_text(), "First steps")

    def play(address: str) -> None:
        person = Operator(site.browser, address)
        todo = steps(text)
        assert [verb for verb, _ in todo] == ["press", "type", "press", "hold", "press"]
        follow(person.page, todo)
        reached(person.page)

    assert site.find_failure(play) == ""


def test_two_poses_are_taught_and_reached_and_a_watcher_can_only_stop(
    site: ServedPage,
) -> None:
    def play(address: str) -> None:
        person = Operator(site.browser, address)
        person.enable()
        person.teach("here")
        q = np.array(person.read("board.q"))
        person.page.get_by_role("button", name="Jog joint 1 plus", exact=True).hover()
        person.page.mouse.down(button="right")
        person.page.wait_for_timeout(300)
        assert person.phase == "PAUSED"
        person.page.mouse.up(button="right")
        person.jog("Jog joint 1 plus")
        person.jog("Jog joint 3 plus")
        moved = np.array(person.read("board.q")) - q
        assert moved[0] > JOG_DISTANCE[0] and abs(moved[1]) < 1e-3 and moved[2] > JOG_DISTANCE[2]
        person.teach("there")
        for pose in ("here", "there"):
            assert person.go_and_arrive(pose), (pose, person.read("board"))
        watcher = Operator(site.browser, address)
        watcher.until("rcm.board.phase && !rcm.holds")
        assert watcher.page.get_by_role("button", name="Go here").is_disabled()
        target = person.read("board.target")
        watcher.page.evaluate("rcm.want('go', { name: 'here' })")
        watcher.until("document.getElementById('notes').textContent.includes('has control')")
        assert person.read("board.target") == target
        person.go("here")
        watcher.page.keyboard.press("Space")
        person.until("rcm.board.phase === 'FAULT' && rcm.board.words.includes('STOP was pressed')")
        assert "drive went off" in person.read("board.words")
        person.enable()
        assert (
            not watcher.foreign_requests
            and not person.foreign_requests
            and watcher.read("drawn") > 20
        )

    assert site.find_failure(play) == ""


def test_marker_1_is_jogged_and_a_sequence_of_two_poses_is_completed(site: ServedPage) -> None:
    def play(address: str) -> None:
        person = Operator(site.browser, address)
        page = person.page
        person.enable()
        person.teach("first")
        person.jog("Jog marker 1 along x plus")
        person.teach("second")
        page.locator("#tour summary").click()
        page.get_by_label("Dwell in seconds").fill("1")
        for pose in ("first", "second"):
            page.get_by_label("Pose to visit").select_option(pose)
            person.press("Add")
        person.press("Move second up")
        person.press_until("Start the tour", "rcm.board.tour !== null")
        person.until("rcm.board.tour?.pose === 'second' && rcm.board.tour.left === 1")
        person.until("document.getElementById('tour-progress').textContent.includes('first')")
        person.until("rcm.board.tour === null && rcm.board.phase === 'PAUSED'")
        assert "all its poses were visited" in person.read("board.notes.join()")

    assert site.find_failure(play) == ""


def test_closing_the_browser_pauses_the_motion_and_another_one_resumes(site: ServedPage) -> None:
    def play(address: str) -> None:
        first = Operator(site.browser, address)
        first.enable()
        first.teach("back")
        first.jog("Jog joint 2 minus")
        first.leave_pressed("Jog joint 2 minus")
        first.go("back")
        first.page.close()
        second = Operator(site.browser, address)
        second.until("rcm.board.phase === 'PAUSED' && rcm.holds")
        q = np.array(second.read("board.q"))
        second.page.wait_for_timeout(500)
        assert np.allclose(q, second.read("board.q"), atol=2e-3)
        second.press_until("Resume", MOVING)

    assert site.find_failure(play) == ""


def test_a_stopped_run_is_opened_replayed_and_downloaded(site: ServedPage) -> None:
    def play(address: str) -> None:
        person = Operator(site.browser, address)
        page = person.page
        if person.phase != "OFF":  # a session of its own, which is short
            page.evaluate("rcm.stop()")
            person.until(CAN_CLEAR)
        person.enable()
        person.jog("Jog joint 1 plus")
        said = page.evaluate(BUSY_AT_STOP)
        assert "stop" in said and not any("resume" in one for one in said)
        person.until("rcm.board.phase === 'FAULT'")
        page.get_by_role("tab", name="Runs").click()
        page.get_by_role("button", name="session-").first.click(timeout=TIMEOUT_MS)
        slider = page.get_by_label("Time in the past run")
        slider.wait_for(timeout=TIMEOUT_MS)
        said = page.locator(".run-said")
        before = said.inner_text()
        slider.press("End")
        assert said.inner_text() != before and " s · " in said.inner_text()
        drawn = "[...document.querySelectorAll('.run-figures img')].map(one => one.naturalWidth)"
        person.until(f"{drawn}.length === 4 && {drawn}.every(one => one > 0)")
        for words, start in (
            ("Download the record (MCAP)", b"\x89MCAP"),
            ("Path as SVG", b"<?xml"),
        ):
            with page.expect_download(timeout=TIMEOUT_MS) as download:
                page.get_by_text(words, exact=True).click()
            assert Path(download.value.path()).read_bytes().startswith(start)

    assert site.find_failure(play) == ""


def test_the_curves_and_the_mechanism_are_drawn_in_their_tabs(site: ServedPage) -> None:
    chart, scene = "getElement(RCMSERVO.curves)?.chart", "getElement(RCMSERVO.scene.id)?.renderer"

    def play(address: str) -> None:
        person = Operator(site.browser, address)
        person.enable()
        person.page.get_by_role("tab", name="Curves").click()
        person.until(
            f"{chart}?.getOption().series?.filter((one) => one.data.length > 20).length > 10"
        )
        person.page.get_by_role("tab", name="3-D").click()
        person.until(f"{scene}?.info.render.triangles > 2000")
        assert not person.foreign_requests

    assert site.find_failure(play) == ""


def test_an_operator_recovers_from_a_lost_marker_a_moved_camera_and_an_emergency_stop(
    site: ServedPage,
) -> None:
    def play(address: str) -> None:
        person = Operator(site.browser, address)
        person.enable()
        person.teach("middle")
        person.jog("Jog joint 2 minus")
        assert person.go_and_arrive("middle")
        person.disturb("occlusion", **{"marker": "1", "for": "0.5"})
        person.until("rcm.board.phase === 'HOLD' || rcm.board.why.includes('marker 1')")
        person.until("rcm.board.phase === 'SERVO' && !rcm.board.why")
        person.disturb("relocate")
        person.until("rcm.board.phase === 'PAUSED' && rcm.board.ways.includes('show')")
        person.press("Show again")
        person.until("rcm.board.notes.at(-1) === 'the target is shown again'")
        person.press_until("Resume", MOVING)
        assert person.wait_for_arrival()
        person.disturb("drive_off")
        person.until(f"rcm.board.phase === 'FAULT' && {CAN_CLEAR}")
        person.press("End all trouble")
        person.page.wait_for_timeout(300)
        assert person.phase == "FAULT" and person.read("board.ways") == ["clear"]
        person.enable()
        log = (site.out / "trouble.jsonl").read_text().splitlines()
        assert [json.loads(line)["time"] > 0 for line in log] == [True] * 4

    assert site.find_failure(play) == ""
