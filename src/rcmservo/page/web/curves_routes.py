"""The curves' numbers, for a browser that shows them and asks for those it does not have."""

from typing import Any

import numpy as np
from fastapi import FastAPI, HTTPException

from rcmservo.page.board import Board, plain
from rcmservo.page.seen.curves import NAMES
from rcmservo.page.web.doors import Doors


def add_curves(app: FastAPI, doors: Doors, board: Board) -> None:
    """Have them answered for."""

    @app.get("/curves")
    async def curves(  # pyright: ignore[reportUnusedFunction]
        secret: str = "", after: int = 0
    ) -> dict[str, Any]:
        if not doors.knows(secret):
            raise HTTPException(403, "the page's secret is missing: open the page anew")
        samples = [plain(np.array(one)) for one in board.curves.after(after)]
        return {"count": board.curves.count, "names": NAMES, "samples": samples}
