"""Process of the page: NiceGUI's page and the websockets of its pictures and requests.

/pictures   the browser requests the next picture and receives it with the dashboard
/operate    the browser sends requests and receives the reasons of refusals
"""

import asyncio
import socket
from collections.abc import Generator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from time import monotonic_ns

from fastapi import FastAPI
from nicegui import app as pages
from nicegui import ui
from starlette.websockets import WebSocket, WebSocketDisconnect

from rcmservo.errors import BadInput
from rcmservo.page.channels import PageChannels
from rcmservo.page.control_ownership import ControlOwnership, MessageRefused, interpret_message
from rcmservo.page.messages import (
    CLEAR,
    BrowserMessage,
    DeletePose,
    DisturbanceRequest,
    Heartbeat,
    JogJoints,
    JogMarker,
    ReleaseJog,
    SettingsChange,
)
from rcmservo.page.poses import PoseStore
from rcmservo.page.selected_settings import IMMEDIATE_PARTS, SelectedSettings
from rcmservo.page.view_model import Dashboard
from rcmservo.page.web.access import receive_text
from rcmservo.page.web.dashboard_routes import create_dashboard_routes
from rcmservo.page.web.layout import lay_out
from rcmservo.page.web.origin_check import OriginCheck
from rcmservo.page.web.pictures import Pictures, pack_picture
from rcmservo.page.web.runs_routes import create_runs_routes
from rcmservo.page.web.server_process import serve_until_stopped
from rcmservo.page.web.sign_in import SignIn
from rcmservo.page.web.site import Site
from rcmservo.safety.state_machine import Request

SERVO_BUSY = "the servo does not accept requests now: press again"
MAX_WEBSOCKET_BYTES = 1 << 16
"""Longest message in bytes that the server accepts from a browser."""


def serve_page(
    channels: PageChannels, site: Site, listener: socket.socket, control: Connection
) -> None:
    """Serve the page until the other end of `control` sends a message or is closed."""
    poses = PoseStore(site.poses)
    poses.load()
    board = Dashboard(channels, poses, shape=site.shape, truth=site.truth)
    ownership, access = ControlOwnership(), site.access
    pictures = Pictures(site.camera(), board)
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    sign_in = SignIn(access.token, access.port) if access.token else None
    app.add_middleware(OriginCheck, port=access.port, sign_in=sign_in)

    @app.websocket("/pictures")
    async def send_pictures(websocket: WebSocket) -> None:  # pyright: ignore[reportUnusedFunction]
        if await access.accept(websocket):
            with suppress(WebSocketDisconnect):
                await _send_pictures(websocket, pictures, ownership)

    @app.websocket("/operate")
    async def receive_messages(websocket: WebSocket) -> None:  # pyright: ignore[reportUnusedFunction]
        if not await access.accept(websocket):
            return
        name = ownership.join(monotonic_ns())
        try:
            with suppress(WebSocketDisconnect):
                await _receive_messages(websocket, name, ownership, channels, board, site.selection)
        finally:
            with pause_on_handover(ownership, channels):
                ownership.leave(name, monotonic_ns())

    app.include_router(create_dashboard_routes(access, board, site.selection))
    app.include_router(create_runs_routes(access, site.runs))
    lay_out(site)
    ui.run_with(
        app, title=site.title, dark=None, show_welcome_message=False, reconnect_timeout=10.0
    )
    pages.on_startup(pictures.pump)
    # Pictures are sent uncompressed, because compression makes a JPEG no smaller.
    options = {"ws_max_size": MAX_WEBSOCKET_BYTES, "ws_per_message_deflate": False}
    asyncio.run(serve_until_stopped(app, listener, control, **options))


async def _send_pictures(
    websocket: WebSocket, pictures: Pictures, ownership: ControlOwnership
) -> None:
    """Send pictures to one browser, each on request."""
    count = 0
    while True:
        await receive_text(websocket)
        picture = await pictures.after(count)
        count = picture.count
        owners = {"holder": ownership.holder, "requester": ownership.requester}
        await websocket.send_bytes(pack_picture(picture, owners))


@contextmanager
def pause_on_handover(ownership: ControlOwnership, channels: PageChannels) -> Generator[None]:
    """Pause the motion if control changes hands inside the block."""
    previous_holder = ownership.holder
    yield
    if ownership.holder != previous_holder:
        channels.jog_state.release()
        channels.requests.send(Request.PAUSE)


async def _receive_messages(
    websocket: WebSocket,
    name: str,
    ownership: ControlOwnership,
    channels: PageChannels,
    board: Dashboard,
    selection: SelectedSettings,
) -> None:
    """Receive the requests of one browser; send its name and the reasons of refusals."""
    await websocket.send_json({"name": name})
    while True:
        text = await receive_text(websocket)
        refusal, find_pose = "", board.poses.targets.get
        try:
            with pause_on_handover(ownership, channels):
                message = interpret_message(text, name, ownership, find_pose, monotonic_ns())
        except MessageRefused as error:
            refusal = str(error)
        else:
            if isinstance(message, SettingsChange):
                refusal = change_settings(message, selection, channels, board)
            elif isinstance(message, DeletePose):
                refusal = board.poses.delete(message.name)
            elif not dispatch(message, channels):
                refusal = SERVO_BUSY
        if refusal:
            await websocket.send_json({"refused": refusal})


def dispatch(message: BrowserMessage | None, channels: PageChannels) -> bool:
    """Send a request to the process that carries it out. Return False if its channel is full."""
    jog_state = channels.jog_state
    match message:
        case None:
            return True
        case JogJoints():
            jog_state.hold(message.press, message.rates, message.speed_scale)
        case JogMarker():
            jog_state.hold(message.press, message.velocity, message.speed_scale, moves_marker=True)
        case ReleaseJog():
            jog_state.release()
        case DisturbanceRequest():
            return channels.disturbances.send(message)
        case Heartbeat():
            jog_state.send_heartbeat()
        case _:
            if message is Request.CLEAR:
                channels.stop_requests.send(CLEAR)
            return channels.requests.send(message)
    return True


def change_settings(
    change: SettingsChange, selection: SelectedSettings, channels: PageChannels, board: Dashboard
) -> str:
    """Send a change of settings to supervisor and servo. Return the reason of a refusal, or ""."""
    try:
        selection.with_change(change)
    except BadInput as error:
        return str(error)
    if not channels.settings_changes.send(change):
        return "the server does not accept settings now: press again"
    selection.apply(change)
    board.settings_version += 1
    acts_now = change.part in IMMEDIATE_PARTS and board.standby is None
    return SERVO_BUSY if acts_now and not channels.requests.send(change) else ""
