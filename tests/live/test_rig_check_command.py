"""`rcmservo rig check` at a terminal, against the emulated controller and its camera."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from at_terminal import AtTerminal, Laboratory, words_of

from conftest import HEEDING_CTRL_C, SMALL

pytestmark = pytest.mark.alone


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Laboratory]:
    it = Laboratory(tmp_path_factory.mktemp("laboratory"), seed=1, rig=SMALL)
    yield it
    it.close()


def command(lab: Path, *options: str) -> list[str]:
    return [sys.executable, "-c", HEEDING_CTRL_C, "rig", "check", str(lab), *options]


def stands(person: AtTerminal, laboratory: Laboratory) -> None:
    """The person says where the arm stands."""
    person.until("such as 0.1 -0.2 100:")
    person.type(words_of(laboratory.start) + "\n")
    person.until("Enter if so:")
    person.type("\n")


def test_no_moves_nothing_and_ends_with_the_drive_off(
    laboratory: Laboratory, tmp_path: Path
) -> None:
    laboratory.forget()
    with AtTerminal(command(laboratory.lab()), XDG_STATE_HOME=str(tmp_path)) as person:
        stands(person, laboratory)
        before = laboratory.counts, laboratory.sessions
        person.until("(enable / no)")
        person.type("no\n")
        assert person.end() == 1
        assert "person" in person.shown
    assert (laboratory.counts, laboratory.sessions) == before
    assert laboratory.off
