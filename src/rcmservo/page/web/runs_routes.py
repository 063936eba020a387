"""Past runs, for a page that knows the secret. Runs are asked for by the names in the list.

/runs                        the list
/runs/NAME                   one of them, in words and numbers
/runs/NAME/pictures/K        a picture, JPEG
/runs/NAME/figures/FILE      a figure, SVG or PNG
/runs/NAME/record.mcap       the record as it is
"""

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from fastapi import APIRouter, Depends, HTTPException
from starlette.responses import Response, StreamingResponse

from rcmservo.errors import RcmServoError
from rcmservo.page.past_runs.background_worker import Aside
from rcmservo.page.past_runs.run_list import PastRun, Shelf
from rcmservo.page.past_runs.run_view import OpenedRun, figures, opened, picture
from rcmservo.page.web.access import Doors

KEPT = 4
"""Runs, and the figures of runs, that are kept in mind."""
AT_ONCE = 2
"""Records that are downloaded at the same time."""
BLOCK = 1 << 18
"""Bytes of a download at a time."""
KINDS = {"svg": "image/svg+xml", "png": "image/png"}
BUSY = HTTPException(503, "other runs are being read: try again")

Kept = OrderedDict[tuple[Path, int], Any]


class PastRuns:
    """What there is to be asked of past runs."""

    def __init__(self, root: Path) -> None:
        self.shelf, self._aside = Shelf(root), Aside()
        self._opened: Kept = OrderedDict()
        self._figures: Kept = OrderedDict()
        self._downloads = 0

    def place(self, name: str) -> Path:
        """Where a run of the list is."""
        path = self.shelf.place(name)
        if path is None:
            raise HTTPException(404, "there is no such run in the list")
        return path

    async def opened(self, name: str) -> OpenedRun:
        """A run, read."""
        return await self._made(self._opened, opened, self.place(name))

    async def figures(self, name: str) -> dict[str, bytes]:
        """A run's figures, drawn."""
        return await self._made(self._figures, figures, self.place(name))

    async def _made(self, kept: Kept, work: Callable[[Path], Any], path: Path) -> Any:
        """What is made of a record as it is now; what others wait for already is made once."""
        key = path, path.stat().st_mtime_ns
        if key not in kept:
            if self._aside.full:
                raise BUSY
            kept[key] = asyncio.ensure_future(asyncio.to_thread(self._aside.do, work, path))
            while len(kept) > KEPT:
                kept.popitem(last=False)
        try:
            return await asyncio.shield(kept[key])
        except RcmServoError as error:
            kept.pop(key, None)
            raise HTTPException(422, str(error).replace(f"{path.parent}/", "")) from error

    def download(self, path: Path) -> StreamingResponse:
        """A record as long as it is now."""
        if self._downloads >= AT_ONCE:
            raise HTTPException(503, "other records are being downloaded: try again")
        size = path.stat().st_size
        headers = {
            "Content-Disposition": f'attachment; filename="{file_name(path)}.mcap"',
            "Content-Length": str(size),
        }
        kind = "application/octet-stream"
        return StreamingResponse(self._bytes(path, size), headers=headers, media_type=kind)

    def _bytes(self, path: Path, size: int) -> Iterator[bytes]:
        self._downloads += 1
        try:
            with path.open("rb") as file:
                while size > 0 and (block := file.read(min(BLOCK, size))):
                    size -= len(block)
                    yield block
        finally:
            self._downloads -= 1


def file_name(path: Path) -> str:
    """What a download of a record is called: of plain letters only."""
    folders = "-".join(path.parent.parts[-2:])
    return "".join(c if c.isascii() and (c.isalnum() or c in "-_.") else "_" for c in folders)


def runs_routes(doors: Doors, folder: Path) -> APIRouter:
    """Return the routes that read the past runs below a folder."""
    runs = PastRuns(folder)
    router = APIRouter(prefix="/runs", dependencies=[Depends(doors.asked)])

    async def listed() -> list[PastRun]:
        return await asyncio.to_thread(runs.shelf.listed)

    async def one(name: str) -> Response:
        return Response((await runs.opened(name)).told, media_type="application/json")

    async def shown(name: str, k: int) -> Response:
        where = (await runs.opened(name)).pictures
        if not 0 <= k < len(where):
            raise HTTPException(
                404, f"there is no picture {k}: a number from 0 to {len(where) - 1}"
            )
        try:
            jpeg = await asyncio.to_thread(picture, runs.place(name), where[k])
        except RcmServoError as error:
            raise HTTPException(422, "the picture cannot be read") from error
        return Response(jpeg, media_type="image/jpeg")

    async def figure(name: str, file: str) -> Response:
        drawn = (await runs.figures(name)).get(file)
        if drawn is None:
            raise HTTPException(404, "there is no such figure of this run")
        called = f"{file_name(runs.place(name))}-{file}"
        headers = {"Content-Disposition": f'inline; filename="{called}"'}
        return Response(drawn, media_type=KINDS[file.rpartition(".")[2]], headers=headers)

    async def record(name: str) -> Response:
        return runs.download(runs.place(name))

    for path, answer in (
        ("", listed),
        ("/{name}", one),
        ("/{name}/pictures/{k}", shown),
        ("/{name}/figures/{file}", figure),
        ("/{name}/record.mcap", record),
    ):
        router.add_api_route(path, answer, response_model=None)
    return router
