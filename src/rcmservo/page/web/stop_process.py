"""STOP, in a process of its own: from any browser that watches straight to the supervisor, however
the page and the servo are."""

import asyncio
import socket
from multiprocessing.connection import Connection

import uvicorn
from starlette.applications import Starlette
from starlette.routing import WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from rcmservo.page.desk import Post
from rcmservo.page.wants import STOP
from rcmservo.page.web.doors import Doors, said_on
from rcmservo.page.web.ending import GRACE, until_told
from rcmservo.page.web.porter import Porter


def serve_stop(bell: Post, doors: Doors, listening: socket.socket, control: Connection) -> None:
    """Ring the bell for whoever presses STOP, until the other end of `control` speaks or is
    gone."""

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
