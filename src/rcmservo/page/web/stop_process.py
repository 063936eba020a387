"""Process that passes STOP from any browser to the supervisor, independent of page and servo."""

import asyncio
import socket
from multiprocessing.connection import Connection

from starlette.applications import Starlette
from starlette.routing import WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from rcmservo.page.channels import MessageChannel
from rcmservo.page.messages import STOP
from rcmservo.page.web.access import PageCredentials, receive_text
from rcmservo.page.web.origin_check import OriginCheck
from rcmservo.page.web.server_process import serve_until_stopped


def serve_stop(
    stop_requests: MessageChannel,
    access: PageCredentials,
    listener: socket.socket,
    control: Connection,
) -> None:
    """Forward stop requests until the other end of `control` sends a message or is closed."""

    async def receive_stops(websocket: WebSocket) -> None:
        if not await access.accept(websocket):
            return
        try:
            while True:
                await receive_text(websocket)
                await websocket.send_text("heard" if stop_requests.send(STOP) else "not heard")
        except WebSocketDisconnect:
            return

    app = OriginCheck(Starlette(routes=[WebSocketRoute("/stop", receive_stops)]), access.port)
    asyncio.run(serve_until_stopped(app, listener, control, lifespan="off"))
