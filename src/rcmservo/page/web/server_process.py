"""Web server in a child process, which its parent ends."""

import asyncio
import contextlib
import socket
from collections.abc import Generator
from multiprocessing.connection import Connection
from typing import Any

import uvicorn
from starlette.types import ASGIApp

SHUTDOWN_GRACE_S = 1
"""Time (s) to wait for connected browsers at the end."""


class PageServer(uvicorn.Server):
    """Server without signal handlers, because the parent process handles Ctrl-C."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None]:
        yield


async def serve_until_stopped(
    app: ASGIApp, listener: socket.socket, control: Connection, **options: Any
) -> None:
    """Serve until the other end of `control` sends a message or is closed.

    The server sends "ready" to `control` before it serves.

    Parameters
    ----------
    app
        Application to serve.
    listener
        Listening socket.
    control
        Connection to the process that started this one.
    options
        Further options of `uvicorn.Config`.
    """
    settings = uvicorn.Config(
        app, log_level="error", timeout_graceful_shutdown=SHUTDOWN_GRACE_S, **options
    )
    loop, server = asyncio.get_running_loop(), PageServer(settings)

    def end() -> None:
        server.should_exit = True
        loop.remove_reader(control.fileno())

    loop.add_reader(control.fileno(), end)
    control.send("ready")
    await server.serve(sockets=[listener])
