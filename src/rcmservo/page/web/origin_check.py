"""At the door: what comes neither from a page of this server nor from a person gets no further.

A browser tells by which name it asks, and which page asks. A name of somebody's that is made to
lead here, and a page of another origin, are known by that. So the name must be the address at
which the request arrived, and the page one of that address.
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
    """What a request is answered that is not let in.

    Parameters
    ----------
    status : int
        Of HTTP.
    why : str
        For a person.
    """

    status: int
    reason: str


def host_names(address: str) -> tuple[str, ...]:
    """What this server may be called by who reached it at an address of its own."""
    try:
        ip = IPv4Address(address)
    except AddressValueError:
        return ()
    return (address, "localhost") if ip.is_loopback else (address,)


def find_refusal(
    headers: Headers, address: str, port: int, origin_required: bool
) -> Refusal | None:
    """Why what arrived at the address is not from a page of this server, which is at the port. A
    browser ``must_tell`` the origin of a page that opens a websocket; a page that is fetched has
    none.
    """
    names, hosts, origins = host_names(address), headers.getlist("host"), headers.getlist("origin")
    if len(hosts) != 1 or hosts[0].partition(":")[0].lower() not in names:
        return Refusal(400, "this server is known by its address alone, not by that name")
    allowed = {f"http://{name}{'' if port == 80 else f':{port}'}" for name in names}
    if (origins or origin_required) and not (len(origins) == 1 and origins[0] in allowed):
        return Refusal(403, "that comes from a page of another server")
    return None


class OriginCheck:
    """Stands before all that a process serves for the page at the port; whoever must sign in
    first, does so here.
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
    """Answer so that no page of another origin can show it in a frame, where a person would press
    what is not seen.
    """

    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            MutableHeaders(scope=message)["x-frame-options"] = "DENY"
        await send(message)

    return sent
