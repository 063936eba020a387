"""Who is let in: pages that this server has given out, and nobody else.

What is fetched and each websocket must tell the secret that stands in the page; the porter has seen
to it by then that no page of another origin asks.
"""

import contextlib
import errno
import secrets
import socket
from dataclasses import dataclass

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.websockets import WebSocket, WebSocketDisconnect

from rcmservo.errors import RcmServoError
from rcmservo.network_ports import refusal

LOOPBACK_ADDRESS = "127.0.0.1"
FORBIDDEN_CLOSE_CODE = 4403
"""Close code of a websocket that is not let in."""


DEFAULT_PORT, LAST_DEFAULT_PORT = 8080, 8180
"""Ports of the page that are tried in turn if none is given."""


class NoPagePort(RcmServoError):
    """A port that cannot be listened on."""


class PortTaken(NoPagePort):
    """A port that another process listens on."""


@dataclass(frozen=True)
class Doors:
    """What a browser must know.

    Parameters
    ----------
    port : int
        That of the page.
    secret : str
        Drawn when the server starts.
    token : str
        What a browser must give before it gets the page; empty where none is asked for.
    """

    port: int
    secret: str
    token: str = ""

    def is_secret(self, secret: str) -> bool:
        """Whether it is the secret that stands in the page."""
        return secrets_equal(secret, self.secret)

    def require_secret(self, request: Request) -> None:
        """For what is fetched: refuse whoever does not know the secret."""
        if not self.is_secret(request.query_params.get("secret", "")):
            raise HTTPException(403, "the page's secret is missing: open the page anew")

    async def accept(self, wire: WebSocket) -> bool:
        """Accept a websocket that comes from the page; close any other."""
        if not self.is_secret(wire.query_params.get("secret", "")):
            await wire.close(FORBIDDEN_CLOSE_CODE)
            return False
        await wire.accept()
        return True


def secrets_equal(first: str, second: str) -> bool:
    """Whether two secrets are one, in a time that does not tell how much of them is."""
    return secrets.compare_digest(first.encode(), second.encode())


def drawn_secret() -> str:
    """What is known where it was told, and nowhere else."""
    return secrets.token_urlsafe(32)


async def receive_text(wire: WebSocket) -> str:
    """The next message; empty where it is no text."""
    message = await wire.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1000))
    return message.get("text") or ""


def bind_socket(host: str, port: int) -> socket.socket:
    """A socket that listens; port 0 takes one that is free."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
    except OSError as error:
        listener.close()
        kind = PortTaken if error.errno == errno.EADDRINUSE else NoPagePort
        raise kind(f"{refusal(port, error)}; --port names another") from error
    listener.listen(64)
    return listener


def bound_pair(host: str, port: int | None) -> tuple[socket.socket, socket.socket]:
    """Return sockets that listen on a port, for the page, and on the next one, for STOP.

    Port 0 takes any two that are free; None takes `DEFAULT_PORT`, or the next pair that is free.
    """
    if port is not None:
        return _bound_pair(host, port)
    for first in range(DEFAULT_PORT, LAST_DEFAULT_PORT, 2):
        with contextlib.suppress(PortTaken):
            return _bound_pair(host, first)
    return _bound_pair(host, DEFAULT_PORT)


def _bound_pair(host: str, port: int) -> tuple[socket.socket, socket.socket]:
    page = bind_socket(host, port)
    try:
        return page, bind_socket(host, port and port + 1)
    except NoPagePort:
        page.close()
        raise


def reached_at(host: str) -> str:
    """An address at which a server that listens there can be reached."""
    if host != "0.0.0.0":
        return host
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # of no computer, by RFC 5737; nothing is sent
        except OSError:
            return LOOPBACK_ADDRESS
        return probe.getsockname()[0]
