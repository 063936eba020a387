"""`rcmservo markers` finds the balls of a picture, says which two the tracker takes, and writes
them down.
"""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from conftest import DATA, ROOT
from rcmservo.cli.cli import main
from rcmservo.config.rig_file import load_lab
from rcmservo.interfaces import Image
from rcmservo.sim.rig import Rig
from rcmservo.tracking import read_image

BALLS = {"red": (40, 40, 200), "green": (40, 190, 40), "blue": (200, 60, 20)}


def drawn(*balls: tuple[str, int, int, float]) -> Image:
    """Discs (colour, u, v, radius) before a grey wall."""
    image = np.full((240, 320, 3), 90, np.uint8)
    rows, columns = np.mgrid[0:240, 0:320]
    for colour, u, v, radius in balls:
        cover = np.clip(radius - np.hypot(columns - u, rows - v) + 0.5, 0.0, 1.0)[..., None]
        image = np.uint8(np.round(cover * BALLS[colour] + (1.0 - cover) * image))
    return image


@pytest.fixture
def frame(tmp_path: Path) -> Path:
    """The simulated camera's first picture."""
    path = tmp_path / "frame.png"
    cv2.imwrite(str(path), Rig(0).camera.latest().image)
    return path


def told(capsys: pytest.CaptureFixture[str], *words: object, code: int = 0) -> dict[str, Any]:
    assert main(["markers", *map(str, words), "--json"]) == code
    return json.loads(capsys.readouterr().out)


