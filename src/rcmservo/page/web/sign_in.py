"""Sign-in: a browser sends the token once and is known by a cookie until the server ends."""

import time
from collections.abc import Callable
from pathlib import Path
from urllib.parse import parse_qs

from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from rcmservo.page.web.access import are_secrets_equal, draw_secret

MAX_FAILED_ATTEMPTS, ATTEMPT_WINDOW_S, MAX_TRACKED_ADDRESSES = 5, 60.0, 1000
"""Limit on the failed attempts of an address, the time (s) to which it applies, and the number of
addresses whose attempts are stored."""
MAX_FORM_BYTES = 2048
"""Largest form in bytes."""

SIGN_IN_PAGE = (Path(__file__).parent / "static/sign_in.html").read_text()
"""HTML of the sign-in form, with MESSAGE in the place of the answer to the last attempt."""


class FailedAttempts:
    """Failed attempts by address, to limit their rate."""

    def __init__(self) -> None:
        self._times: dict[str, list[float]] = {}

    def compute_wait(self, address: str, now: float) -> float:
        """Return the time in s until another attempt of the address is accepted."""
        times = self._times.get(address, [])
        if len(times) < MAX_FAILED_ATTEMPTS:
            return 0.0
        return max(0.0, times[0] + ATTEMPT_WINDOW_S - now)

    def add(self, address: str, now: float) -> None:
        """Record a failed attempt."""
        times = self._times.pop(address, [])
        self._times[address] = [*times, now][-MAX_FAILED_ATTEMPTS:]
        if len(self._times) > MAX_TRACKED_ADDRESSES:
            del self._times[next(iter(self._times))]  # the address with the oldest last attempt


class SignIn:
    """Sign-in with a token.

    Parameters
    ----------
    token : str
        Token that a browser must send.
    port : int
        Port of the page.
    read_clock : callable
        Returns the time in s.
    """

    def __init__(
        self, token: str, port: int, read_clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._token, self._read_clock = token, read_clock
        self._cookie = f"rcmservo-{port}"  # a browser sends one cookie to all ports of an address
        self._cookie_value = draw_secret()
        self._failed = FailedAttempts()

    def is_signed_in(self, browser: HTTPConnection) -> bool:
        """Return whether a browser has signed in."""
        return are_secrets_equal(browser.cookies.get(self._cookie, ""), self._cookie_value)

    async def answer(self, request: Request) -> Response:
        """Return the sign-in page, or the response to a token that was sent."""
        if request.method != "POST":
            return _answer_with_form(401)
        token = await _read_token(request)
        address, now = request.client.host if request.client else "", self._read_clock()
        wait_s = self._failed.compute_wait(address, now)
        if wait_s > 0.0:
            wait = f"wait {wait_s:.0f} s, then try again."
            return _answer_with_form(429, f"Too many failed attempts: {wait}")
        if not are_secrets_equal(token, self._token):
            self._failed.add(address, now)
            return _answer_with_form(403, "That is not the token.")
        response = RedirectResponse("/", 303)
        response.set_cookie(self._cookie, self._cookie_value, httponly=True, samesite="strict")
        return response


def _answer_with_form(status: int, message: str = "") -> Response:
    html = SIGN_IN_PAGE.replace("MESSAGE", message)
    return HTMLResponse(html, status, {"cache-control": "no-store"})


async def _read_token(request: Request) -> str:
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
