"""A web server as a process that ends when it is told to."""

import asyncio
import contextlib
import socket
from collections.abc import Generator
from multiprocessing.connection import Connection

import uvicorn

SHUTDOWN_GRACE_S = 1
"""s for which browsers that stay are waited for at the end."""


class PageServer(uvicorn.Server):
    """One that leaves signals alone: Ctrl-C is the supervisor's."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None]:
        yield


async def serve_until_stopped(
    settings: uvicorn.Config, listening: socket.socket, control: Connection
) -> None:
    """Serve until the other end of `control` speaks or is gone; it is told once this listens."""
    loop, server = asyncio.get_running_loop(), PageServer(settings)

    def end() -> None:
        server.should_exit = True
        loop.remove_reader(control.fileno())

    loop.add_reader(control.fileno(), end)
    control.send("ready")
    await server.serve(sockets=[listening])
