"""Edits of a rig file's markers leave every other byte unchanged."""

import tomllib
from pathlib import Path

import pytest

from conftest import ROOT
from rcmservo.config.rig_file import load_rig_file
from rcmservo.config.rig_file_edit import MarkerValues, find_marker_keys, write_markers
from rcmservo.errors import BadInput, UnusableFile
from rcmservo.tracking import MarkerAppearance

NEW: MarkerValues = {"colour_1": "cyan", "colour_2": "yellow", "radius_1": 5.0, "radius_2": 4.25}
LINES = 'colour_1 = "cyan"\ncolour_2 = "yellow"\nradius_1 = 5.0\nradius_2 = 4.25\n'

TEXTS = {
    "": f"[markers]\n{LINES}",
    "# mine\n": f"# mine\n\n[markers]\n{LINES}",
    "[tool]\nkind='rigid'\nspacing=3.0": f"[tool]\nkind='rigid'\nspacing=3.0\n\n[markers]\n{LINES}",
    "[markers]\n\n# the tool\n[tool]\nkind = 'rigid'\nspacing = 3.0\n": f"[markers]\n{LINES}\n"
    "# the tool\n[tool]\nkind = 'rigid'\nspacing = 3.0\n",
    "[ markers ] # seen\n  colour_1='red'   # nearer\r\nradius_2 = 7 #mm\n": "[ markers ] # seen\n"
    '  colour_1="cyan"   # nearer\r\nradius_2 = 4.25 #mm\ncolour_2 = "yellow"\r\n'
    "radius_1 = 5.0\r\n",
    "[markers]\nradius_1 = 2.0": '[markers]\nradius_1 = 5.0\ncolour_1 = "cyan"\n'
    'colour_2 = "yellow"\nradius_2 = 4.25\n',
}


@pytest.mark.parametrize("before", TEXTS)
def test_only_the_markers_change(before: str, tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_bytes(before.encode())
    write_markers(path, NEW)
    assert path.read_bytes().decode() == TEXTS[before]
    assert load_rig_file(path).markers == MarkerAppearance("cyan", "yellow", 5.0, 4.25)
    assert list(tmp_path.iterdir()) == [path]


def test_every_other_line_of_the_example_is_unchanged(tmp_path: Path) -> None:
    text = (ROOT / "examples/davinci.toml").read_text()
    path = tmp_path / "lab.toml"
    path.write_text(text)
    assert find_marker_keys(path) == set(tomllib.loads(text)["markers"])
    write_markers(path, {"colour_1": "green", "colour_2": "blue"})
    expected = text.replace('colour_1 = "red"', 'colour_1 = "green"')
    assert path.read_text() == expected.replace('colour_2 = "red"', 'colour_2 = "blue"')


def test_the_file_behind_a_symbolic_link_is_written(tmp_path: Path) -> None:
    (tmp_path / "real.toml").write_text("")
    (tmp_path / "lab.toml").symlink_to(tmp_path / "real.toml")
    write_markers(tmp_path / "lab.toml", NEW)
    assert (tmp_path / "lab.toml").is_symlink()
    assert load_rig_file(tmp_path / "real.toml").markers.colour_1 == "cyan"


@pytest.mark.parametrize(
    "text",
    [
        'markers = {colour_1 = "red"}\n',
        'markers.colour_1 = "red"\n[tool]\nkind = "rigid"\nspacing = 3.0\n',
        '["markers"]\ncolour_1 = "red"\n',
        '[markers]\n"colour_1" = "red"\n',
    ],
)
def test_a_syntax_that_cannot_be_edited_is_left_and_the_error_gives_the_lines(
    text: str, tmp_path: Path
) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(text)
    with pytest.raises(UnusableFile, match='edited by hand: write colour_1 = "cyan"'):
        write_markers(path, NEW)
    assert path.read_text() == text


def test_an_invalid_file_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text("[gate]\nnothing = 3\n")
    with pytest.raises(BadInput, match=r"gate\.nothing"):
        write_markers(path, NEW)
    assert path.read_text() == "[gate]\nnothing = 3\n"
