"""Web server in a process that ends on request."""

import asyncio
import contextlib
import socket
from collections.abc import Generator
from multiprocessing.connection import Connection

import uvicorn

SHUTDOWN_GRACE_S = 1
"""Time (s) to wait for connected browsers at the end."""


class PageServer(uvicorn.Server):
    """Server without signal handlers: Ctrl-C is the supervisor's."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None]:
        yield


async def serve_until_stopped(
    settings: uvicorn.Config, listening: socket.socket, control: Connection
) -> None:
    """Serve until the other end of `control` sends a message or is closed.

    The server sends "ready" to it before it serves.
    """
    loop, server = asyncio.get_running_loop(), PageServer(settings)

    def end() -> None:
        server.should_exit = True
        loop.remove_reader(control.fileno())

    loop.add_reader(control.fileno(), end)
    control.send("ready")
    await server.serve(sockets=[listening])
