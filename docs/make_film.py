"""The README's picture of the operator's page, and a short film of it: headless Chromium before
`rcmservo serve`, with a simulated arm.

python docs/make_film.py        writes page.jpg and page.mp4 beside this file

The film runs as time did: enable, teach, jog away, go back, stop.
"""

import base64
import io
import subprocess
import sys
import tempfile
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from PIL import Image

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "benchmarks")]

from first_use import follow, pressed, served  # noqa: E402
from page_lab import chromium, until  # noqa: E402

RATE, SIZE = 10, (1092, 614)
"""Pictures/s and px of the film."""
SERVE = "-m", "rcmservo", "serve", "--no-browser", "--port", "0", "--seed", "1"


class Camera:
    """Before the browser: what is painted, and when."""

    def __init__(self, page: Any) -> None:
        self._wire = page.context.new_cdp_session(page)
        self._wire.on("Page.screencastFrame", self._keep)
        self.seen: list[tuple[float, str]] = []
        self._wire.send("Page.startScreencast", {"format": "jpeg", "quality": 85})

    def _keep(self, told: dict[str, Any]) -> None:
        self.seen.append((told["metadata"]["timestamp"], told["data"]))
        self._wire.send("Page.screencastFrameAck", {"sessionId": told["sessionId"]})


def film(seen: list[tuple[float, str]], to: Path) -> None:
    """Write what was seen, at an even rate."""
    times = np.array([when for when, _ in seen])
    moments = np.arange(times[0], times[-1], 1.0 / RATE)
    with av.open(str(to), "w") as file:
        stream = file.add_stream("libx264", rate=Fraction(RATE), options={"crf": "27"})
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        for k in np.searchsorted(times, moments, side="right") - 1:
            picture = Image.open(io.BytesIO(base64.b64decode(seen[k][1])))
            frame = av.VideoFrame.from_image(picture.convert("RGB").resize(SIZE, Image.LANCZOS))
            file.mux(stream.encode(frame))
        file.mux(stream.encode())


def main() -> None:
    here = Path(__file__).parent
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        out = "--out", str(folder / "out"), "--poses", str(folder / "poses")
        with served([sys.executable, *SERVE, *out], folder) as address, chromium(address) as page:
            until(page, "rcm.board.ready && rcm.holds")
            camera = Camera(page)
            page.get_by_label("Jog speed").select_option("full")
            follow(page, [("press", "Enable"), ("type", "here"), ("press", "Teach")])
            follow(page, [("hold", "Jog joint 1 plus"), ("hold", "Jog joint 2 minus")])
            follow(page, [("press", "Go here")])
            page.wait_for_timeout(1200)
            page.screenshot(path=here / "page.jpg", type="jpeg", quality=80)
            page.wait_for_timeout(2500)
            pressed(page, "STOP")
            page.wait_for_timeout(1500)
            film(camera.seen, here / "page.mp4")
    subprocess.run(["ls", "-l", here / "page.jpg", here / "page.mp4"], check=True)


if __name__ == "__main__":
    main()
