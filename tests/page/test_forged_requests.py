"""Forged requests move and change nothing in any state, and rubbish stops neither loop nor page:
the whole is in benchmarks/page_forged.py, of which this is a short part.
"""

import page_forged
import pytest
from page_lab import page_lab

from stalls import undisturbed

pytestmark = [pytest.mark.alone, pytest.mark.slow]


def test_forged_and_random_requests_move_change_and_stop_nothing() -> None:
    def wrong() -> list[str]:
        found: list[str] = []
        with page_lab(recorded=True, token="a token that is long enough") as lab:

            def person() -> None:
                holder = page_forged.Holder(lab)
                for state, sentences in page_forged.forged(holder, 40).items():
                    found.extend(f"{state}: {one}" for one in sentences)
                _, ticks = page_forged.fuzzed(holder, 150)
                if ticks.longest > page_forged.GAP or not ticks.still:
                    found.append(f"fuzzed: {ticks.longest:.0f} ms without a command")
                if not page_forged.stop_heard(holder, 20):
                    found.append("fuzzed: the page has lost its person, or hears no STOP")

            lab.play(person)
        return found

    assert undisturbed(wrong, lambda found: not found) == []
