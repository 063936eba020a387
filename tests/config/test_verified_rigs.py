"""Registry of the rig files that have passed `rig check`."""

import json
from pathlib import Path

import pytest

from rcmservo.config.rig_file import decode_rig_file, read_rig_file
from rcmservo.config.verified_rigs import (
    compute_digest,
    is_rig_verified,
    mark_rig_verified,
    unmark_rig_verified,
)
from rcmservo.errors import UnusableFile

ONE, OTHER = compute_digest(b"[arm]\n"), compute_digest(b"[arm] \n")


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state/rcmservo/checked"


def test_a_file_that_passed_is_identified_by_its_bytes_until_it_fails() -> None:
    assert not is_rig_verified(ONE)
    unmark_rig_verified(ONE)
    mark_rig_verified(ONE)
    mark_rig_verified(ONE)
    assert is_rig_verified(ONE) and not is_rig_verified(OTHER)
    unmark_rig_verified(ONE)
    assert not is_rig_verified(ONE)


def test_without_a_home_directory_there_are_no_notes_and_an_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setattr("os.path.expanduser", str)
    assert not is_rig_verified(ONE)
    for use in (mark_rig_verified, unmark_rig_verified):
        with pytest.raises(UnusableFile, match="set XDG_STATE_HOME"):
            use(ONE)


@pytest.mark.parametrize(
    "damage",
    [
        lambda whole: "",
        lambda whole: whole[:-20],
        lambda whole: whole.replace("checked 1", "checked 2"),
        lambda whole: whole.replace(ONE, OTHER),
        lambda whole: json.dumps([whole]),
        lambda whole: whole + " " * 5000,
        lambda whole: "[" * 4000,
    ],
)
def test_a_damaged_note_is_ignored(damage, state: Path) -> None:
    mark_rig_verified(ONE)
    note = state / f"{ONE}.json"
    note.write_text(damage(note.read_text()))
    assert not is_rig_verified(ONE)
    mark_rig_verified(ONE)
    assert is_rig_verified(ONE)


def test_a_note_that_is_no_text_or_no_file_is_ignored(state: Path) -> None:
    state.mkdir(parents=True)
    (state / f"{ONE}.json").write_bytes(b"\xff\xfe")
    (state / f"{OTHER}.json").mkdir()
    assert not is_rig_verified(ONE) and not is_rig_verified(OTHER)


def test_a_state_directory_that_cannot_be_made_is_one_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "state").write_text("")
    with pytest.raises(UnusableFile, match="cannot be made"):
        mark_rig_verified(ONE)
    assert not is_rig_verified(ONE)
    unmark_rig_verified(ONE)


def test_a_relative_state_directory_is_ignored_as_its_standard_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", "here")
    monkeypatch.setenv("HOME", str(tmp_path))
    mark_rig_verified(ONE)
    assert (tmp_path / f".local/state/rcmservo/checked/{ONE}.json").is_file()


def test_the_digest_and_the_settings_come_from_the_same_bytes(tmp_path: Path) -> None:
    """A change of the file between two readings has no effect."""
    path = tmp_path / "lab.toml"
    path.write_text("[gate]\nspeed = [0.5, 0.5, 40.0]\n")
    data = read_rig_file(path)
    path.write_text("[gate]\nspeed = [5.0, 5.0, 400.0]\n")
    assert decode_rig_file(path, data).gate.speed == (0.5, 0.5, 40.0)
