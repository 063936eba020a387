"""The curves' numbers, for a browser that shows them and asks for those it does not have."""

from typing import Any

import numpy as np
from fastapi import Depends, FastAPI

from rcmservo.page.board import Board, plain
from rcmservo.page.seen.curves import NAMES
from rcmservo.page.web.doors import Doors


def add_curves(app: FastAPI, doors: Doors, board: Board) -> None:
    """Have them answered for."""

    @app.get("/curves", dependencies=[Depends(doors.asked)])
    async def curves(after: int = 0) -> dict[str, Any]:  # pyright: ignore[reportUnusedFunction]
        samples = [plain(np.array(one)) for one in board.curves.after(after)]
        return {"count": board.curves.count, "names": NAMES, "samples": samples}
