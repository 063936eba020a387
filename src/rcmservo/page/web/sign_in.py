"""Signing in: a browser gives the token once, and is known by a cookie until the server ends."""

import time
from collections.abc import Callable
from pathlib import Path
from urllib.parse import parse_qs

from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from rcmservo.page.web.access import drawn_secret, same

WRONG, WITHIN, WHOM = 5, 60.0, 1000
"""Tokens that may be wrong within so many s from one address; addresses that are kept in mind."""
LONGEST = 2048
"""Bytes of what is sent to sign in."""

SHEET = (Path(__file__).parent / "static/sign_in.html").read_text()
"""Page that asks for the token; SAID stands for the answer to the last one."""


class Guesses:
    """Wrong tokens, which make an address wait, so that guessing is slow."""

    def __init__(self) -> None:
        self._wrong: dict[str, list[float]] = {}

    def wait(self, who: str, now: float) -> float:
        """S until the address is heard again."""
        before = self._wrong.get(who, [])
        return 0.0 if len(before) < WRONG else max(0.0, before[0] + WITHIN - now)

    def wrong(self, who: str, now: float) -> None:
        """It gave a wrong one."""
        before = self._wrong.pop(who, [])
        self._wrong[who] = [*before, now][-WRONG:]
        if len(self._wrong) > WHOM:
            del self._wrong[next(iter(self._wrong))]


class SignIn:
    """Who knows the token of the server whose page is at the port."""

    def __init__(self, token: str, port: int, now: Callable[[], float] = time.monotonic) -> None:
        self._token, self._now = token, now
        self._cookie = f"rcmservo-{port}"  # those of all ports of an address are in one jar
        self._known = drawn_secret()
        self._guesses = Guesses()

    def knows(self, browser: HTTPConnection) -> bool:
        """Whether it has signed in."""
        return same(browser.cookies.get(self._cookie, ""), self._known)

    async def answer(self, request: Request) -> Response:
        """The sheet on which the token is asked for; what becomes of one that was sent."""
        if request.method != "POST":
            return _sheet(401)
        token = await _token(request)
        who, now = request.client.host if request.client else "", self._now()
        wait = self._guesses.wait(who, now)
        if wait > 0.0:
            return _sheet(429, f"That was wrong too often: wait {wait:.0f} s, then try again.")
        if not same(token, self._token):
            self._guesses.wrong(who, now)
            return _sheet(403, "That is not the token.")
        known = RedirectResponse("/", 303)
        known.set_cookie(self._cookie, self._known, httponly=True, samesite="strict")
        return known


def _sheet(status: int, said: str = "") -> Response:
    return HTMLResponse(SHEET.replace("SAID", said), status, {"cache-control": "no-store"})


async def _token(request: Request) -> str:
    """The one that was sent; empty where that is none."""
    sent = b""
    try:
        async for part in request.stream():
            sent += part
            if len(sent) > LONGEST:
                return ""
    except ClientDisconnect:
        return ""
    return parse_qs(sent.decode(errors="replace")).get("token", [""])[0].strip()
