"""Rig and target files as nobody should write them are refused with a sentence, or taken for what
they say.
"""

from pathlib import Path

import fuzz
import pytest

import rcmservo as rs
from rcmservo.config.rig_file import Lab, load_lab
from rcmservo.sim.rig_file import read_rig_settings


def test_no_odd_input_gives_a_traceback_a_hang_or_wrong_data() -> None:
    tried = fuzz.campaign(3000, seed=1)
    assert [what for what, _ in tried.failures] == []
    assert (
        min(
            tried.counts[f"{kind} {how}"]
            for kind in ("rig", "target")
            for how in ("accepted", "refused")
        )
        > 150
    )


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
        ("[thresholds]\njump = 0.0", "thresholds.jump must be a positive number of px"),
        ("[thresholds]\njumps = 1.0", "did you mean jump?"),
        ("[look]\nmarker_radii = [1.0, 2.0]", "look.marker_radii must be left out"),
    ],
)
def test_what_once_was_a_traceback_a_hang_or_passed_over_is_a_sentence(
    text: str, reason: str, tmp_path: Path
) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(rs.RcmServoError) as refused:
        read_rig_settings(load_lab(path))
    assert reason in str(refused.value)
    assert str(refused.value).isprintable()


def test_thresholds_are_read_and_what_is_left_out_stays_as_built_in(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text("[thresholds]\njump = 6.0\n[markers]\ncolour_1 = 'red'\n")
    lab = load_lab(path)
    assert lab.thresholds == rs.Thresholds(jump=6.0)
    assert (lab.markers.colour_1, lab.markers.radius_1) == ("red", Lab().markers.radius_1)


def test_a_pipe_or_a_device_is_no_rig_file() -> None:
    with pytest.raises(rs.UnusableFile, match="is not a file"):
        load_lab(Path("/dev/zero"))
