"""`rcmservo rig check` at a terminal, against the emulated controller and its camera."""

import json
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from at_terminal import AtTerminal, Laboratory, words_of

from conftest import HEEDING_CTRL_C, SMALL
from rcmservo.app.lab.emulate import COUNTS

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


@pytest.mark.slow
def test_a_reversed_joint_is_named_with_its_line(tmp_path: Path) -> None:
    with closing(Laboratory(tmp_path, seed=3)) as laboratory:
        lab = laboratory.lab()
        wrong = [COUNTS[0], -COUNTS[1], COUNTS[2]]
        lab.write_text(lab.read_text().replace(str(list(COUNTS)), str(wrong)))
        told = checked(laboratory, lab, tmp_path)
        assert not told["ok"]
        assert f"counts = {list(COUNTS)}" in [one["line"] for one in told["findings"]]
        assert laboratory.off
        assert np.abs(laboratory.counts - laboratory.start * wrong).max() < 1000.0


def checked(laboratory: Laboratory, lab: Path, folder: Path) -> dict[str, Any]:
    """What the command tells of a lab whose second joint is reversed, the person agreeing to all
    and saying what the tool did truly."""
    ways = {"joint 1": "away\n", "joint 2": "anticlockwise\n"}
    with AtTerminal(command(lab, "--json"), json=True, XDG_STATE_HOME=str(folder)) as person:
        stands(person, laboratory)
        person.until("(enable / no)")
        person.type("enable\n")
        asked = ""
        while "For joint 2" not in asked:
            asked = person.until(") ")
            if asked.rstrip().endswith("(yes / no)"):
                person.type("yes\n")
            elif asked.rstrip().endswith("/ again)"):
                person.type(next(way for name, way in ways.items() if f"For {name}" in asked))
        person.end()
        assert person.process.stdout is not None
        return json.loads(person.process.stdout.read())
