"""`rcmservo markers`: detected balls, the two that the tracker uses, and the rig file."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from conftest import ARM_RECORDING, ROOT
from rcmservo.cli.cli import main
from rcmservo.config.rig_file import load_rig_file
from rcmservo.interfaces import Image
from rcmservo.sim import Rig
from rcmservo.tracking import read_image

BALLS = {"red": (40, 40, 200), "green": (40, 190, 40), "blue": (200, 60, 20)}


def draw_discs(*balls: tuple[str, int, int, float]) -> Image:
    """Return an image of discs (colour, u, v, radius) on grey."""
    image = np.full((240, 320, 3), 90, np.uint8)
    rows, columns = np.mgrid[0:240, 0:320]
    for colour, u, v, radius in balls:
        cover = np.clip(radius - np.hypot(columns - u, rows - v) + 0.5, 0.0, 1.0)[..., None]
        image = np.uint8(np.round(cover * BALLS[colour] + (1.0 - cover) * image))
    return image


@pytest.fixture
def frame(tmp_path: Path) -> Path:
    """Return the file of the simulated camera's first image."""
    path = tmp_path / "frame.png"
    cv2.imwrite(str(path), Rig(0).camera.latest().image)
    return path


def markers_json(
    capsys: pytest.CaptureFixture[str], *words: object, code: int = 0
) -> dict[str, Any]:
    assert main(["markers", *map(str, words), "--json"]) == code
    return json.loads(capsys.readouterr().out)


