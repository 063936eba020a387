"""Refusal of requests from other servers' pages.

A request names the host that the browser addresses and the origin (scheme, host and port) of the
page that makes the request. The host must be the address at which the request arrived, which
excludes foreign host names that resolve to this computer. The origin must be one of that address,
which excludes pages of other servers.
"""

from ipaddress import AddressValueError, IPv4Address

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import HTTPConnection, Request
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from rcmservo.page.web.access import FORBIDDEN_CLOSE_CODE
from rcmservo.page.web.sign_in import SignIn


def list_host_names(address: str) -> tuple[str, ...]:
    """Return the host names of this server for a request that arrived at an address."""
    try:
        ip = IPv4Address(address)
    except AddressValueError:
        return ()
    return (address, "localhost") if ip.is_loopback else (address,)


def find_refusal(
    headers: Headers, address: str, port: int, origin_required: bool
) -> PlainTextResponse | None:
    """Return the answer that refuses a request from a page of another server, or None.

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
    names, hosts = list_host_names(address), headers.getlist("host")
    if len(hosts) != 1 or hosts[0].partition(":")[0].lower() not in names:
        reason = "this server accepts its address only, not another host name"
        return PlainTextResponse(reason, 400)
    origins = headers.getlist("origin")
    allowed = {f"http://{name}{'' if port == 80 else f':{port}'}" for name in names}
    if (origins or origin_required) and not (len(origins) == 1 and origins[0] in allowed):
        return PlainTextResponse("the request comes from a page of another server", 403)
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
        refusal = find_refusal(Headers(scope=scope), server[0], self._port, is_websocket)
        sign_in = self._sign_in
        is_signed_out = sign_in is not None and not sign_in.is_signed_in(HTTPConnection(scope))
        if is_websocket and (refusal or is_signed_out):
            await WebSocket(scope, receive, send).close(FORBIDDEN_CLOSE_CODE)
        elif is_websocket:
            await self._app(scope, receive, send)
        elif refusal:
            await refusal(scope, receive, send)
        elif sign_in is not None and (is_signed_out or scope["method"] == "POST"):
            response = await sign_in.answer(Request(scope, receive))
            await response(scope, receive, deny_frames(send))
        else:
            await self._app(scope, receive, deny_frames(send))


def deny_frames(send: Send) -> Send:
    """Return `send` with a header that forbids other pages to embed this one in a frame.

    Otherwise a foreign page could cover the buttons, and its user would press them unknowingly.
    """

    async def send_with_header(message: Message) -> None:
        if message["type"] == "http.response.start":
            MutableHeaders(scope=message)["x-frame-options"] = "DENY"
        await send(message)

    return send_with_header
