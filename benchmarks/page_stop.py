"""STOP by a click in the browser: how soon is the drive off?

    python benchmarks/page_stop.py [--count N]

In headless Chromium a jog button is held down by the keyboard, and STOP clicked by the mouse while
the joint moves: N times as all is well (quiet), N times just after the page's process was stopped
for 2 s by a signal, N times just after the servo's was for good. The time runs from before the
click is handed to the browser until the first row of the arm's own log in which the drive is off.
A stopped servo is also noticed by the arm's watchdog, which switches off by itself. The frames are
recorded ones, so that the simulated camera takes nothing from the browser.

Bar: 200 ms, every time. Exit code 1 where it is missed.
"""

import argparse
import contextlib
import itertools
import os
import signal
import sys
import time
from dataclasses import dataclass

import numpy as np
from page_lab import CLEARS, PageLab, awaited, chromium, enabled, machine, page_lab, spread, until
from playwright.sync_api import Page

BAR = 200.0  # ms
BLOCKED = 2.0  # s
STILL = np.array([1e-3, 1e-3, 0.1])  # rad/s, rad/s, mm/s below which a joint stands still
KINDS = ("quiet", "page blocked", "servo stopped")


@dataclass(frozen=True)
class Stopped:
    """One STOP: what was struck, ms from the click until the drive was off, whether the arm moved
    at the click, and what the page then said.
    """

    kind: str
    off: float
    moving: bool
    words: str


def stopped(page: Page, lab: PageLab, kind: str, turn: int) -> Stopped:
    enabled(page)
    x, y = middle_of_stop(page)
    page.mouse.move(x, y)
    jogging(page, lab, ("plus", "minus")[turn % 2])
    struck = lab.page if kind == "page blocked" else lab.servo
    if kind != "quiet":
        os.kill(struck.value, signal.SIGSTOP)
    since = time.monotonic()
    moving, count = moves(lab), lab.bench.log.count
    clicked = time.monotonic_ns()
    page.mouse.down()
    awaited(lambda: not lab.bench.log.last()["enabled"])
    page.mouse.up()
    page.keyboard.up("Enter")
    if kind == "page blocked":
        time.sleep(max(since + BLOCKED - time.monotonic(), 0.0))
        os.kill(struck.value, signal.SIGCONT)
    until(page, f"rcm.board.phase === 'FAULT' && {CLEARS}")
    rows = lab.bench.log.since(count - 1)
    off = int(rows["wall"][np.flatnonzero(rows["enabled"] == 0)[0]])
    return Stopped(kind, (off - clicked) * 1e-6, moving, page.evaluate("rcm.board.words"))


def jogging(page: Page, lab: PageLab, way: str) -> None:
    """Hold a jog button down until the joint moves; on a machine that is busy, press it anew."""
    button = page.get_by_role("button", name=f"Jog joint 1 {way}", exact=True)
    for _ in range(20):
        button.focus()
        page.keyboard.down("Enter")
        with contextlib.suppress(TimeoutError):
            return awaited(lambda: moves(lab), 1.0)
        page.keyboard.up("Enter")
    raise TimeoutError("the joint does not move")


def middle_of_stop(page: Page) -> tuple[float, float]:
    box = page.get_by_role("button", name="STOP", exact=True).bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def moves(lab: PageLab) -> bool:
    """Whether a joint moves now."""
    rows = lab.bench.log.since(lab.bench.log.count - 20)
    rates = (rows["q"][-1] - rows["q"][0]) / ((rows["time"][-1] - rows["time"][0]) * 1e-9)
    return bool((np.abs(rates) > 10.0 * STILL).any())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=50)
    chosen = parser.parse_args()
    print(machine(), flush=True)
    found: list[Stopped] = []
    with page_lab(recorded=True) as lab:

        def person() -> None:
            with chromium(lab.address) as page:
                for turn, kind in itertools.product(range(chosen.count), KINDS):
                    found.append(one := stopped(page, lab, kind, turn))
                    print(f"{turn + 1:3} {kind:<14} {one.off:6.1f} ms", flush=True)
                    if one.off > BAR or not one.moving:
                        print(one, flush=True)

        try:
            lab.play(person)
        finally:
            bad = told(found)
    return 1 if bad or len(found) < len(KINDS) * chosen.count else 0


def told(found: list[Stopped]) -> int:
    """Tell of what was found; how many were late."""
    bad = 0
    for kind in KINDS:
        some = [one for one in found if one.kind == kind]
        if not some:
            continue
        late = sum(one.off > BAR for one in some)
        bad += late
        print(f"{kind:<14} {spread([one.off for one in some])}   (bar: {BAR:g} ms)")
        heard = sum("STOP was pressed" in one.words for one in some)
        print(
            f"{'':<14} {len(some) - late} of {len(some)} in time, moving at the click "
            f"{sum(one.moving for one in some)}, {heard} ended by STOP"
        )
    return bad


if __name__ == "__main__":
    sys.exit(main())
