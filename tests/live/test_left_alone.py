"""No huge pages are made of the memory of what must not wait, as the kernel tells it."""

from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from rcmservo.live.child_process import ChildProcess, receive_from_parent
from rcmservo.live.realtime import realtime, without_huge_pages

STATUS = Path("/proc/self/status")


def huge() -> bool:
    """Whether the kernel may make huge pages of this process's memory."""
    line = next(line for line in STATUS.read_text().splitlines() if line.startswith("THP_enabled"))
    return line.split()[1] == "1"


pytestmark = pytest.mark.skipif(
    not STATUS.exists() or "THP_enabled" not in STATUS.read_text(),
    reason="this kernel does not tell whether it makes huge pages",
)


def tell_huge(control: Connection) -> None:
    control.send(huge())
    receive_from_parent(control)


@pytest.mark.parametrize("context", [without_huge_pages, realtime])
def test_memory_is_left_alone_in_it_and_afterwards_is_as_before(context) -> None:
    before = huge()
    with pytest.raises(KeyError), context():
        assert not huge()
        with without_huge_pages():
            pass
        assert not huge()
        raise KeyError
    assert huge() == before


def test_that_of_every_process_that_is_started_is_left_alone_for_good() -> None:
    child = ChildProcess(get_context("spawn"), tell_huge)
    try:
        assert child.receive() is False
    finally:
        child.end()
