"""The operator's page with a simulated arm, for benchmarks and tests.

    main thread      serves the page, like `rcmservo serve`
    second thread    acts as the operator: a browser, or plain websockets

The log of the arm has a row per millisecond, with this computer's clock. Recorded frames can
replace the camera, so that rendering takes no time.
"""

import contextlib
import itertools
import json
import os
import platform
import re
import shutil
import signal
import socket
import tempfile
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, replace
from functools import partial
from http.cookiejar import CookieJar
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, cast

import numpy as np
from playwright.sync_api import Page, sync_playwright
from playwright.sync_api import TimeoutError as PageTimeout
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from rcmservo.cli.lab import serve
from rcmservo.cli.lab.serve import PageBackend, ServeOptions
from rcmservo.hardware.device_kinds import prepare_tracker
from rcmservo.interfaces import Camera, Frame, Image
from rcmservo.live.child_process import ChildProcess
from rcmservo.live.frame_ring import FrameRing, RingCamera
from rcmservo.live.servo_process import Session
from rcmservo.loop.clock import sleep_until
from rcmservo.loop.operator import Operator
from rcmservo.loop.target_frames import TEACHING_FRAMES
from rcmservo.page.channels import PageChannels
from rcmservo.sim.processes.lab_processes import SimulatedLab

RATE = 60.0  # frames/s of the playback
FRAMES = 60  # number of recorded frames
DELAY = 20_000_000  # ns from the exposure of a frame to its arrival
NUMBERS = 1 << 16  # frames with a known time of arrival
PATIENCE = 180.0  # s, time limit of each wait; the first session may compile
CLEARS, ENABLES = (f"rcm.board.can.includes('{action}')" for action in ("clear", "enable"))


@dataclass
class PageLab:
    """Laboratory behind the page, with the settings of the page."""

    options: ServeOptions
    backend: PageBackend
    bench: SimulatedLab
    folder: Path
    servo: Any
    page: Any
    arrivals: Any
    token: str

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.options.port}"

    def play(self, operator: Callable[[], None]) -> None:
        """Serve until the operator function ends; raise its exception."""
        errors: list[BaseException] = []

        def played() -> None:
            try:
                awaited(lambda: reached(self.options.port))
                operator()
            except BaseException as error:
                errors.append(error)
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)

        thread = threading.Thread(target=played, name="operator", daemon=True)
        signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in a script's background
        thread.start()
        with contextlib.suppress(KeyboardInterrupt):
            serve._run_sessions(self.options, self.backend, self.folder, self.token)
        thread.join(PATIENCE)
        if errors:
            raise errors[0]

    @contextlib.contextmanager
    def served(self, channels: PageChannels) -> Iterator[None]:
        """Run the processes of the page without the laboratory, in the context."""
        with serve._start_page_processes(
            self.options, channels, self.backend, self.folder, self.token
        ):
            yield


@contextlib.contextmanager
def page_lab(
    seed: int = 0,
    recorded: bool = False,
    token: str = "",
    teaching_frames: int = TEACHING_FRAMES,
) -> Generator[PageLab]:
    """Run the laboratory without the page, with ``recorded`` frames on request, in the context."""
    context = get_context("spawn")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        options = ServeOptions(
            port=free_port(),
            browser=False,
            seed=seed,
            teaching_frames=teaching_frames,
            poses=folder / "poses",
            out=folder / "runs",
        )
        options.servo.warm_up()
        pids = context.RawValue("q", 0), context.RawValue("q", 0)
        arrivals = context.RawArray("q", NUMBERS)
        devices = serve._open_simulated_lab(options, prepare_tracker(options.lab))
        with devices as known, contextlib.ExitStack() as stack:
            bench = cast(SimulatedLab, cast(Any, known.switch_off).__self__)
            if recorded:
                frames = filmed(bench.ring)
                bench.camera.end()
                player = ChildProcess(context, replayed, frames, bench.ring, arrivals)
                stack.callback(player.end)
            make = known.session

            def session(channels: PageChannels, where: Path) -> Session:
                made = make(channels, where)
                assert made.operator is not None
                return replace(made, operator=partial(noted_operator, pids[0], made.operator))

            camera = partial(noted_camera, pids[1], known.camera)
            backend = replace(known, session=session, camera=camera)
            yield PageLab(options, backend, bench, folder, *pids, arrivals, token)


def noted_operator(pid: Any, make: Callable[[], Operator]) -> Operator:
    """Return an operator, and record the id of its process."""
    pid.value = os.getpid()
    return make()


def noted_camera(pid: Any, make: Callable[[], Camera]) -> Camera:
    """Return a camera, and record the id of its process."""
    pid.value = os.getpid()
    return make()


def filmed(ring: FrameRing) -> list[Image]:
    """Return frames of the simulated camera."""
    camera, found = RingCamera(ring), dict[int, Image]()
    while len(found) < FRAMES:
        frame = camera.latest()
        if frame is not None and frame.image is not None:
            found[frame.number] = frame.image
        time.sleep(0.002)
    return list(found.values())


