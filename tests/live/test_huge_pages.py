"""Memory of real-time processes without huge pages, as the kernel reports it."""

from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from rcmservo.live.child_process import ChildProcess, receive_from_parent
from rcmservo.live.realtime import apply_realtime_settings, without_huge_pages

STATUS = Path("/proc/self/status")


def huge_pages_enabled() -> bool:
    """Return True if the kernel may use huge pages for this process."""
    line = next(line for line in STATUS.read_text().splitlines() if line.startswith("THP_enabled"))
    return line.split()[1] == "1"


pytestmark = pytest.mark.skipif(
    not STATUS.exists() or "THP_enabled" not in STATUS.read_text(),
    reason="this kernel does not report its use of huge pages",
)


def send_huge(control: Connection) -> None:
    control.send(huge_pages_enabled())
    receive_from_parent(control)


@pytest.mark.parametrize("context", [without_huge_pages, apply_realtime_settings])
def test_huge_pages_are_disabled_inside_and_restored_afterwards(context) -> None:
    before = huge_pages_enabled()
    with pytest.raises(KeyError), context():
        assert not huge_pages_enabled()
        with without_huge_pages():
            pass
        assert not huge_pages_enabled()
        raise KeyError
    assert huge_pages_enabled() == before


def test_huge_pages_are_disabled_permanently_in_started_processes() -> None:
    child = ChildProcess(get_context("spawn"), send_huge)
    try:
        assert child.receive() is False
    finally:
        child.end()
