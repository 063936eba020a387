"""Refusal of requests from other servers' pages.

A browser reports the host name that it requests and the origin of the page that makes the request.
This reveals a foreign host name that resolves to this computer, and a page of another origin. The
host must therefore be the address at which the request arrived, and the origin one of that address.
"""

from ipaddress import AddressValueError, IPv4Address
from typing import NamedTuple

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import HTTPConnection, Request
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from rcmservo.page.web.access import FORBIDDEN_CLOSE_CODE
from rcmservo.page.web.sign_in import SignIn


class Refusal(NamedTuple):
    """Answer to a refused request.

    Parameters
    ----------
    status : int
        HTTP status.
    reason : str
        Reason in words.
    """

    status: int
    reason: str


def host_names(address: str) -> tuple[str, ...]:
    """Return the host names of this server for a request that arrived at an address."""
    try:
        ip = IPv4Address(address)
    except AddressValueError:
        return ()
    return (address, "localhost") if ip.is_loopback else (address,)


def find_refusal(
    headers: Headers, address: str, port: int, origin_required: bool
) -> Refusal | None:
    """Return the refusal of a request from a page of another server, or None.

    Parameters
    ----------
    headers : Headers
        Headers of the request.
    address : str
        Address at which it arrived.
    port : int
        Port of the page.
    origin_required : bool
        The request must have an origin. A browser sends one with every websocket, but not with the
        first request for a page.
    """
    names, hosts, origins = host_names(address), headers.getlist("host"), headers.getlist("origin")
    if len(hosts) != 1 or hosts[0].partition(":")[0].lower() not in names:
        return Refusal(400, "this server accepts its address only, not another host name")
    allowed = {f"http://{name}{'' if port == 80 else f':{port}'}" for name in names}
    if (origins or origin_required) and not (len(origins) == 1 and origins[0] in allowed):
        return Refusal(403, "the request comes from a page of another server")
    return None


class OriginCheck:
    """ASGI middleware that checks host, origin and sign-in of all requests for the page.

    Parameters
    ----------
    app : ASGIApp
        Application behind it.
    port : int
        Port of the page.
    sign_in : SignIn, optional
        Sign-in that the requests need.
    """

    def __init__(self, app: ASGIApp, port: int, sign_in: SignIn | None = None) -> None:
        self._app, self._port, self._sign_in = app, port, sign_in

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        is_websocket, server = scope["type"] == "websocket", scope.get("server") or ("", 0)
        headers = Headers(scope=scope)
        refused = find_refusal(headers, server[0], self._port, origin_required=is_websocket)
        is_signed_out = self._sign_in is not None and not self._sign_in.is_signed_in(
            HTTPConnection(scope)
        )
        if is_websocket and (refused or is_signed_out):
            await WebSocket(scope, receive, send).close(FORBIDDEN_CLOSE_CODE)
        elif is_websocket:
            await self._app(scope, receive, send)
        elif refused:
            answer = PlainTextResponse(refused.reason, refused.status)
            await answer(scope, receive, send)
        elif self._sign_in is not None and (is_signed_out or scope["method"] == "POST"):
            answer = await self._sign_in.answer(Request(scope, receive))
            await answer(scope, receive, deny_frames(send))
        else:
            await self._app(scope, receive, deny_frames(send))


def deny_frames(send: Send) -> Send:
    """Add the header that forbids frames, so that no other page can overlay this one.

    A user of such a page would press buttons that are hidden.
    """

    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            MutableHeaders(scope=message)["x-frame-options"] = "DENY"
        await send(message)

    return sent
