"""Who is let in: pages that this server has given out, and nobody else.

A page of another origin can open a websocket to this computer, and a name of somebody's can be made
to lead here. So each websocket must tell one of this server's own origins, and the secret that
stands in the page.
"""

import secrets
import socket
from dataclasses import dataclass

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.websockets import WebSocket, WebSocketDisconnect

from rcmservo.errors import RcmServoError

HOST = "127.0.0.1"
NAMES = HOST, "localhost"
FORBIDDEN = 4403
"""Close code of a websocket that is not let in."""


class NoPagePort(RcmServoError):
    """A port that cannot be listened on."""


@dataclass(frozen=True)
class Doors:
    """What a browser must know."""

    port: int
    """That of the page."""
    secret: str
    """Drawn when the server starts."""

    @property
    def origins(self) -> list[str]:
        """Those of the page."""
        return [f"http://{name}:{self.port}" for name in NAMES]

    def knows(self, secret: str) -> bool:
        """Whether it is the secret that stands in the page."""
        return secrets.compare_digest(secret.encode(), self.secret.encode())

    def asked(self, request: Request) -> None:
        """For what is fetched: refuse whoever does not know the secret."""
        if not self.knows(request.query_params.get("secret", "")):
            raise HTTPException(403, "the page's secret is missing: open the page anew")

    async def let_in(self, wire: WebSocket) -> bool:
        """Accept a websocket that comes from the page; close any other."""
        known = self.knows(wire.query_params.get("secret", ""))
        if not known or wire.headers.get("origin") not in self.origins:
            await wire.close(FORBIDDEN)
            return False
        await wire.accept()
        return True


def drawn_secret() -> str:
    """What a page knows and nobody else."""
    return secrets.token_urlsafe(32)


async def said_on(wire: WebSocket) -> str:
    """The next message; empty where it is no text."""
    message = await wire.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1000))
    return message.get("text") or ""


def bound(port: int) -> socket.socket:
    """A socket that listens; port 0 takes one that is free."""
    wire = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    wire.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        wire.bind((HOST, port))
    except OSError as error:
        wire.close()
        raise NoPagePort(f"{HOST}:{port} cannot be listened on: {error.strerror}") from error
    wire.listen(64)
    return wire
