"""HTTP routes of past runs, for requests with the page's secret.

NAME is the name of a run in the list, K the number of a picture, FILE the name of a figure's file.

/runs                        list
/runs/NAME                   content of a run in words and numbers
/runs/NAME/pictures/K        picture, JPEG
/runs/NAME/figures/FILE      figure, SVG or PNG
/runs/NAME/record.mcap       record
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
from rcmservo.page.web.access import PageCredentials

MAX_CACHED_RUNS = 4
"""Number of opened runs that are cached, and of drawn sets of figures."""
MAX_DOWNLOADS = 2
"""Number of simultaneous downloads of records."""
DOWNLOAD_BLOCK_BYTES = 1 << 18
"""Block size of a download in bytes."""
MEDIA_TYPES = {"svg": "image/svg+xml", "png": "image/png"}
"""Media types of figures, by the suffix of their files."""

Cache = OrderedDict[tuple[Any, ...], Any]
"""Futures of results, by the path of a record, the time (ns) of its last change, and arguments."""


class PastRuns:
    """Past runs below a folder, with a cache of the newest requests."""

    def __init__(self, root: Path) -> None:
        self.run_list, self._worker = RunList(root), BackgroundWorker()
        self._opened: Cache = OrderedDict()
        self._figures: Cache = OrderedDict()
        self._downloads = 0

    def find_record(self, name: str) -> Path:
        """Return the record of a listed run; error 404 if there is none."""
        path = self.run_list.find_record(name)
        if path is None:
            raise HTTPException(404, "there is no such run in the list")
        return path

    async def open_run(self, name: str) -> OpenedRun:
        """Return the content of a run."""
        return await self._read_cached(self._opened, open_run, self.find_record(name))

    async def draw_figures(self, name: str, kind: str) -> dict[str, bytes]:
        """Return the figures of a run as files of one kind.

        The page shows the SVG files; PNG files are drawn when one is downloaded.
        """
        return await self._read_cached(self._figures, draw_figures, self.find_record(name), kind)

    async def _read_cached(
        self, cache: Cache, function: Callable[..., Any], path: Path, *arguments: Any
    ) -> Any:
        """Return the result of a function of a record from the cache, or call the function.

        Simultaneous requests call it once.
        """
        key = path, path.stat().st_mtime_ns, *arguments
        if key not in cache:
            if self._worker.is_full:
                raise HTTPException(503, "other runs are being read: try again")
            call = asyncio.to_thread(self._worker.run, function, path, *arguments)
            cache[key] = asyncio.ensure_future(call)
            while len(cache) > MAX_CACHED_RUNS:
                cache.popitem(last=False)
        try:
            return await asyncio.shield(cache[key])
        except RcmServoError as error:
            cache.pop(key, None)
            raise HTTPException(422, str(error).replace(f"{path.parent}/", "")) from error

    def download(self, path: Path) -> StreamingResponse:
        """Return a response with a record at its present length."""
        if self._downloads >= MAX_DOWNLOADS:
            raise HTTPException(503, "other records are being downloaded: try again")
        size = path.stat().st_size
        headers = {
            "Content-Disposition": f'attachment; filename="{make_download_name(path)}.mcap"',
            "Content-Length": str(size),
        }
        blocks, media_type = self._read_blocks(path, size), "application/octet-stream"
        return StreamingResponse(blocks, headers=headers, media_type=media_type)

    def _read_blocks(self, path: Path, size: int) -> Iterator[bytes]:
        """Yield the first `size` bytes of a file in blocks."""
        self._downloads += 1
        try:
            with path.open("rb") as file:
                while size > 0 and (block := file.read(min(DOWNLOAD_BLOCK_BYTES, size))):
                    size -= len(block)
                    yield block
        finally:
            self._downloads -= 1


def make_download_name(path: Path) -> str:
    """Return the name of a downloaded record, of ASCII letters, digits, "-", "_" and "."."""
    folders = "-".join(path.parent.parts[-2:])
    return "".join(c if c.isascii() and (c.isalnum() or c in "-_.") else "_" for c in folders)


def create_runs_routes(access: PageCredentials, folder: Path) -> APIRouter:
    """Return the routes that read the past runs below a folder."""
    runs = PastRuns(folder)
    router = APIRouter(prefix="/runs", dependencies=[Depends(access.require_secret)])

    async def list_runs() -> list[PastRun]:
        return await asyncio.to_thread(runs.run_list.list_runs)

    async def get_run(name: str) -> Response:
        return Response((await runs.open_run(name)).json, media_type="application/json")

    async def get_picture(name: str, k: int) -> Response:
        locations = (await runs.open_run(name)).pictures
        if not 0 <= k < len(locations):
            raise HTTPException(404, f"no picture {k}; expected 0 to {len(locations) - 1}")
        try:
            jpeg = await asyncio.to_thread(read_picture, runs.find_record(name), locations[k])
        except RcmServoError as error:
            raise HTTPException(422, "the picture cannot be read") from error
        return Response(jpeg, media_type="image/jpeg")

    async def get_figure(name: str, file: str) -> Response:
        figure, _, kind = file.rpartition(".")
        files = await runs.draw_figures(name, kind) if kind in MEDIA_TYPES else {}
        if figure not in files:
            raise HTTPException(404, "there is no such figure of this run")
        download_name = f"{make_download_name(runs.find_record(name))}-{file}"
        headers = {"Content-Disposition": f'inline; filename="{download_name}"'}
        return Response(files[figure], media_type=MEDIA_TYPES[kind], headers=headers)

    async def get_record(name: str) -> Response:
        return runs.download(runs.find_record(name))

    router.add_api_route("", list_runs, response_model=None)
    router.add_api_route("/{name}", get_run, response_model=None)
    router.add_api_route("/{name}/pictures/{k}", get_picture, response_model=None)
    router.add_api_route("/{name}/figures/{file}", get_figure, response_model=None)
    router.add_api_route("/{name}/record.mcap", get_record, response_model=None)
    return router
