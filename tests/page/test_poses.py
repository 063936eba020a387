"""Poses on disk: what is taught is a target's file, and no name and no damage does harm."""

from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rcmservo as rs
from rcmservo.cli.simulated_run.target import setup_of
from rcmservo.config import target_file
from rcmservo.config.rig_file import Lab
from rcmservo.loop.operator import same
from rcmservo.page.poses import PoseFolder, Poses
from rcmservo.page.recovery_actions import ways
from rcmservo.safety.causes import Action, Cause
from rcmservo.sim import Rig

SETUP = setup_of(Rig(1, pictures=False), Lab())
TARGET = rs.Target(np.array([[100.0, 200.0], [150.0, 250.0]]), np.array([0.5, 0.1, 120.0]))


def poses(folder: Path, seed: int = 1) -> Poses:
    setup = SETUP if seed == 1 else setup_of(Rig(seed, pictures=False), Lab())
    made = Poses(PoseFolder(folder, setup))
    made.read()
    return made


def test_a_pose_is_there_again_later_with_its_picture_as_a_file_that_target_takes(
    tmp_path: Path,
) -> None:
    assert poses(tmp_path / "new").keep("left of it", TARGET, b"picture") == ""
    again = poses(tmp_path / "new")
    assert same(again.targets["left of it"], TARGET) and again.picture("left of it") == b"picture"
    (file,) = (tmp_path / "new").glob("*.json")
    assert same(target_file.load(file, SETUP), TARGET)
    other = rs.Target(TARGET.points + 1.0, TARGET.q)
    again.keep("left of it", other, b"other")
    then = poses(tmp_path / "new")
    assert same(then.targets["left of it"], other) and then.picture("left of it") == b"other"
    assert then.delete("left of it") == ""
    assert not list((tmp_path / "new").iterdir()) and not poses(tmp_path / "new").targets


def test_what_another_rig_was_shown_or_is_damaged_is_refused_with_the_reason(
    tmp_path: Path,
) -> None:
    made = poses(tmp_path)
    made.keep("here", TARGET, b"")
    made.keep("there", TARGET, b"")
    there = tmp_path / "there.json"
    there.write_text(there.read_text().replace("100.0", "101.0"))
    again = poses(tmp_path)
    assert list(again.targets) == ["here"] and "checksum" in again.refused["there"]
    other = poses(tmp_path, seed=2)
    assert not other.targets and "teach the target again" in other.refused["here"]


@given(st.text(min_size=1, max_size=40), st.text(min_size=1, max_size=40))
def test_no_name_leaves_the_folder_and_no_two_share_a_file(one: str, other: str) -> None:
    made = Poses(PoseFolder(Path("/p/q"), SETUP))
    found: list[Path] = []
    for name in (one, other):
        try:
            found.append(made._file(name))
        except (rs.RcmServoError, UnicodeEncodeError):
            continue
        assert found[-1].parent == Path("/p/q") and unquote(found[-1].stem) == name
    assert len(set(found)) == len(found) or one == other


@pytest.mark.parametrize("name", ["../x", "a/b", "..", "C:\\x", "\0"])
def test_names_that_are_paths_stay_inside(tmp_path: Path, name: str) -> None:
    made = poses(tmp_path / "in")
    assert made.keep(name, TARGET, b"x") == ""
    assert [path.parent for path in tmp_path.rglob("*.json")] == [tmp_path / "in"]
    assert name in poses(tmp_path / "in").targets
    assert made.delete(name) == "" and not list((tmp_path / "in").iterdir())


def test_where_the_disk_takes_nothing_it_is_told_and_the_pose_stays_of_use(tmp_path: Path) -> None:
    (file := tmp_path / "file").write_text("")
    made = poses(file / "in")
    assert "here is not kept" in made.keep("here", TARGET, b"") and "here" in made.targets
    assert "too long a name" in made.keep("ü" * 40, TARGET, b"")


@pytest.mark.parametrize("cause", list(Cause))
def test_the_buttons_are_those_that_the_way_out_names(cause: Cause) -> None:
    phase = rs.Phase.FAULT if cause.action is Action.FAULT else rs.Phase.PAUSED
    offered = ways(phase, cause)
    assert ("show" in offered) == ("teach the target again" in cause.way_out)
    if "resume" in cause.way_out and phase is rs.Phase.PAUSED:
        assert offered[-1] == "resume"
    if "clear" in cause.way_out.split() and phase is rs.Phase.FAULT:
        assert offered == ["clear"]
    assert ways(rs.Phase.SERVO, cause) == []
