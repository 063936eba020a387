"""Sign-in, host and origin: only a browser with the token, and only this server's pages."""

import stat
from pathlib import Path
from typing import Any

import pytest
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.routing import Route, WebSocketRoute
from starlette.testclient import TestClient
from starlette.websockets import WebSocket, WebSocketDisconnect

from rcmservo.cli.cli import main
from rcmservo.errors import BadInput, UnusableFile
from rcmservo.page.web.origin_check import OriginCheck, find_refusal, list_host_names
from rcmservo.page.web.sign_in import (
    ATTEMPT_WINDOW_S,
    MAX_FAILED_ATTEMPTS,
    MAX_TRACKED_ADDRESSES,
    FailedAttempts,
    SignIn,
)
from rcmservo.page.web.token_file import load_required_token, load_token

TOKEN = "of-sixteen-chars"
LAB = "192.168.1.5"
PAGE_ADDRESS = f"http://{LAB}:8080"
EVIL = {"origin": "http://evil.example"}


class Server:
    """Server that requires the token, with a settable time."""

    def __init__(self, token: str = TOKEN) -> None:
        async def page(request: Any) -> PlainTextResponse:
            return PlainTextResponse("the secret")

        async def websocket(websocket: WebSocket) -> None:
            await websocket.accept()
            await websocket.close()

        app = Starlette(
            routes=[Route("/{path:path}", page), WebSocketRoute("/websocket", websocket)]
        )
        sign_in = SignIn(token, 8080, lambda: self.now) if token else None
        self.now, self.app = 0.0, OriginCheck(app, 8080, sign_in)

    def browser(self, address: str = PAGE_ADDRESS, client: str = "192.168.1.9") -> Any:
        return TestClient(self.app, address, client=(client, 50000), follow_redirects=False)

    def signed_in(self) -> Any:
        browser = self.browser()
        browser.post("/", data={"token": TOKEN})
        return browser


def opens_websocket(browser: Any, **headers: str) -> bool:
    try:
        with browser.websocket_connect(f"ws://{LAB}:8080/websocket", headers=headers) as websocket:
            websocket.close()
    except WebSocketDisconnect:
        return False
    return True


def test_only_the_sign_in_page_is_served_without_the_token() -> None:
    browser = Server().browser()
    for path in ("/", "/rcmservo/stop.js", "/_nicegui_ws/socket.io/", "/settings", "/runs"):
        got = browser.get(path)
        assert got.status_code == 401 and "secret" not in got.text and "Sign in" in got.text
    assert not opens_websocket(browser, origin=PAGE_ADDRESS)


def test_the_token_opens_page_and_websockets_until_the_server_ends() -> None:
    server = Server()
    browser = server.browser()
    known = browser.post("/", data={"token": f" {TOKEN}\n"}, headers={"origin": PAGE_ADDRESS})
    assert known.status_code == 303 and known.headers["location"] == "/"
    cookie = known.headers["set-cookie"].lower()
    assert "httponly" in cookie and "samesite=strict" in cookie and TOKEN not in cookie
    assert browser.get("/").text == "the secret" and opens_websocket(browser, origin=PAGE_ADDRESS)
    assert server.browser().get("/").status_code == 401  # another browser
    after = Server().browser()
    after.cookies = browser.cookies
    assert after.get("/").status_code == 401  # a cookie of an earlier server


@pytest.mark.parametrize("token", ["", TOKEN[:-1], TOKEN + "x", TOKEN.upper(), "é" * 16])
def test_another_token_is_refused_with_a_reason(token: str) -> None:
    browser = Server().browser()
    got = browser.post("/", data={"token": token})
    assert got.status_code == 403 and "not the token" in got.text
    assert browser.get("/").status_code == 401


LONG = b"more=" + b"x" * 9999 + b"&token=" + TOKEN.encode()


@pytest.mark.parametrize("sent", [b"", b"\xff" * 9, b"token=" + b"x" * 9999, b"&" * 2048, LONG])
def test_random_content_instead_of_a_token_is_refused(sent: bytes) -> None:
    assert Server().browser().post("/", content=sent).status_code == 403


def test_failed_attempts_delay_only_their_address() -> None:
    server = Server()
    guesser = server.browser()
    for _ in range(MAX_FAILED_ATTEMPTS):
        assert guesser.post("/", data={"token": "wrong"}).status_code == 403
    waits = guesser.post("/", data={"token": TOKEN})
    assert waits.status_code == 429 and "wait 60 s" in waits.text  # although this token is correct
    assert server.browser(client="192.168.1.10").post("/", data={"token": TOKEN}).status_code == 303
    server.now = ATTEMPT_WINDOW_S
    assert guesser.post("/", data={"token": TOKEN}).status_code == 303


def test_the_number_of_stored_addresses_is_bounded() -> None:
    guesses = FailedAttempts()
    for count in range(MAX_TRACKED_ADDRESSES + 100):
        for _ in range(MAX_FAILED_ATTEMPTS):
            guesses.add(str(count), 0.0)
    assert (
        len(guesses._times) == MAX_TRACKED_ADDRESSES
        and guesses.compute_wait(str(MAX_TRACKED_ADDRESSES), 0.0) > 0.0
    )


