"""A rig file becomes exactly the laboratory it describes, or one sentence."""

import contextlib
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import rcmservo as rs
from conftest import ROOT
from rcmservo.config.decode import decode
from rcmservo.config.rig_file import Lab, load_lab
from rcmservo.sim import Drive, Look, SceneSettings
from rcmservo.sim.rig_file import CameraSection, rig_settings
from rcmservo.tracking import MarkerLook

SECTIONS: dict[str, type[Any]] = {
    "gate": rs.Gate,
    "markers": MarkerLook,
    "camera": CameraSection,
    "drive": Drive,
    "look": Look,
    "scene": SceneSettings,
}
JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=5),
    st.lists(st.floats(), max_size=4),
    st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
)


def test_the_da_vinci_rig_is_what_its_recording_says() -> None:
    lab = load_lab(ROOT / "examples/davinci.toml")
    assert lab.mechanism == rs.PitchYawRcm(
        rs.JointLimits((-1.588, -0.925, 90.0), (1.588, 0.925, 240.0)), -15.6
    )
    assert lab.tool == rs.RigidTool(spacing=50.0, offset=-67.0)
    assert lab.markers == MarkerLook("red", "red", 12.0, 10.0)
    settings = rig_settings(lab)
    assert (settings.width, settings.height) == (800, 600)
    assert settings.look.marker_radii == (12.0, 10.0)


def test_an_empty_file_is_the_built_in_laboratory(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text("")
    assert load_lab(tmp_path / "rig.toml") == Lab()


def test_every_key_of_every_section_is_taken(tmp_path: Path) -> None:
    for name, cls in SECTIONS.items():
        for f in fields(cls):
            value = getattr(cls(), f.name)
            if value is not None:
                assert decode(cls, {f.name: value}, name) == cls()


@given(data=st.data())
def test_junk_in_any_field_gives_one_sentence_or_settings(data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(sorted(SECTIONS)))
    key = data.draw(st.sampled_from([f.name for f in fields(SECTIONS[name])]))
    value = data.draw(JUNK)
    try:
        made = decode(SECTIONS[name], {key: value}, name)
    except rs.RcmServoError as error:
        assert "\n" not in str(error) or isinstance(value, str)
    else:
        assert isinstance(made, SECTIONS[name])


@given(st.binary(max_size=60))
def test_any_bytes_are_a_laboratory_or_refused(
    tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    path = tmp_path_factory.mktemp("rig") / "rig.toml"
    path.write_bytes(data)
    with contextlib.suppress(rs.RcmServoError):
        assert isinstance(load_lab(path), Lab)


@pytest.mark.parametrize(
    ("one", "other"), [(1e-300, 1e300), (1e300, 1e-300), (4.0, 0.0), (4.0, 5e-324)]
)
def test_radii_whose_ratio_no_float_can_hold_are_refused(one: float, other: float) -> None:
    with pytest.raises(rs.BadInput, match="radius"):
        decode(MarkerLook, {"radius_1": one, "radius_2": other}, "markers")
