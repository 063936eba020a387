"""STOP, in a process of its own: from any browser that watches straight to the supervisor, however
the page and the servo are.
"""

import asyncio
import socket
from multiprocessing.connection import Connection

import uvicorn
from starlette.applications import Starlette
from starlette.routing import WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from rcmservo.page.channels import Post
from rcmservo.page.messages import STOP
from rcmservo.page.web.access import Doors, said_on
from rcmservo.page.web.origin_check import Porter
from rcmservo.page.web.server_process import GRACE, until_told


def serve_stop(bell: Post, doors: Doors, listening: socket.socket, control: Connection) -> None:
    """Ring the bell for whoever presses STOP, until the other end of `control` speaks or is
    gone.
    """

    async def pressed(wire: WebSocket) -> None:
        if not await doors.let_in(wire):
            return
        try:
            while True:
                await said_on(wire)
                await wire.send_text("heard" if bell.put(STOP) else "not heard")
        except WebSocketDisconnect:
            return

    app = Porter(Starlette(routes=[WebSocketRoute("/stop", pressed)]), doors.port)
    settings = uvicorn.Config(
        app, log_level="error", lifespan="off", timeout_graceful_shutdown=GRACE
    )
    asyncio.run(until_told(settings, listening, control))
