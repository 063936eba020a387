"""Does the page show what happens: pictures drawn per second, and the time from the camera to the
picture drawn, in headless Chromium.

    python benchmarks/page_drawn.py [--seconds N]

Recorded frames come 60 times a second, and are tracked; the loop runs at 100 Hz with the drive on,
paused. A picture counts as drawn once the page has painted it with its overlays. The time runs from
the frame's arrival in this computer until then; the browser's clock is compared with Python's, with
the shortest of many questions. What a screen adds is not in it.

Bars: 20 pictures/s, 80 ms in the median. Exit code 1 where one is missed.
"""

import argparse
import sys
import time
from typing import Any

import numpy as np
from page_lab import NUMBERS, chromium, enabled, machine, page_lab, spread
from playwright.sync_api import Page

RATE, BAR = 20.0, 80.0  # 1/s, ms
NOTED = """() => {
  // each decoded picture knows its frame; what is drawn is noted when the page counts it
  const decode = window.createImageBitmap.bind(window), count = rcm.drawn;
  const paint = CanvasRenderingContext2D.prototype.drawImage;
  let painted = -1, drawn = count;
  window.noted = [];
  window.createImageBitmap = async (...given) => {
    const frame = rcm.board.frame, image = await decode(...given);
    image.frame = frame;
    return image;
  };
  CanvasRenderingContext2D.prototype.drawImage = function (image, ...where) {
    if (image.frame !== undefined && this.canvas.id === "picture") painted = image.frame;
    return paint.call(this, image, ...where);
  };
  Object.defineProperty(rcm, "drawn", {
    get: () => drawn,
    set: (to) => { drawn = to; window.noted.push([painted, performance.now()]); },
  });
}"""


def offset(page: Page) -> tuple[float, float]:
    """What to add to the browser's clock to have Python's, ms, and how sure that is."""
    best = np.inf, 0.0
    for _ in range(200):
        asked = time.monotonic() * 1e3
        told = page.evaluate("performance.now()")
        took = time.monotonic() * 1e3 - asked
        best = min(best, (took, asked + took / 2 - told))
    return best[1], best[0] / 2


def drawn(page: Page, seconds: float) -> list[Any]:
    """Frames and the browser's times (ms) at which they were drawn."""
    page.evaluate(NOTED)
    page.wait_for_timeout(1e3 * seconds)
    return page.evaluate("window.noted.filter(([frame]) => frame >= 0)")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=30.0)
    chosen = parser.parse_args()
    print(machine(), flush=True)
    found: dict[str, Any] = {}
    with page_lab(recorded=True) as lab:

        def person() -> None:
            with chromium(lab.address) as page:
                enabled(page)
                before = offset(page)
                found["noted"] = drawn(page, chosen.seconds)
                found["phase"] = page.evaluate("rcm.board.phase")
                found["offsets"] = before, offset(page)

        lab.play(person)
        arrivals = np.array(lab.arrivals) * 1e-6
    noted, ((ahead, sure), (after, _)) = np.array(found["noted"]), found["offsets"]
    times = noted[:, 1]
    took = times + (ahead + after) / 2 - arrivals[noted[:, 0].astype(int) % NUMBERS]
    rate = (len(times) - 1) / (times[-1] - times[0]) * 1e3
    print(f"{len(times)} pictures, the drive on and {found['phase']}")
    print(f"the clocks agree within {sure:.2f} ms, and went apart by {after - ahead:.2f} ms")
    print(f"{'drawn':<16} {rate:6.1f} pictures/s   (bar: {RATE:g})")
    longest = np.diff(times).max()
    print(f"{'longest without':<16} {longest:6.1f} ms")
    print(f"{'camera to drawn':<16} {spread(took)}   (bar: {BAR:g} ms in the median)")
    return 1 if rate < RATE or np.median(took) > BAR or found["phase"] != "PAUSED" else 0


if __name__ == "__main__":
    sys.exit(main())
