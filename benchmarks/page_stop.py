"""Time from a click on STOP in the browser until the drive is off.

    python benchmarks/page_stop.py [--count N]

In headless Chromium the keyboard holds a jog button, and the mouse clicks STOP while the joint
moves: N times without a fault (quiet), N times just after a signal stopped the process of the page
for 2 s, and N times just after a signal stopped the servo process permanently. The time runs from
before the click until the first row of the arm's log with the drive off. The watchdog of the arm
also detects a stopped servo. The frames are recorded, so that rendering does not slow the browser.

Requirement: 200 ms for each click. The exit code is 1 if it does not hold.
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

MAX_OFF_TIME_MS = 200.0
BLOCKED_S = 2.0
REST_RATES = np.array([1e-3, 1e-3, 0.1])  # rad/s, rad/s, mm/s below which a joint is at rest
KINDS = ("quiet", "page blocked", "servo stopped")


@dataclass(frozen=True)
class Stopped:
    """Result of one STOP: kind, time (ms) until the drive was off, motion at the click, message."""

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
        time.sleep(max(since + BLOCKED_S - time.monotonic(), 0.0))
        os.kill(struck.value, signal.SIGCONT)
    until(page, f"rcm.board.phase === 'FAULT' && {CLEARS}")
    rows = lab.bench.log.since(count - 1)
    off = int(rows["wall"][np.flatnonzero(rows["enabled"] == 0)[0]])
    return Stopped(kind, (off - clicked) * 1e-6, moving, page.evaluate("rcm.board.words"))


def jogging(page: Page, lab: PageLab, direction: str) -> None:
    """Hold a jog button until the joint moves; press it again on a busy machine."""
    button = page.get_by_role("button", name=f"Jog joint 1 {direction}", exact=True)
    for _ in range(20):
        button.focus()
        page.keyboard.down("Enter")
        with contextlib.suppress(TimeoutError):
            return awaited(lambda: moves(lab), 1.0)
        page.keyboard.up("Enter")
    raise TimeoutError("the joint did not move after 20 attempts")


def middle_of_stop(page: Page) -> tuple[float, float]:
    box = page.get_by_role("button", name="STOP", exact=True).bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def moves(lab: PageLab) -> bool:
    """Return whether a joint moves now."""
    rows = lab.bench.log.since(lab.bench.log.count - 20)
    rates = (rows["q"][-1] - rows["q"][0]) / ((rows["time"][-1] - rows["time"][0]) * 1e-9)
    return bool((np.abs(rates) > 10.0 * REST_RATES).any())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=50)
    chosen = parser.parse_args()
    print(machine(), flush=True)
    found: list[Stopped] = []
    with page_lab(recorded=True) as lab:

        def operator() -> None:
            with chromium(lab.address) as page:
                for turn, kind in itertools.product(range(chosen.count), KINDS):
                    found.append(one := stopped(page, lab, kind, turn))
                    print(f"{turn + 1:3} {kind:<14} {one.off:6.1f} ms", flush=True)
                    if one.off > MAX_OFF_TIME_MS or not one.moving:
                        print(one, flush=True)

        try:
            lab.play(operator)
        finally:
            bad = report(found)
    return 1 if bad or len(found) < len(KINDS) * chosen.count else 0


def report(found: list[Stopped]) -> int:
    """Print the results; return the number of late stops."""
    bad = 0
    for kind in KINDS:
        some = [one for one in found if one.kind == kind]
        if not some:
            continue
        late = sum(one.off > MAX_OFF_TIME_MS for one in some)
        bad += late
        times = spread([one.off for one in some])
        print(f"{kind:<14} {times}   (requirement: {MAX_OFF_TIME_MS:g} ms)")
        heard = sum("STOP was pressed" in one.words for one in some)
        print(
            f"{'':<14} {len(some) - late} of {len(some)} in time, "
            f"{sum(one.moving for one in some)} in motion at the click, {heard} ended by STOP"
        )
    return bad


if __name__ == "__main__":
    sys.exit(main())