def error_of(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    assert main(["markers", *map(str, words)]) == 2
    output = capsys.readouterr()
    assert not output.out and output.err.count("\n") == 1
    return output.err


def test_the_balls_of_a_rendered_frame_are_detected_at_their_true_positions(
    frame: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth, q = Rig(0).truth, Rig(0).arm.measure().q
    first = markers_json(capsys, frame)
    assert [list(found) for found in first["candidates"]] == 4 * [
        ["colour", "u_px", "v_px", "radius_px", "quality"]
    ]
    centres = {found["colour"]: (found["u_px"], found["v_px"]) for found in first["candidates"][:2]}
    balls = truth.tool_body.points(q)[:2]
    true = [truth.camera_model.silhouette_centre(ball, 3.5) for ball in balls]
    np.testing.assert_allclose([centres["green"], centres["blue"]], true, atol=0.2)
    assert {first["look"]["colour_1"], first["look"]["colour_2"]} == {"green", "blue"}


def test_chosen_colours_are_tracked_and_written(
    frame: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "lab.toml"
    rig.write_text('[tool] # mine\nkind = "rigid"\nspacing = 20.0\n')
    found = markers_json(capsys, frame, "--choose", "blue,green", "--rig", rig)
    assert found["written"] and not found["why"]
    appearance = load_rig_file(rig).markers
    assert (appearance.colour_1, appearance.colour_2) == ("blue", "green")
    assert appearance.radius_2 / appearance.radius_1 == pytest.approx(10.3 / 9.7, abs=0.02)
    assert rig.read_text().startswith('[tool] # mine\nkind = "rigid"\nspacing = 20.0\n')
    second = markers_json(capsys, frame, "--rig", rig)
    assert second["markers"] == found["markers"] and not second["written"]


def test_radii_of_the_rig_file_are_not_changed(
    frame: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "lab.toml"
    rig.write_text("[markers]\nradius_1 = 4.0 # callipers\nradius_2 = 4.1\n")
    markers_json(capsys, frame, "--choose", "green,blue", "--rig", rig)
    assert "radius_1 = 4.0 # callipers\nradius_2 = 4.1\n" in rig.read_text()
    assert load_rig_file(rig).markers.colour_1 == "green"


def test_the_output_image_has_rings_and_a_caption(
    frame: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "drawn.png"
    markers_json(capsys, frame, "--choose", "green,blue", "--picture", out)
    before, drawn_image = read_image(frame), read_image(out)
    assert drawn_image.shape[0] > before.shape[0] and drawn_image.shape[1] == before.shape[1]
    changed = (drawn_image[: before.shape[0]] != before).any(axis=2)
    assert 0.005 < changed.mean() < 0.1
    assert "bmp" in error_of(capsys, frame, "--picture", tmp_path / "drawn.bmp")
    before = frame.read_bytes()
    assert "nothing is overwritten" in error_of(capsys, frame, "--picture", frame)
    assert frame.read_bytes() == before


def test_two_balls_of_one_colour_require_different_radii(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, rig = tmp_path / "two.png", tmp_path / "lab.toml"
    cv2.imwrite(str(path), draw_discs(("red", 100, 100, 20.0), ("red", 200, 150, 14.0)))
    rig.write_text("")
    for words in (["--choose", "red,red"], ["--choose", "red,red", "--rig", rig]):
        assert "must be two different colours; for two balls of one colour" in error_of(
            capsys, path, *words
        )
    rig.write_text("[markers]\nradius_1 = 4.0\nradius_2 = 4.0\n")
    assert "1.1 times larger" in error_of(capsys, path, "--choose", "red,red", "--rig", rig)
    rig.write_text("[markers]\nradius_1 = 4.0\nradius_2 = 6.0\n")
    found = markers_json(capsys, path, "--choose", "red,red", "--rig", rig)
    np.testing.assert_allclose(found["markers"], [[200, 150], [100, 100]], atol=0.3)


def test_nothing_is_written_without_two_tracked_balls(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, rig = tmp_path / "three.png", tmp_path / "lab.toml"
    rig.write_text("# empty\n")
    cv2.imwrite(
        str(path),
        draw_discs(("red", 100, 100, 15.0), ("red", 200, 150, 15.0), ("blue", 60, 200, 15.0)),
    )
    output = error_of(capsys, path, "--choose", "red,blue", "--rig", rig)
    assert "two pairs of balls can be the markers" in output and "nothing was written" in output
    assert "no green ball" in error_of(capsys, path, "--choose", "green,blue", "--rig", rig)
    assert rig.read_text() == "# empty\n"


def test_an_image_without_balls_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "wall.png"
    cv2.imwrite(str(path), draw_discs())
    assert markers_json(capsys, path, code=1)["candidates"] == []
    assert main(["markers", str(path), "--picture", str(tmp_path / "drawn.png")]) == 1
    assert (
        capsys.readouterr().out == "the picture shows no ball of a colour that the tracker knows\n"
    )
    assert read_image(tmp_path / "drawn.png").shape[1] == 320


@pytest.mark.parametrize("size", [(1, 1), (3, 900), (2000, 2)])
def test_a_tiny_image_has_no_balls(
    size: tuple[int, int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "tiny.png"
    cv2.imwrite(str(path), np.full((*size, 3), 200, np.uint8))
    assert (
        markers_json(capsys, path, "--picture", tmp_path / "drawn.png", code=1)["candidates"] == []
    )


@pytest.mark.parametrize("content", ["", "red,green\n", "\x89PNG\r\n\x1a\n"])
def test_a_file_that_is_no_image_is_refused_in_one_sentence(
    content: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "frame.png"
    path.write_text(content, "latin-1")
    assert str(path) in error_of(capsys, path)


def test_unknown_colours_are_refused(frame: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in ("green", "green,blu", "green,blue,red", ","):
        assert "--choose must be two of red, green" in error_of(capsys, frame, "--choose", words)


def test_both_balls_of_the_da_vinci_image_are_detected(capsys: pytest.CaptureFixture[str]) -> None:
    if not ARM_RECORDING.exists():
        pytest.skip("../shared/data is not here")
    rig = ROOT / "examples/davinci.toml"
    for frame in sorted((ARM_RECORDING / "frames").iterdir())[::12]:
        found = markers_json(capsys, frame, "--rig", rig)
        assert [each["colour"] for each in found["candidates"]][:2] == ["red", "red"]
        assert found["markers"] is not None
