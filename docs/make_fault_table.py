"""Write the table of causes in docs/faults.md from their declarations in the source.

python docs/make_fault_table.py
"""

import re
from pathlib import Path

from rcmservo.safety.causes import Cause, Invalidates

PAGE = Path(__file__).parent / "faults.md"
HEADING = "| cause | action | description | remedy | invalidates |\n|---|---|---|---|---|\n"

INVALIDATED = {
    Invalidates.NOTHING: "",
    Invalidates.ESTIMATE: "the estimate",
    Invalidates.ESTIMATE_AND_TARGETS: "the estimate and all targets",
}


def table() -> str:
    """Return the table, with one row for each cause."""
    rows = [row(cause) for cause in Cause if cause is not Cause.NONE]
    return HEADING + "".join(f"| {' | '.join(cells)} |\n" for cells in rows)


def row(cause: Cause) -> list[str]:
    """Return the cells of a cause."""
    lost, lost_before = cause.declared.invalidates, cause.declared.invalidates_unexplored
    words = INVALIDATED[max(lost, lost_before)]
    words += " before exploration is done" if lost < lost_before else ""
    return [f"`{cause.name}`", cause.action.name, cause.value, cause.remedy, words]


def with_table(page: str) -> str:
    """Return the page with the present table."""
    pattern = re.escape(HEADING.partition(" description")[0]) + r"[^\n]*\n(\|[^\n]*\n)+"
    page, count = re.subn(pattern, lambda _: table(), page)
    assert count == 1, f"{PAGE.name} has {count} tables of causes; expected 1"
    return page


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text()))