def test_a_page_of_another_origin_is_refused_in_a_signed_in_browser() -> None:
    for browser in (Server().signed_in(), Server(token="").browser()):
        assert browser.get("/").text == "the secret" and opens_websocket(
            browser, origin=PAGE_ADDRESS
        )
        for origin in ("http://evil.example", "null", f"https://{LAB}:8080", f"http://{LAB}"):
            assert browser.get("/", headers={"origin": origin}).status_code == 403
            assert not opens_websocket(browser, origin=origin)
        assert not opens_websocket(browser)  # every browser sends an origin
        assert browser.post("/_nicegui_ws/socket.io/", headers=EVIL).status_code == 403


def test_a_page_of_another_origin_cannot_sign_a_browser_in() -> None:
    browser = Server().browser()
    assert browser.post("/", data={"token": TOKEN}, headers=EVIL).status_code == 403
    assert browser.get("/").status_code == 401


def test_the_page_forbids_frames() -> None:
    for browser in (Server().browser(), Server().signed_in(), Server(token="").browser()):
        assert browser.get("/").headers["x-frame-options"] == "DENY"


@pytest.mark.parametrize(
    ("address", "names"),
    [
        ("127.0.0.1", {"127.0.0.1", "localhost"}),
        (LAB, {LAB}),
        ("", set()),
        ("evil.example", set()),
    ],
)
def test_the_host_must_be_the_address_of_the_server(address: str, names: set[str]) -> None:
    assert set(list_host_names(address)) == names
    for host in ("127.0.0.1", "localhost", LAB, "evil.example", "", "0.0.0.0", "192.168.1.6"):
        for headers in (host, f"{host}:8080", f"{host.upper()}:22"):
            refused = find_refusal(Headers({"host": headers}), address, 8080, origin_required=False)
            assert (refused is None) == (host in names), (address, headers)


def test_a_websocket_needs_exactly_one_host_and_one_origin() -> None:
    host, origin, other = (
        (b"host", LAB.encode()),
        (b"origin", PAGE_ADDRESS.encode()),
        (b"origin", b"null"),
    )
    for raw, is_accepted in (
        ([host, origin], True),
        ([host], False),
        ([origin], False),
        ([host, host, origin], False),
        ([host, origin, other], False),
    ):
        assert (
            find_refusal(Headers(raw=raw), LAB, 8080, origin_required=True) is None
        ) == is_accepted, raw


def test_an_origin_omits_port_80() -> None:
    for origin, is_accepted in ((f"http://{LAB}", True), (f"http://{LAB}:80", False)):
        headers = Headers({"host": LAB, "origin": origin})
        assert (find_refusal(headers, LAB, 80, origin_required=True) is None) == is_accepted


def test_a_token_is_created_once_and_only_its_owner_can_read_it(tmp_path: Path) -> None:
    file = tmp_path / "token"
    token = load_required_token("0.0.0.0", file)
    assert len(token) >= 32 and stat.S_IMODE(file.stat().st_mode) == 0o600
    assert load_token(file) == token != load_token(tmp_path / "other")


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o660, 0o644])
def test_a_token_that_others_can_read_is_refused(tmp_path: Path, mode: int) -> None:
    (file := tmp_path / "token").write_text(TOKEN)
    file.chmod(mode)
    with pytest.raises(UnusableFile, match=r"others than its owner: chmod 600"):
        load_token(file)
    file.chmod(0o600)
    assert load_token(file) == TOKEN


@pytest.mark.parametrize("text", ["", "x" * 15, "x" * 257, "x" * 99999, "x " * 20, "é" * 20])
def test_an_invalid_token_is_refused(tmp_path: Path, text: str) -> None:
    (file := tmp_path / "token").write_text(text)
    file.chmod(0o600)
    with pytest.raises(UnusableFile, match="one word of 16 to 256"):
        load_token(file)


def test_a_token_file_that_cannot_be_created_is_reported(tmp_path: Path) -> None:
    tmp_path.chmod(0o700)
    for file, why in ((tmp_path, "not a regular file|cannot be"), (tmp_path / "no/token", "made")):
        with pytest.raises(UnusableFile, match=why):
            load_token(file)


@pytest.mark.parametrize("host", ["server", "", "::1", "1.2.3", "1.2.3.4:80", "127.0.0.1 "])
def test_an_invalid_address_is_refused(host: str) -> None:
    with pytest.raises(BadInput, match="--host must be an IPv4 address"):
        load_required_token(host, None)


@pytest.mark.parametrize("host", ["0.0.0.0", LAB])
def test_remote_browsers_need_a_token_file(host: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["serve", "--no-browser", "--host", host]) == 2
    error = capsys.readouterr().err
    assert "without --token-file" in error and error.count("\n") == 1
    assert load_required_token("127.0.0.1", None) == ""
