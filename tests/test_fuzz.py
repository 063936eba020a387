"""Malformed rig and target files: refused with a sentence, or read correctly."""

from pathlib import Path

import fuzz
import pytest
from hypothesis import settings

import rcmservo as rs
from rcmservo.config.rig_file import RigDescription, load_rig_file
from rcmservo.sim.rig_file import read_rig_settings


def test_no_malformed_input_gives_a_traceback_a_hang_or_invalid_data() -> None:
    """Try 1000 inputs, and 3000 with the profile `thorough`."""
    count = min(3000, 100 * settings.default.max_examples)
    tried = fuzz.campaign(count, seed=1)
    assert [what for what, _ in tried.failures] == []
    for kind in ("rig", "target"):
        for how in ("accepted", "refused"):
            assert tried.counts[f"{kind} {how}"] > count / 20


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[tool]\n" + "a." * 32_000 + "b = 1", "a line of more than 1000 characters"),
        ("a = " + "[" * 950, "nested too deeply"),
        ("[tool]\nkind = 'rigid'\nspacing = " + "9" * 900, "tool.spacing must be a finite number"),
        (
            "[tool]\nkind = 'rigid'\nspacing = 0x" + "f" * 900,
            "tool.spacing must be a finite number",
        ),
        ("[tool]\nkind = ['rigid']", "tool.kind must be one of rigid, scaled, got ['rigid']"),
        ('[gate]\n"a\\nb" = 1', r"gate.'a\nb' must be left out"),
        ("[gate]\nlatency = nan", "gate.latency must be a finite number, got nan"),
        (
            "[thresholds]\nmax_jump_px = 0.0",
            "thresholds.max_jump_px must be a positive number of px",
        ),
        ("[thresholds]\nmax_jump_pxs = 1.0", "did you mean max_jump_px?"),
        ("[appearance]\nmarker_radii = [1.0, 2.0]", "appearance.marker_radii must be left out"),
    ],
)
def test_inputs_that_once_gave_a_traceback_a_hang_or_no_message_are_refused(
    text: str, reason: str, tmp_path: Path
) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(rs.RcmServoError) as refused:
        read_rig_settings(load_rig_file(path))
    assert reason in str(refused.value)
    assert str(refused.value).isprintable()


def test_thresholds_are_read_and_omitted_ones_have_their_defaults(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text("[thresholds]\nmax_jump_px = 6.0\n[markers]\ncolour_1 = 'red'\n")
    lab = load_rig_file(path)
    assert lab.thresholds == rs.Thresholds(max_jump_px=6.0)
    assert (lab.markers.colour_1, lab.markers.radius_1) == (
        "red",
        RigDescription().markers.radius_1,
    )


def test_a_device_file_is_not_a_rig_file() -> None:
    with pytest.raises(rs.UnusableFile, match="is not a file"):
        load_rig_file(Path("/dev/zero"))
