"""Access to the page: the secret that requests must carry, and the sockets that listen.

Every request for data and every websocket must carry the secret that stands in the page. It gets
here only after `OriginCheck` has accepted its origin.
"""

import contextlib
import errno
import secrets
import socket
from dataclasses import dataclass

from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection, Request
from starlette.websockets import WebSocket, WebSocketDisconnect

from rcmservo.errors import RcmServoError
from rcmservo.network_ports import describe_refusal

LOOPBACK_ADDRESS = "127.0.0.1"
FORBIDDEN_CLOSE_CODE = 4403
"""Close code of a websocket that is refused."""

DEFAULT_PORT, LAST_DEFAULT_PORT = 8080, 8180
"""First and last port of the page that are tried if no port is given."""


class NoPagePort(RcmServoError):
    """Port that the server cannot listen on."""


class PortTaken(NoPagePort):
    """Port that another process listens on."""


@dataclass(frozen=True)
class PageCredentials:
    """Credentials of the page.

    Parameters
    ----------
    port : int
        Port of the page.
    secret : str
        Secret in the page, drawn when the server starts.
    token : str
        Token that a browser must send before it gets the page; empty if none is required.
    """

    port: int
    secret: str
    token: str = ""

    def _has_secret(self, request: HTTPConnection) -> bool:
        return are_secrets_equal(request.query_params.get("secret", ""), self.secret)

    def require_secret(self, request: Request) -> None:
        """Refuse a request without the secret."""
        if not self._has_secret(request):
            raise HTTPException(403, "the page's secret is missing or old: reload the page")

    async def accept(self, websocket: WebSocket) -> bool:
        """Accept a websocket that carries the secret; close any other and return False."""
        if not self._has_secret(websocket):
            await websocket.close(FORBIDDEN_CLOSE_CODE)
            return False
        await websocket.accept()
        return True


def are_secrets_equal(first: str, second: str) -> bool:
    """Compare two secrets in a time that does not depend on their common part."""
    return secrets.compare_digest(first.encode(), second.encode())


def draw_secret() -> str:
    """Return a random secret."""
    return secrets.token_urlsafe(32)


async def receive_text(websocket: WebSocket) -> str:
    """Return the next message of a websocket; empty if it is not text."""
    message = await websocket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1000))
    return message.get("text") or ""


def bind_socket(host: str, port: int) -> socket.socket:
    """Return a listening socket; port 0 selects a free port.

    Raises
    ------
    PortTaken
        If another process listens on the port.
    NoPagePort
        If the server cannot listen on it for another reason.
    """
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
    except OSError as error:
        listener.close()
        kind = PortTaken if error.errno == errno.EADDRINUSE else NoPagePort
        raise kind(f"{describe_refusal(port, error)}; select another port with --port") from error
    listener.listen(64)
    return listener


def bind_pair(host: str, port: int | None) -> tuple[socket.socket, socket.socket]:
    """Return listening sockets on a port, for the page, and on the next port, for STOP.

    Port 0 selects two free ports; None selects `DEFAULT_PORT` or the next free pair.
    """
    if port is not None:
        return _bind_pair_at(host, port)
    for page_port in range(DEFAULT_PORT, LAST_DEFAULT_PORT, 2):
        with contextlib.suppress(PortTaken):
            return _bind_pair_at(host, page_port)
    return _bind_pair_at(host, DEFAULT_PORT)


def _bind_pair_at(host: str, port: int) -> tuple[socket.socket, socket.socket]:
    page_socket = bind_socket(host, port)
    try:
        return page_socket, bind_socket(host, port and port + 1)
    except NoPagePort:
        page_socket.close()
        raise


def find_reachable_address(host: str) -> str:
    """Return an address at which a server that listens on `host` can be reached."""
    if host != "0.0.0.0":
        return host
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # a reserved address (RFC 5737); nothing is sent
        except OSError:
            return LOOPBACK_ADDRESS
        return probe.getsockname()[0]
