"""The page's process: NiceGUI's page, and the websockets by which it sees and wants.

/pictures   the browser asks for the next picture and gets it, with the board
/operate    what the browser wants; it is told what was refused
"""

import asyncio
import socket
from collections.abc import Generator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from time import monotonic_ns

import uvicorn
from fastapi import FastAPI
from nicegui import app as pages
from nicegui import ui
from starlette.websockets import WebSocket, WebSocketDisconnect

from rcmservo.errors import BadInput
from rcmservo.page.channels import Desk
from rcmservo.page.control_ownership import ControlOwnership, MessageRefused, interpret_message
from rcmservo.page.messages import (
    CLEAR,
    Heartbeat,
    Change,
    DeletePose,
    JogJoints,
    JogMarker,
    ReleaseJog,
    BrowserMessage,
    DisturbanceRequest,
)
from rcmservo.page.poses import PoseStore
from rcmservo.page.settings import IMMEDIATE_PARTS, Chosen
from rcmservo.page.view_model import Dashboard
from rcmservo.page.web.access import receive_text
from rcmservo.page.web.dashboard_routes import dashboard_routes
from rcmservo.page.web.layout import lay_out
from rcmservo.page.web.origin_check import OriginCheck
from rcmservo.page.web.pictures import Pictures, pack_picture
from rcmservo.page.web.runs_routes import runs_routes
from rcmservo.page.web.server_process import SHUTDOWN_GRACE_S, serve_until_stopped
from rcmservo.page.web.sign_in import SignIn
from rcmservo.page.web.site import Site
from rcmservo.safety.state_machine import Request


def serve_page(desk: Desk, site: Site, listening: socket.socket, control: Connection) -> None:
    """Be the page until the other end of `control` speaks or is gone."""
    poses = PoseStore(site.poses)
    poses.load()
    board = Dashboard(desk, poses, shape=site.shape, truth=site.truth)
    who, doors = ControlOwnership(), site.doors
    pictures = Pictures(site.camera(), board)
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    sign_in = SignIn(doors.token, doors.port) if doors.token else None
    app.add_middleware(OriginCheck, port=doors.port, sign_in=sign_in)

    @app.websocket("/pictures")
    async def see(wire: WebSocket) -> None:  # pyright: ignore[reportUnusedFunction]
        if await doors.accept(wire):
            with suppress(WebSocketDisconnect):
                await _send_pictures(wire, pictures, who)

    @app.websocket("/operate")
    async def operate(wire: WebSocket) -> None:  # pyright: ignore[reportUnusedFunction]
        if not await doors.accept(wire):
            return
        name = who.join(monotonic_ns())
        try:
            await _receive_messages(wire, name, who, desk, board, site.chosen)
        except WebSocketDisconnect:
            """The browser is gone."""
        finally:
            with pause_on_handover(who, desk):
                who.leave(name, monotonic_ns())

    app.include_router(dashboard_routes(doors, board, site.chosen))
    app.include_router(runs_routes(doors, site.runs))
    lay_out(site)
    ui.run_with(
        app, title=site.title, dark=None, show_welcome_message=False, reconnect_timeout=10.0
    )
    pages.on_startup(pictures.pump)
    settings = uvicorn.Config(
        app,
        log_level="error",
        ws_max_size=65536,
        ws_per_message_deflate=False,  # a JPEG gets no smaller
        timeout_graceful_shutdown=SHUTDOWN_GRACE_S,
    )
    asyncio.run(serve_until_stopped(settings, listening, control))


async def _send_pictures(wire: WebSocket, pictures: Pictures, who: ControlOwnership) -> None:
    """One browser's pictures, as it asks for them."""
    count = 0
    while True:
        await receive_text(wire)
        shown = await pictures.after(count)
        count = shown.count
        about = {"holder": who.holder, "asking": who.requester}
        await wire.send_bytes(pack_picture(shown, about))


@contextmanager
def pause_on_handover(who: ControlOwnership, desk: Desk) -> Generator[None]:
    """What is in motion is paused where control changes hands in here."""
    before = who.holder
    yield
    if who.holder != before:
        desk.hand.release()
        desk.wants.put(Request.PAUSE)


async def _receive_messages(
    wire: WebSocket, name: str, who: ControlOwnership, desk: Desk, board: Dashboard, chosen: Chosen
) -> None:
    """What one browser wants. It is told its name, and what was refused."""
    await wire.send_json({"name": name})
    while True:
        text = await receive_text(wire)
        refused = ""
        try:
            with pause_on_handover(who, desk):
                message = interpret_message(
                    text, name, who, board.poses.targets.get, monotonic_ns()
                )
        except MessageRefused as error:
            refused = str(error)
        else:
            if isinstance(message, Change):
                refused = change_settings(message, chosen, desk, board)
            elif isinstance(message, DeletePose):
                refused = board.poses.delete(message.name)
            else:
                refused = "" if dispatch(message, desk) else "the servo does not listen"
        if refused:
            await wire.send_json({"refused": refused})


def dispatch(message: BrowserMessage | None, desk: Desk) -> bool:
    """Pass on what was told; whether there was room for it."""
    match message:
        case None:
            return True
        case JogJoints():
            desk.hand.hold(message.press, message.rates, message.speed_scale)
        case JogMarker():
            desk.hand.hold(message.press, message.velocity, message.speed_scale, moves_marker=True)
        case ReleaseJog():
            desk.hand.release()
        case DisturbanceRequest():
            return desk.trouble.put(message)
        case Heartbeat():
            desk.hand.send_heartbeat()
        case _:
            if message is Request.CLEAR:
                desk.bell.put(CLEAR)
            return desk.wants.put(message)
    return True


def change_settings(change: Change, chosen: Chosen, desk: Desk, board: Dashboard) -> str:
    """Pass on a change; why it was refused, empty where it was not."""
    try:
        chosen.with_change(change)
    except BadInput as error:
        return str(error)
    if not desk.changes.put(change):
        return "the server does not listen"
    chosen.take(change)
    board.settings_version += 1
    if change.part in IMMEDIATE_PARTS and board.standby is None:
        return "" if desk.wants.put(change) else "the servo does not listen"
    return ""
