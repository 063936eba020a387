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
from rcmservo.page.past_runs.background_worker import BackgroundWorker
from rcmservo.page.past_runs.run_list import PastRun, RunList
from rcmservo.page.past_runs.run_view import OpenedRun, draw_figures, open_run, read_picture
from rcmservo.page.web.access import Doors

MAX_CACHED_RUNS = 4
"""Runs, and the figures of runs, that are kept in mind."""
MAX_DOWNLOADS = 2
"""Records that are downloaded at the same time."""
DOWNLOAD_BLOCK_BYTES = 1 << 18
"""Bytes of a download at a time."""
MEDIA_TYPES = {"svg": "image/svg+xml", "png": "image/png"}
BUSY = HTTPException(503, "other runs are being read: try again")

Cache = OrderedDict[tuple[Path, int], Any]


class PastRuns:
    """What there is to be asked of past runs."""

    def __init__(self, root: Path) -> None:
        self.run_list, self._worker = RunList(root), BackgroundWorker()
        self._opened: Cache = OrderedDict()
        self._figures: Cache = OrderedDict()
        self._downloads = 0

    def find_record(self, name: str) -> Path:
        """Where a run of the list is."""
        path = self.run_list.find_record(name)
        if path is None:
            raise HTTPException(404, "there is no such run in the list")
        return path

    async def open_run(self, name: str) -> OpenedRun:
        """A run, read."""
        return await self._cached(self._opened, open_run, self.find_record(name))

    async def draw_figures(self, name: str) -> dict[str, bytes]:
        """A run's figures, drawn."""
        return await self._cached(self._figures, draw_figures, self.find_record(name))

    async def _cached(self, cache: Cache, work: Callable[[Path], Any], path: Path) -> Any:
        """What is made of a record as it is now; what others wait for already is made once."""
        key = path, path.stat().st_mtime_ns
        if key not in cache:
            if self._worker.is_full:
                raise BUSY
            cache[key] = asyncio.ensure_future(asyncio.to_thread(self._worker.run, work, path))
            while len(cache) > MAX_CACHED_RUNS:
                cache.popitem(last=False)
        try:
            return await asyncio.shield(cache[key])
        except RcmServoError as error:
            cache.pop(key, None)
            raise HTTPException(422, str(error).replace(f"{path.parent}/", "")) from error

    def download(self, path: Path) -> StreamingResponse:
        """A record as long as it is now."""
        if self._downloads >= MAX_DOWNLOADS:
            raise HTTPException(503, "other records are being downloaded: try again")
        size = path.stat().st_size
        headers = {
            "Content-Disposition": f'attachment; filename="{download_name(path)}.mcap"',
            "Content-Length": str(size),
        }
        kind = "application/octet-stream"
        return StreamingResponse(self._read_blocks(path, size), headers=headers, media_type=kind)

    def _read_blocks(self, path: Path, size: int) -> Iterator[bytes]:
        self._downloads += 1
        try:
            with path.open("rb") as file:
                while size > 0 and (block := file.read(min(DOWNLOAD_BLOCK_BYTES, size))):
                    size -= len(block)
                    yield block
        finally:
            self._downloads -= 1


def download_name(path: Path) -> str:
    """What a download of a record is called: of plain letters only."""
    folders = "-".join(path.parent.parts[-2:])
    return "".join(c if c.isascii() and (c.isalnum() or c in "-_.") else "_" for c in folders)


def runs_routes(access: Doors, folder: Path) -> APIRouter:
    """Return the routes that read the past runs below a folder."""
    runs = PastRuns(folder)
    router = APIRouter(prefix="/runs", dependencies=[Depends(access.require_secret)])

    async def list_runs() -> list[PastRun]:
        return await asyncio.to_thread(runs.run_list.list_runs)

    async def get_run(name: str) -> Response:
        return Response((await runs.open_run(name)).json, media_type="application/json")

    async def get_picture(name: str, k: int) -> Response:
        where = (await runs.open_run(name)).pictures
        if not 0 <= k < len(where):
            raise HTTPException(
                404, f"there is no picture {k}: a number from 0 to {len(where) - 1}"
            )
        try:
            jpeg = await asyncio.to_thread(read_picture, runs.find_record(name), where[k])
        except RcmServoError as error:
            raise HTTPException(422, "the picture cannot be read") from error
        return Response(jpeg, media_type="image/jpeg")

    async def get_figure(name: str, file: str) -> Response:
        drawn = (await runs.draw_figures(name)).get(file)
        if drawn is None:
            raise HTTPException(404, "there is no such figure of this run")
        called = f"{download_name(runs.find_record(name))}-{file}"
        headers = {"Content-Disposition": f'inline; filename="{called}"'}
        return Response(drawn, media_type=MEDIA_TYPES[file.rpartition(".")[2]], headers=headers)

    async def get_record(name: str) -> Response:
        return runs.download(runs.find_record(name))

    for path, answer in (
        ("", list_runs),
        ("/{name}", get_run),
        ("/{name}/pictures/{k}", get_picture),
        ("/{name}/figures/{file}", get_figure),
        ("/{name}/record.mcap", get_record),
    ):
        router.add_api_route(path, answer, response_model=None)
    return router
