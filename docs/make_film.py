"""Make the README's picture of the operator's page, and a short film of it.

Headless Chromium uses `rcmservo serve` with a simulated arm.

python docs/make_film.py        writes page.jpg and page.mp4 beside this file

MP4 is written by PyAV, which nothing else needs: `pip install -e '.[dev,mp4]'` installs it.

The film plays in real time: enable, teach, jog away, servo back, stop. The gain is an eighth of the
default, so that the motion can be seen. The camera has half its default frame rate, because the
browser draws on the same processors.
"""

import base64
import io
import os
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

RATE, SIZE = 10, (1092, 720)
"""Pictures/s and px of the film."""
SERVE = ["-m", "rcmservo", "serve", "--no-browser", "--port", "0", "--seed", "1"]
SERVE += ["--controller.gain", "1", "--teaching-frames", "30"]
RIG = "[camera]\nframe_rate = 30.0\n"
ON_THE_WAY = "rcm.board.phase === 'SERVO' && Math.abs(rcm.board.delta[0]) < 0.03"


class Camera:
    """Before the browser: what is painted, and when."""

    def __init__(self, page: Any) -> None:
        self._wire = page.context.new_cdp_session(page)
        self._wire.on("Page.screencastFrame", self._keep)
        self.seen: list[tuple[float, str]] = []
        self._wire.send("Page.startScreencast", {"format": "jpeg", "quality": 85})

    def end(self) -> list[tuple[float, str]]:
        """Stop, and return the frames with their times."""
        self._wire.remove_listener("Page.screencastFrame", self._keep)
        self._wire.send("Page.stopScreencast")
        return self.seen

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
        (rig := folder / "rig.toml").write_text(RIG)
        command = [sys.executable, *SERVE, *out, "--rig", str(rig)]
        with served(command, ROOT, dict(os.environ)) as address, chromium(address) as page:
            page.set_viewport_size({"width": 1366, "height": 900})
            until(page, "rcm.holds && rcm.board.can.includes('enable')")
            camera = Camera(page)
            page.wait_for_timeout(2000)
            page.get_by_label("Jog speed").select_option("full")
            follow(page, [("press", "Enable"), ("type", "here"), ("press", "Teach")])
            follow(page, [("hold", "Jog joint 1 plus"), ("hold", "Jog joint 2 minus")])
            follow(page, [("press", "Go here")])
            page.wait_for_function(ON_THE_WAY)
            page.screenshot(path=here / "page.jpg", type="jpeg", quality=80)
            page.wait_for_timeout(5000)
            pressed(page, "STOP")
            page.wait_for_timeout(1500)
            film(camera.end(), here / "page.mp4")
    print(here / "page.jpg", here / "page.mp4")


if __name__ == "__main__":
    main()
