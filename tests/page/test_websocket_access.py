"""Access to the page: a remote browser signs in, forged websockets and late requests are refused.

The quick test serves STOP in a thread. The others share a page in processes of its own, served by
`rcmservo serve --host 0.0.0.0 --token-file`.
"""

import contextlib
import json
import re
import threading
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.cookiejar import CookieJar
from multiprocessing import Pipe
from typing import Any

import pytest
from page_server import serve_page
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from rcmservo.page.channels import MessageChannel
from rcmservo.page.messages import STOP
from rcmservo.page.web.access import LOOPBACK_ADDRESS, PageCredentials, bind_pair
from rcmservo.page.web.stop_process import serve_stop


class Site:
    """Address of a server, and a signed-in browser with the parameters in its page."""

    def __init__(self, address: str, token: str) -> None:
        self.address, self.host = address, urllib.parse.urlsplit(address).hostname
        jar = CookieJar()
        self.browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor(jar))
        form = urllib.parse.urlencode({"token": token}).encode()
        page = self.browser.open(address, form).read().decode()
        match = re.search(r"window\.RCMSERVO = (\{.*?\});", page)
        assert match is not None
        self.parameters = json.loads(match[1])
        self.cookie = "; ".join(f"{one.name}={one.value}" for one in jar)

    def open(
        self, path: str, origin: str | None = None, is_signed_in: bool = True, **changes: Any
    ) -> ClientConnection:
        port = self.parameters["stopPort"] if path == "/stop" else self.address.rpartition(":")[2]
        secret = changes.get("secret", self.parameters["secret"])
        url = f"ws://{self.host}:{port}{path}?secret={secret}"
        headers = {"Cookie": self.cookie} if is_signed_in else {}
        return connect(url, origin=Origin(origin or self.address), additional_headers=headers)

    def fetch(self, path: str, **headers: str) -> int:
        """Return the status of a page that the signed-in browser requests."""
        request = urllib.request.Request(self.address + path, headers=headers)
        with contextlib.closing(self.browser.open(request)) as page:
            return page.status

    def board(self, websocket: ClientConnection) -> dict[str, Any]:
        """Return the newest content of the page, without the picture."""
        websocket.send("next")
        data = websocket.recv(20.0)
        assert isinstance(data, bytes)
        return json.loads(data[4 : 4 + int.from_bytes(data[:4], "little")])

    def until(self, websocket: ClientConnection, phase: str) -> dict[str, Any]:
        for _ in range(3000):
            board = self.board(websocket)
            if board["phase"] == phase and (phase != "OFF" or "enable" in board["can"]):
                return board
        raise AssertionError(f"{phase} never came: {board}")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    folder = tmp_path_factory.mktemp("serve")
    remote = "--host", "0.0.0.0", "--token-file", str(folder / "token")
    with serve_page(folder / "out", *remote) as address:
        yield Site(address, (folder / "token").read_text().strip())


def assert_forgeries_are_refused(
    connect_with: Callable[[str, str], ClientConnection], address: str, secret: str
) -> None:
    """Assert that only the page's own origin with the secret opens a websocket.

    `connect_with` opens it with an origin and a secret.
    """
    port = address.rpartition(":")[2]
    for origin in ("http://evil.example", "null", f"https://127.0.0.1:{port}", "http://127.0.0.1"):
        with pytest.raises(InvalidStatus, match="403"):
            connect_with(origin, secret)
    for other in ("", "x", secret[:-1]):
        with pytest.raises(InvalidStatus, match="403"):
            connect_with(address, other)
    with connect_with(address, secret):
        """The websocket is accepted."""


@contextmanager
def serve_stop_in_thread(channel: MessageChannel, secret: str) -> Iterator[tuple[str, int]]:
    """Serve STOP, and yield the address of its page and its port."""
    page, listener = bind_pair(LOOPBACK_ADDRESS, 0)
    credentials = PageCredentials(page.getsockname()[1], secret)
    control, server = Pipe()
    serving = threading.Thread(
        target=serve_stop, args=(channel, credentials, listener, server), daemon=True
    )
    serving.start()
    assert control.recv() == "ready"
    yield f"http://{LOOPBACK_ADDRESS}:{credentials.port}", listener.getsockname()[1]
    control.send("end")
    serving.join(30.0)
    page.close()
    assert not serving.is_alive()


