"""A web server as a process that ends when it is told to."""

import asyncio
import socket
from multiprocessing.connection import Connection

import uvicorn

GRACE = 1
"""s for which browsers that stay are waited for at the end."""


async def until_told(server: uvicorn.Server, listening: socket.socket, control: Connection) -> None:
    """Serve until the other end of `control` speaks or is gone; it is told once this listens."""
    loop = asyncio.get_running_loop()

    def end() -> None:
        server.should_exit = True
        loop.remove_reader(control.fileno())

    loop.add_reader(control.fileno(), end)
    control.send("ready")
    await server.serve(sockets=[listening])
