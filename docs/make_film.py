"""Make the picture of the operator's page in docs/page.md, and a short film of it.

Headless Chromium uses `rcmservo serve` with a simulated arm.

python docs/make_film.py        writes page.jpg and page.mp4 next to this file

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
NEAR_TARGET = "rcm.board.phase === 'SERVO' && Math.abs(rcm.board.delta[0]) < 0.03"


class ScreenRecorder:
    """Recorder of the images that the browser draws, with their times."""

    def __init__(self, page: Any) -> None:
        self._session = page.context.new_cdp_session(page)
        self._session.on("Page.screencastFrame", self._store)
        self.frames: list[tuple[float, str]] = []
        self._session.send("Page.startScreencast", {"format": "jpeg", "quality": 85})

    def stop(self) -> list[tuple[float, str]]:
        """Stop, and return times (s) and images (JPEG as base64)."""
        self._session.remove_listener("Page.screencastFrame", self._store)
        self._session.send("Page.stopScreencast")
        return self.frames

    def _store(self, event: dict[str, Any]) -> None:
        self.frames.append((event["metadata"]["timestamp"], event["data"]))
        self._session.send("Page.screencastFrameAck", {"sessionId": event["sessionId"]})


def write_film(frames: list[tuple[float, str]], path: Path) -> None:
    """Write the frames as a film of `RATE` images per second."""
    times = np.array([time for time, _ in frames])
    film_times = np.arange(times[0], times[-1], 1.0 / RATE)
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=Fraction(RATE), options={"crf": "27"})
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        for k in np.searchsorted(times, film_times, side="right") - 1:
            image = Image.open(io.BytesIO(base64.b64decode(frames[k][1])))
            frame = av.VideoFrame.from_image(image.convert("RGB").resize(SIZE, Image.LANCZOS))
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
            until(page, "rcm.hasControl && rcm.board.can.includes('enable')")
            recorder = ScreenRecorder(page)
            page.wait_for_timeout(2000)
            page.get_by_label("Jog speed").select_option("full")
            follow(page, [("press", "Enable"), ("type", "here"), ("press", "Teach")])
            follow(page, [("hold", "Jog joint 1 plus"), ("hold", "Jog joint 2 minus")])
            follow(page, [("press", "Go here")])
            page.wait_for_function(NEAR_TARGET)
            page.screenshot(path=here / "page.jpg", type="jpeg", quality=80)
            page.wait_for_timeout(5000)
            pressed(page, "STOP")
            page.wait_for_timeout(1500)
            write_film(recorder.stop(), here / "page.mp4")
    print(here / "page.jpg", here / "page.mp4")


if __name__ == "__main__":
    main()
