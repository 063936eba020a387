"""`rcmservo serve --host 0.0.0.0 --token-file`: a remote browser signs in once."""

import contextlib
import json
import re
import urllib.error
import urllib.parse
import urllib.request
from http.cookiejar import CookieJar
from pathlib import Path

import pytest
from page_server import serve_page
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

pytestmark = pytest.mark.slow


def test_a_remote_browser_signs_in_and_gets_pictures_and_stop(tmp_path: Path) -> None:
    file = tmp_path / "token"
    with serve_page(tmp_path / "out", "--host", "0.0.0.0", "--token-file", str(file)) as address:
        jar = CookieJar()
        browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor(jar))
        with pytest.raises(urllib.error.HTTPError, match="401"):
            browser.open(address)
        form = urllib.parse.urlencode({"token": file.read_text().strip()}).encode()
        page = re.search(
            r"window\.RCMSERVO = (\{.*?\});", browser.open(address, form).read().decode()
        )
        assert page is not None
        site, port = json.loads(page[1]), int(address.rpartition(":")[2])
        cookie = {"Cookie": "; ".join(f"{one.name}={one.value}" for one in jar)}

        def opened(path: str, port: int, headers: dict[str, str]) -> str | bytes:
            url = f"ws://{urllib.parse.urlsplit(address).hostname}:{port}{path}"
            with connect(
                f"{url}?secret={site['secret']}", origin=Origin(address), additional_headers=headers
            ) as websocket:
                websocket.send("next")
                return websocket.recv(20.0)

        assert opened("/stop", site["stopPort"], {}) == "heard"
        assert len(opened("/pictures", port, cookie)) > 1000
        with pytest.raises(InvalidStatus, match="403"):
            opened("/pictures", port, {})
        for path in ("/rcmservo/stop.js", "/_nicegui_ws/socket.io/?EIO=4&transport=polling"):
            with pytest.raises(urllib.error.HTTPError, match="401"):
                urllib.request.urlopen(address + path)
            with contextlib.closing(browser.open(address + path)) as got:
                assert got.status == 200
