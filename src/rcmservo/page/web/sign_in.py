"""Sign-in: a browser sends the token once and is known by a cookie until the server ends."""

import time
from collections.abc import Callable
from pathlib import Path
from urllib.parse import parse_qs

from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from rcmservo.page.web.access import draw_secret, secrets_equal

MAX_FAILED_ATTEMPTS, ATTEMPT_WINDOW_S, MAX_TRACKED_ADDRESSES = 5, 60.0, 1000
"""Failed attempts of an address within a time (s), and the number of addresses that are stored."""
MAX_FORM_BYTES = 2048
"""Largest form in bytes."""

SIGN_IN_PAGE = (Path(__file__).parent / "static/sign_in.html").read_text()
"""Page with the sign-in form; MESSAGE stands for the answer to the last attempt."""


class FailedAttempts:
    """Failed attempts by address, to limit their rate."""

    def __init__(self) -> None:
        self._times: dict[str, list[float]] = {}

    def remaining_wait(self, address: str, now: float) -> float:
        """Return the time in s until another attempt of the address is accepted."""
        before = self._times.get(address, [])
        if len(before) < MAX_FAILED_ATTEMPTS:
            return 0.0
        return max(0.0, before[0] + ATTEMPT_WINDOW_S - now)

    def add(self, address: str, now: float) -> None:
        """Record a failed attempt."""
        before = self._times.pop(address, [])
        self._times[address] = [*before, now][-MAX_FAILED_ATTEMPTS:]
        if len(self._times) > MAX_TRACKED_ADDRESSES:
            del self._times[next(iter(self._times))]


class SignIn:
    """Sign-in with a token at the server whose page is at the port."""

    def __init__(self, token: str, port: int, now: Callable[[], float] = time.monotonic) -> None:
        self._token, self._now = token, now
        self._cookie = f"rcmservo-{port}"  # a browser sends one cookie to all ports of an address
        self._cookie_value = draw_secret()
        self._failed = FailedAttempts()

    def is_signed_in(self, browser: HTTPConnection) -> bool:
        """Return whether a browser has signed in."""
        return secrets_equal(browser.cookies.get(self._cookie, ""), self._cookie_value)

    async def answer(self, request: Request) -> Response:
        """Return the sign-in page, or the response to a token that was sent."""
        if request.method != "POST":
            return _sign_in_page(401)
        token = await _token(request)
        address, now = request.client.host if request.client else "", self._now()
        wait = self._failed.remaining_wait(address, now)
        if wait > 0.0:
            return _sign_in_page(
                429, f"Too many failed attempts: wait {wait:.0f} s, then try again."
            )
        if not secrets_equal(token, self._token):
            self._failed.add(address, now)
            return _sign_in_page(403, "That is not the token.")
        response = RedirectResponse("/", 303)
        response.set_cookie(self._cookie, self._cookie_value, httponly=True, samesite="strict")
        return response


def _sign_in_page(status: int, message: str = "") -> Response:
    return HTMLResponse(
        SIGN_IN_PAGE.replace("MESSAGE", message), status, {"cache-control": "no-store"}
    )


async def _token(request: Request) -> str:
    """Return the token in a form; empty if there is none."""
    content = b""
    try:
        async for part in request.stream():
            content += part
            if len(content) > MAX_FORM_BYTES:
                return ""
    except ClientDisconnect:
        return ""
    return parse_qs(content.decode(errors="replace")).get("token", [""])[0].strip()