def replayed(frames: list[Image], ring: FrameRing, arrivals: Any, control: Connection) -> None:
    """Play frames in turn until `control` has a message or closes; record the arrival of each."""
    due, period = time.monotonic_ns(), round(1e9 / RATE)
    for number in itertools.count(round(due / period)):
        due += period
        sleep_until(due)
        if control.poll():
            return
        now = time.monotonic_ns()
        arrivals[number % NUMBERS] = now
        ring.publish(Frame(number, now - DELAY, now, image=frames[number % len(frames)]))


class Client:
    """Browser without a screen, signed in with a token if there is one; opens websockets."""

    def __init__(self, address: str, token: str = "") -> None:
        self.address = address
        jar = CookieJar()
        browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor(jar))
        form = urllib.parse.urlencode({"token": token}).encode() if token else None
        page = browser.open(address, form, timeout=PATIENCE).read().decode()
        match = re.search(r"window\.RCMSERVO = (\{.*?\});", page)
        assert match is not None
        self.page_config = json.loads(match[1])
        self.cookies = {one.name: str(one.value) for one in jar}

    def port(self, path: str) -> int:
        return (
            self.page_config["stopPort"]
            if path == "/stop"
            else int(self.address.rpartition(":")[2])
        )

    def known(self, cookie: str | None = None) -> str:
        """Return the cookies as a header; each with the value `cookie` if one is given."""
        return "; ".join(
            f"{name}={value if cookie is None else cookie}" for name, value in self.cookies.items()
        )

    def open(
        self,
        path: str,
        origin: str = "",
        secret: str | None = None,
        cookie: str | None = None,
        **more: Any,
    ) -> ClientConnection:
        """Open a websocket; if `cookie` is given, each cookie has that value."""
        secret = self.page_config["secret"] if secret is None else secret
        url = f"ws://127.0.0.1:{self.port(path)}{path}?secret={secret}"
        known = self.known(cookie)
        headers = {"Cookie": known} if known else {}
        return connect(
            url,
            origin=Origin(origin or self.address),
            open_timeout=PATIENCE,
            additional_headers=headers,
            **more,
        )


def board(wire: ClientConnection) -> dict[str, Any]:
    """Request the next picture and return the state that comes with it."""
    wire.send("next")
    data = wire.recv(PATIENCE)
    assert isinstance(data, bytes)
    return json.loads(data[4 : 4 + int.from_bytes(data[:4], "little")])


@contextlib.contextmanager
def chromium(address: str) -> Generator[Page]:
    """Open the page in headless Chromium, in the context."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        page = browser.new_page(viewport={"width": 1366, "height": 768})
        page.goto(address)
        until(page, "rcm.board.phase")
        yield page
        browser.close()


def until(page: Page, condition: str) -> None:
    page.wait_for_function(f"window.rcm && ({condition})", timeout=1e3 * PATIENCE)


def press(page: Page, name: str, leads_to: str) -> None:
    """Press a button until the condition `leads_to` holds, since busy machines are slow."""
    button = page.get_by_role("button", name=name, exact=True)
    for _ in range(20):
        with contextlib.suppress(PageTimeout):
            button.click(timeout=5_000)
            page.wait_for_function(leads_to, timeout=5_000)
            return
        print(f"{name} had no effect: {page.locator('#notes').inner_text()!r}", flush=True)
    raise TimeoutError(f"{name} has no effect: {page.evaluate('rcm.board.words')}")


def enabled(page: Page) -> None:
    """Switch the drive on; clear a stop before if there was one."""
    until(page, f"rcm.hasControl && ({ENABLES} || {CLEARS})")
    if page.evaluate(CLEARS):
        press(page, "Clear", f"!{CLEARS}")
    until(page, f"rcm.hasControl && {ENABLES}")
    press(page, "Enable", "rcm.board.phase === 'PAUSED'")


def awaited(condition: Callable[[], bool], within: float = PATIENCE) -> None:
    """Wait for a condition, up to `within` s."""
    end = time.monotonic() + within
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"the condition did not hold within {within:g} s")
        time.sleep(0.005)


def reached(port: int) -> bool:
    """Return whether the page answers, also if it requests a token."""
    with contextlib.suppress(OSError):
        try:
            urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=1.0).close()
        except urllib.error.HTTPError as error:
            error.close()
        return True
    return False


def free_port() -> int:
    """Return a free port; the next one, for STOP, is free too."""
    while True:
        with socket.create_server(("127.0.0.1", 0)) as wire, contextlib.suppress(OSError):
            port = wire.getsockname()[1]
            socket.create_server(("127.0.0.1", port + 1)).close()
            return port


def machine() -> str:
    """Return a description of this machine."""
    return (
        f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}, Python "
        f"{platform.python_version()}, load {os.getloadavg()[0]:.2f}"
    )


def spread(ms: Any) -> str:
    """Return median, 95th percentile and maximum of times (ms), as text."""
    median, p95, most = np.percentile(np.asarray(ms, dtype=float), [50, 95, 100])
    return f"median {median:6.1f}, 95 % {p95:6.1f}, max {most:6.1f} ms"
