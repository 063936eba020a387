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
from rcmservo.page.control_ownership import Control, Unheeded, heard
from rcmservo.page.messages import CLEAR, Beat, Change, Delete, Held, Led, Released, Told, Wrong
from rcmservo.page.poses import Poses
from rcmservo.page.settings import AT_ONCE, Chosen
from rcmservo.page.view_model import Board
from rcmservo.page.web.access import said_on
from rcmservo.page.web.dashboard_routes import board_routes
from rcmservo.page.web.layout import lay_out
from rcmservo.page.web.origin_check import Porter
from rcmservo.page.web.pictures import Pictures, packed
from rcmservo.page.web.runs_routes import runs_routes
from rcmservo.page.web.server_process import GRACE, until_told
from rcmservo.page.web.sign_in import SignIn
from rcmservo.page.web.site import Site
from rcmservo.safety.state_machine import Request


def serve_page(desk: Desk, site: Site, listening: socket.socket, control: Connection) -> None:
    """Be the page until the other end of `control` speaks or is gone."""
    poses = Poses(site.poses)
    poses.read()
    board = Board(desk, poses, shape=site.shape, truth=site.truth)
    who, doors = Control(), site.doors
    pictures = Pictures(site.camera(), board)
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    sign_in = SignIn(doors.token, doors.port) if doors.token else None
    app.add_middleware(Porter, port=doors.port, sign_in=sign_in)

    @app.websocket("/pictures")
    async def see(wire: WebSocket) -> None:  # pyright: ignore[reportUnusedFunction]
        if await doors.let_in(wire):
            with suppress(WebSocketDisconnect):
                await _seen(wire, pictures, who)

    @app.websocket("/operate")
    async def operate(wire: WebSocket) -> None:  # pyright: ignore[reportUnusedFunction]
        if not await doors.let_in(wire):
            return
        name = who.join(monotonic_ns())
        try:
            await _operated(wire, name, who, desk, board, site.chosen)
        except WebSocketDisconnect:
            """The browser is gone."""
        finally:
            with changing_hands(who, desk):
                who.leave(name, monotonic_ns())

    app.include_router(board_routes(doors, board, site.chosen))
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
        timeout_graceful_shutdown=GRACE,
    )
    asyncio.run(until_told(settings, listening, control))


async def _seen(wire: WebSocket, pictures: Pictures, who: Control) -> None:
    """One browser's pictures, as it asks for them."""
    count = 0
    while True:
        await said_on(wire)
        shown = await pictures.after(count)
        count = shown.count
        about = {"holder": who.holder, "asking": who.asking}
        await wire.send_bytes(packed(shown, about))


@contextmanager
def changing_hands(who: Control, desk: Desk) -> Generator[None]:
    """What is in motion is paused where control changes hands in here."""
    before = who.holder
    yield
    if who.holder != before:
        desk.hand.lets_go()
        desk.wants.put(Request.PAUSE)


async def _operated(
    wire: WebSocket, name: str, who: Control, desk: Desk, board: Board, chosen: Chosen
) -> None:
    """What one browser wants. It is told its name, and what was refused."""
    await wire.send_json({"name": name})
    while True:
        text = await said_on(wire)
        refused = ""
        try:
            with changing_hands(who, desk):
                told = heard(text, name, who, board.poses.targets.get, monotonic_ns())
        except Unheeded as error:
            refused = str(error)
        else:
            if isinstance(told, Change):
                refused = set_box(told, chosen, desk, board)
            elif isinstance(told, Delete):
                refused = board.poses.delete(told.name)
            else:
                refused = "" if done(told, desk) else "the servo does not listen"
        if refused:
            await wire.send_json({"refused": refused})


def done(told: Told | None, desk: Desk) -> bool:
    """Pass on what was told; whether there was room for it."""
    match told:
        case None:
            return True
        case Held():
            desk.hand.holds(told.press, told.rates, told.share)
        case Led():
            desk.hand.holds(told.press, told.velocity, told.share, leads=True)
        case Released():
            desk.hand.lets_go()
        case Wrong():
            return desk.trouble.put(told)
        case Beat():
            desk.hand.beats()
        case _:
            if told is Request.CLEAR:
                desk.bell.put(CLEAR)
            return desk.wants.put(told)
    return True


def set_box(change: Change, chosen: Chosen, desk: Desk, board: Board) -> str:
    """Pass on a change; why it was refused, empty where it was not."""
    try:
        chosen.with_change(change)
    except BadInput as error:
        return str(error)
    if not desk.changes.put(change):
        return "the server does not listen"
    chosen.take(change)
    board.changes += 1
    if change.box in AT_ONCE and board.between is None:
        return "" if desk.wants.put(change) else "the servo does not listen"
    return ""