def refused(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    assert main(["markers", *map(str, words)]) == 2
    said = capsys.readouterr()
    assert not said.out and said.err.count("\n") == 1
    return said.err


def test_the_balls_of_a_rendered_frame_are_where_the_simulator_put_them(
    frame: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth, q = Rig(0).truth, Rig(0).arm.measure().q
    first = told(capsys, frame)
    assert [list(one) for one in first["candidates"]] == 4 * [
        ["colour", "u_px", "v_px", "radius_px", "quality"]
    ]
    places = {one["colour"]: (one["u_px"], one["v_px"]) for one in first["candidates"][:2]}
    balls = truth.body.points(q)[:2]
    true = [truth.optics.silhouette_centre(ball, 3.5) for ball in balls]
    np.testing.assert_allclose([places["green"], places["blue"]], true, atol=0.2)
    assert {first["look"]["colour_1"], first["look"]["colour_2"]} == {"green", "blue"}


def test_chosen_colours_are_what_the_tracker_takes_and_are_written(
    frame: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "lab.toml"
    rig.write_text('[tool] # mine\nkind = "rigid"\nspacing = 20.0\n')
    one = told(capsys, frame, "--choose", "blue,green", "--rig", rig)
    assert one["written"] and not one["why"]
    look = load_lab(rig).markers
    assert (look.colour_1, look.colour_2) == ("blue", "green")
    assert look.radius_2 / look.radius_1 == pytest.approx(10.3 / 9.7, abs=0.02)
    assert rig.read_text().startswith('[tool] # mine\nkind = "rigid"\nspacing = 20.0\n')
    again = told(capsys, frame, "--rig", rig)
    assert again["markers"] == one["markers"] and not again["written"]


def test_radii_that_the_rig_file_has_are_measured_ones_and_stay(
    frame: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "lab.toml"
    rig.write_text("[markers]\nradius_1 = 4.0 # callipers\nradius_2 = 4.1\n")
    told(capsys, frame, "--choose", "green,blue", "--rig", rig)
    assert "radius_1 = 4.0 # callipers\nradius_2 = 4.1\n" in rig.read_text()
    assert load_lab(rig).markers.colour_1 == "green"


def test_the_picture_shows_what_was_found_and_says_so_below(
    frame: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "seen.png"
    told(capsys, frame, "--choose", "green,blue", "--picture", out)
    before, seen = read_image(frame), read_image(out)
    assert seen.shape[0] > before.shape[0] and seen.shape[1] == before.shape[1]
    changed = (seen[: before.shape[0]] != before).any(axis=2)
    assert 0.005 < changed.mean() < 0.1
    assert "bmp" in refused(capsys, frame, "--picture", tmp_path / "seen.bmp")
    before = frame.read_bytes()
    assert "nothing is overwritten" in refused(capsys, frame, "--picture", frame)
    assert frame.read_bytes() == before


def test_one_colour_twice_wants_radii_that_differ(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, rig = tmp_path / "two.png", tmp_path / "lab.toml"
    cv2.imwrite(str(path), drawn(("red", 100, 100, 20.0), ("red", 200, 150, 14.0)))
    rig.write_text("")
    for words in (["--choose", "red,red"], ["--choose", "red,red", "--rig", rig]):
        assert "must be two colours; of two balls of one colour" in refused(capsys, path, *words)
    rig.write_text("[markers]\nradius_1 = 4.0\nradius_2 = 4.0\n")
    assert "1.1 times larger" in refused(capsys, path, "--choose", "red,red", "--rig", rig)
    rig.write_text("[markers]\nradius_1 = 4.0\nradius_2 = 6.0\n")
    one = told(capsys, path, "--choose", "red,red", "--rig", rig)
    np.testing.assert_allclose(one["markers"], [[200, 150], [100, 100]], atol=0.3)


def test_nothing_is_written_where_the_tracker_would_take_no_two(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, rig = tmp_path / "three.png", tmp_path / "lab.toml"
    rig.write_text("# empty\n")
    cv2.imwrite(
        str(path),
        drawn(("red", 100, 100, 15.0), ("red", 200, 150, 15.0), ("blue", 60, 200, 15.0)),
    )
    said = refused(capsys, path, "--choose", "red,blue", "--rig", rig)
    assert "two pairs of balls can be the markers" in said and "nothing was written" in said
    assert "no green ball" in refused(capsys, path, "--choose", "green,blue", "--rig", rig)
    assert rig.read_text() == "# empty\n"


def test_a_picture_without_balls_is_told_in_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "wall.png"
    cv2.imwrite(str(path), drawn())
    assert told(capsys, path, code=1)["candidates"] == []
    assert main(["markers", str(path), "--picture", str(tmp_path / "seen.png")]) == 1
    assert (
        capsys.readouterr().out == "the picture shows no ball of a colour that the tracker knows\n"
    )
    assert read_image(tmp_path / "seen.png").shape[1] == 320


@pytest.mark.parametrize("size", [(1, 1), (3, 900), (2000, 2)])
def test_a_picture_of_hardly_any_pixels_shows_nothing(
    size: tuple[int, int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "tiny.png"
    cv2.imwrite(str(path), np.full((*size, 3), 200, np.uint8))
    assert told(capsys, path, "--picture", tmp_path / "seen.png", code=1)["candidates"] == []


@pytest.mark.parametrize("content", ["", "red,green\n", "\x89PNG\r\n\x1a\n"])
def test_what_is_no_picture_is_refused_in_a_sentence(
    content: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "frame.png"
    path.write_text(content, "latin-1")
    assert str(path) in refused(capsys, path)


def test_colours_that_nobody_knows_are_refused(
    frame: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for words in ("green", "green,blu", "green,blue,red", ","):
        assert "--choose must be two of red, green" in refused(capsys, frame, "--choose", words)


def test_both_balls_of_the_da_vinci_are_found(capsys: pytest.CaptureFixture[str]) -> None:
    if not DATA.exists():
        pytest.skip("../shared/data is not here")
    rig = ROOT / "examples/davinci.toml"
    for frame in sorted((DATA / "frames").iterdir())[::12]:
        one = told(capsys, frame, "--rig", rig)
        assert [each["colour"] for each in one["candidates"]][:2] == ["red", "red"]
        assert one["markers"] is not None
