"""Poses on disk: target files in one folder, whatever their names, and damaged files."""

from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rcmservo as rs
from rcmservo.cli.simulated_run.target import describe_simulated_setup
from rcmservo.config import target_file
from rcmservo.config.rig_file import RigDescription
from rcmservo.page.poses import PoseFolder, PoseStore
from rcmservo.page.view_model import list_recovery_actions
from rcmservo.safety.causes import Action, Cause
from rcmservo.sim import Rig

SETUP = describe_simulated_setup(Rig(1, pictures=False), RigDescription())
TARGET = rs.Target(np.array([[100.0, 200.0], [150.0, 250.0]]), np.array([0.5, 0.1, 120.0]))


def load_poses(folder: Path, seed: int = 1) -> PoseStore:
    setup = (
        SETUP
        if seed == 1
        else describe_simulated_setup(Rig(seed, pictures=False), RigDescription())
    )
    made = PoseStore(PoseFolder(folder, setup))
    made.load()
    return made


def test_a_pose_is_stored_as_a_target_file_with_its_picture(
    tmp_path: Path,
) -> None:
    assert load_poses(tmp_path / "new").save("left of it", TARGET, b"picture") == ""
    reloaded = load_poses(tmp_path / "new")
    assert (
        reloaded.targets["left of it"] == TARGET
        and reloaded.read_picture("left of it") == b"picture"
    )
    (file,) = (tmp_path / "new").glob("*.json")
    assert target_file.load_target(file, SETUP) == TARGET
    other = rs.Target(TARGET.points + 1.0, TARGET.q)
    reloaded.save("left of it", other, b"other")
    replaced = load_poses(tmp_path / "new")
    assert (
        replaced.targets["left of it"] == other and replaced.read_picture("left of it") == b"other"
    )
    assert replaced.delete("left of it") == ""
    assert not list((tmp_path / "new").iterdir()) and not load_poses(tmp_path / "new").targets


def test_a_damaged_file_or_one_of_another_rig_is_refused_with_the_reason(
    tmp_path: Path,
) -> None:
    made = load_poses(tmp_path)
    made.save("here", TARGET, b"")
    made.save("there", TARGET, b"")
    there = tmp_path / "there.json"
    there.write_text(there.read_text().replace("100.0", "101.0"))
    reloaded = load_poses(tmp_path)
    assert list(reloaded.targets) == ["here"] and "checksum" in reloaded.refused["there"]
    other = load_poses(tmp_path, seed=2)
    assert not other.targets and "teach the target again" in other.refused["here"]


@given(st.text(min_size=1, max_size=40), st.text(min_size=1, max_size=40))
def test_no_name_leaves_the_folder_and_no_two_have_the_same_file(one: str, other: str) -> None:
    made = PoseStore(PoseFolder(Path("/p/q"), SETUP))
    found: list[Path] = []
    for name in (one, other):
        try:
            found.append(made._find_file(name))
        except (rs.RcmServoError, UnicodeEncodeError):
            continue
        assert found[-1].parent == Path("/p/q") and unquote(found[-1].stem) == name
    assert len(set(found)) == len(found) or one == other


@pytest.mark.parametrize("name", ["../x", "a/b", "..", "C:\\x", "\0"])
def test_names_that_are_paths_stay_inside_the_folder(tmp_path: Path, name: str) -> None:
    made = load_poses(tmp_path / "in")
    assert made.save(name, TARGET, b"x") == ""
    assert [path.parent for path in tmp_path.rglob("*.json")] == [tmp_path / "in"]
    assert name in load_poses(tmp_path / "in").targets
    assert made.delete(name) == "" and not list((tmp_path / "in").iterdir())


def test_a_pose_that_cannot_be_written_is_reported_and_remains_usable(tmp_path: Path) -> None:
    (file := tmp_path / "file").write_text("")
    made = load_poses(file / "in")
    assert "here is not stored" in made.save("here", TARGET, b"") and "here" in made.targets
    assert "a name longer than 200 bytes" in made.save("ü" * 40, TARGET, b"")


@pytest.mark.parametrize("cause", list(Cause))
def test_the_recovery_actions_match_the_way_out_in_words(cause: Cause) -> None:
    phase = rs.Phase.FAULT if cause.action is Action.FAULT else rs.Phase.PAUSED
    offered = list_recovery_actions(phase, cause)
    assert ("teach_again" in offered) == ("teach the target again" in cause.remedy)
    if "resume" in cause.remedy and phase is rs.Phase.PAUSED:
        assert offered[-1] == "resume"
    if "clear" in cause.remedy.split() and phase is rs.Phase.FAULT:
        assert offered == ["clear"]
    assert list_recovery_actions(rs.Phase.SERVO, cause) == []
