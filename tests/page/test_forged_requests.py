"""Forged requests move and change nothing, and random ones stop neither loop nor page.

This is a short version of benchmarks/page_forged.py.
"""

import page_forged
import pytest
from page_lab import page_lab

from stalls import retry_after_stalls

pytestmark = [pytest.mark.alone, pytest.mark.slow]


def test_forged_and_random_requests_move_change_and_stop_nothing() -> None:
    def find_failures() -> list[str]:
        found: list[str] = []
        token = "a token that is long enough"
        with page_lab(recorded=True, token=token, teaching_frames=30) as lab:

            def operate() -> None:
                holder = page_forged.Holder(lab)
                for state, sentences in page_forged.forged(holder, 30).items():
                    found.extend(f"{state}: {one}" for one in sentences)
                _, ticks = page_forged.fuzzed(holder, 150)
                if ticks.longest > page_forged.GAP or not ticks.still:
                    found.append(f"fuzzed: {ticks.longest:.0f} ms without a command")
                if not page_forged.stop_heard(holder, 20):
                    found.append("fuzzed: the page has lost its operator, or STOP has no effect")

            lab.play(operate)
        return found

    assert retry_after_stalls(find_failures, lambda found: not found) == []
