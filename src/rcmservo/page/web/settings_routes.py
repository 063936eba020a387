"""Settings between a browser and the servo: what there is to set, and what was set.

GET /settings   a form for each box, with what is set and what is in force
"""

from typing import Any

from fastapi import Depends, FastAPI

from rcmservo.errors import BadInput
from rcmservo.page.board import Board
from rcmservo.page.desk import Desk
from rcmservo.page.settings import AT_ONCE, Chosen
from rcmservo.page.wants import Change
from rcmservo.page.web.doors import Doors
from rcmservo.page.web.setting_fields import forms


def add_settings(app: FastAPI, doors: Doors, chosen: Chosen, board: Board) -> None:
    """Serve the forms to whoever knows the page's secret."""

    @app.get("/settings", dependencies=[Depends(doors.asked)])
    async def settings() -> list[dict[str, Any]]:  # pyright: ignore[reportUnusedFunction]
        return forms(chosen.servo, board.in_force)


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