def test_stop_of_another_origin_or_without_the_secret_is_refused() -> None:
    channel, secret = MessageChannel(), "the-secret"
    with serve_stop_in_thread(channel, secret) as (address, port):

        def connect_with(origin: str, secret: str) -> ClientConnection:
            url = f"ws://{LOOPBACK_ADDRESS}:{port}/stop?secret={secret}"
            return connect(url, origin=Origin(origin))

        assert_forgeries_are_refused(connect_with, address, secret)
        assert channel.receive_all() == []
        with connect_with(address, secret) as websocket:
            websocket.send("stop")
            assert websocket.recv(20.0) == "heard"
    assert channel.receive_all() == [STOP]


@pytest.mark.slow
@pytest.mark.parametrize("path", ["/pictures", "/operate", "/stop"])
def test_websockets_of_another_origin_or_without_the_secret_are_refused(
    site: Site, path: str
) -> None:
    assert_forgeries_are_refused(
        lambda origin, secret: site.open(path, origin, secret=secret),
        site.address,
        site.parameters["secret"],
    )


@pytest.mark.slow
def test_another_host_name_is_refused(site: Site) -> None:
    with pytest.raises(urllib.error.HTTPError, match="400"):
        site.fetch("", Host="evil.example")


@pytest.mark.slow
def test_another_origin_is_refused_at_niceguis_socket(site: Site) -> None:
    path = "/_nicegui_ws/socket.io/?EIO=4&transport="
    assert site.fetch(f"{path}polling", Origin=site.address) == 200
    with pytest.raises(urllib.error.HTTPError, match="403"):
        site.fetch(f"{path}polling", Origin="http://evil.example")
    with pytest.raises(InvalidStatus, match="403"):
        site.open(f"{path}websocket&match", "http://evil.example")


@pytest.mark.slow
def test_a_watcher_or_a_late_message_is_refused_with_the_reason(site: Site) -> None:
    with site.open("/pictures") as pictures, site.open("/operate") as holder:
        at = site.until(pictures, "OFF")["at"] - 1_000_000_000
        name = json.loads(holder.recv(20.0))["name"]
        assert site.board(pictures)["holder"] == name
        with site.open("/operate") as watcher:
            assert json.loads(watcher.recv(20.0))["name"] != name
            watcher.send(json.dumps({"do": "enable", "at": site.board(pictures)["at"]}))
            assert "another browser has control" in json.loads(watcher.recv(20.0))["refused"]
        for message, reason in (
            (json.dumps({"do": "enable", "at": at}), "too old"),
            (b"\xff\xfe", "not JSON"),
            ("{", "not JSON"),
        ):
            holder.send(message)
            assert reason in json.loads(holder.recv(20.0))["refused"]
        for _ in range(5):
            assert site.board(pictures)["phase"] == "OFF"


@pytest.mark.slow
def test_a_remote_browser_signs_in_and_gets_pictures_and_stop(site: Site) -> None:
    """The browser of the fixture has signed in. STOP needs no token.

    STOP ends the session of the shared page, so this test is the last one.
    """
    for path in ("", "/rcmservo/stop.js", "/_nicegui_ws/socket.io/?EIO=4&transport=polling"):
        with pytest.raises(urllib.error.HTTPError, match="401"):
            urllib.request.urlopen(site.address + path)
        assert site.fetch(path) == 200
    with site.open("/pictures") as pictures:
        pictures.send("next")
        assert len(pictures.recv(20.0)) > 1000
    with pytest.raises(InvalidStatus, match="403"):
        site.open("/pictures", is_signed_in=False)
    with site.open("/stop", is_signed_in=False) as stop:
        stop.send("stop")
        assert stop.recv(20.0) == "heard"
