"""Picture rate of the page and latency from the camera to the drawn picture, in headless Chromium.

    python benchmarks/page_drawn.py [--seconds N]

Recorded frames arrive 60 times per second and are tracked; the loop runs at 100 Hz with the drive
on, paused. The latency runs from the arrival of a frame until the page has drawn it with its
overlays. The offset between the clocks of browser and Python is that of the fastest of many
queries. The latency of a screen is not included.

Requirements: 20 pictures/s, and a median latency of 80 ms. The exit code is 1 if one does not hold.
"""

import argparse
import sys
import time
from typing import Any

import numpy as np
from page_lab import NUMBERS, chromium, enabled, machine, page_lab, spread
from playwright.sync_api import Page

MIN_RATE, MAX_LATENCY_MS = 20.0, 80.0  # 1/s, ms
NOTED = """() => {
  // each decoded picture has its frame number; a drawn one is recorded when the page counts it
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
    """Return the offset (ms) from the browser's clock to Python's, and its uncertainty (ms)."""
    best = np.inf, 0.0
    for _ in range(200):
        start = time.monotonic() * 1e3
        browser = page.evaluate("performance.now()")
        took = time.monotonic() * 1e3 - start
        best = min(best, (took, start + took / 2 - browser))
    return best[1], best[0] / 2


def drawn(page: Page, seconds: float) -> list[Any]:
    """Return the drawn frames with the browser's times (ms)."""
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

        def operator() -> None:
            with chromium(lab.address) as page:
                enabled(page)
                before = offset(page)
                found["noted"] = drawn(page, chosen.seconds)
                found["phase"] = page.evaluate("rcm.board.phase")
                found["offsets"] = before, offset(page)

        lab.play(operator)
        arrivals = np.array(lab.arrivals) * 1e-6
    noted, ((ahead, sure), (after, _)) = np.array(found["noted"]), found["offsets"]
    times = noted[:, 1]
    took = times + (ahead + after) / 2 - arrivals[noted[:, 0].astype(int) % NUMBERS]
    rate = (len(times) - 1) / (times[-1] - times[0]) * 1e3
    print(f"{len(times)} pictures, the drive on and {found['phase']}")
    print(f"clocks: uncertainty {sure:.2f} ms, drift {after - ahead:.2f} ms")
    print(f"{'drawn':<16} {rate:6.1f} pictures/s   (requirement: {MIN_RATE:g})")
    longest = np.diff(times).max()
    print(f"{'longest gap':<16} {longest:6.1f} ms")
    print(f"{'camera to drawn':<16} {spread(took)}   (requirement: median {MAX_LATENCY_MS:g} ms)")
    is_slow = rate < MIN_RATE or np.median(took) > MAX_LATENCY_MS
    return 1 if is_slow or found["phase"] != "PAUSED" else 0


if __name__ == "__main__":
    sys.exit(main())
