"""Rig files: the rig that the file describes, or one error."""

import contextlib
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import rcmservo as rs
from conftest import ROOT
from rcmservo.config.class_registry import MECHANISMS
from rcmservo.config.rig_file import RigDescription, decode_rig_tables, load_rig_file
from rcmservo.config.strict_decoding import decode_settings
from rcmservo.hardware.device_kinds import ARM_KINDS, CAMERA_KINDS
from rcmservo.sim import Appearance, Drive, SceneSettings
from rcmservo.sim.rig_file import CameraSection, read_rig_settings
from rcmservo.tracking import MarkerAppearance

SECTIONS: dict[str, type[Any]] = {
    "gate": rs.Gate,
    "markers": MarkerAppearance,
    "camera": CameraSection,
    "drive": Drive,
    "appearance": Appearance,
    "scene": SceneSettings,
}
ARBITRARY_VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=5),
    st.lists(st.floats(), max_size=4),
    st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
)


def test_the_da_vinci_rig_matches_its_recording() -> None:
    lab = load_rig_file(ROOT / "examples/davinci.toml")
    assert lab.mechanism == rs.PitchYawRcm(
        rs.JointLimits((-1.588, -0.925, 90.0), (1.588, 0.925, 240.0)), -15.6
    )
    assert lab.tool == rs.RigidTool(spacing=50.0, offset=-67.0)
    assert lab.markers == MarkerAppearance("red", "red", 12.0, 10.0)
    settings = read_rig_settings(lab)
    assert (settings.width, settings.height) == (800, 600)
    assert settings.appearance.marker_radii == (12.0, 10.0)


def test_an_empty_file_gives_the_built_in_rig(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text("")
    assert load_rig_file(tmp_path / "rig.toml") == RigDescription()


def test_every_key_of_every_section_is_accepted(tmp_path: Path) -> None:
    for name, cls in SECTIONS.items():
        for f in fields(cls):
            value = getattr(cls(), f.name)
            if value is not None:
                assert decode_settings(cls, {f.name: value}, name) == cls()


@given(data=st.data())
def test_an_arbitrary_value_in_any_field_gives_settings_or_one_error(data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(sorted(SECTIONS)))
    key = data.draw(st.sampled_from([f.name for f in fields(SECTIONS[name])]))
    value = data.draw(ARBITRARY_VALUES)
    try:
        made = decode_settings(SECTIONS[name], {key: value}, name)
    except rs.RcmServoError as error:
        assert "\n" not in str(error) or isinstance(value, str)
    else:
        assert isinstance(made, SECTIONS[name])


@given(st.binary(max_size=60))
def test_arbitrary_bytes_give_a_rig_or_an_error(
    tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    path = tmp_path_factory.mktemp("rig") / "rig.toml"
    path.write_bytes(data)
    with contextlib.suppress(rs.RcmServoError):
        assert isinstance(load_rig_file(path), RigDescription)


@pytest.mark.parametrize(
    ("one", "other"), [(1e-300, 1e300), (1e300, 1e-300), (4.0, 0.0), (4.0, 5e-324)]
)
def test_radii_whose_ratio_no_float_can_hold_are_refused(one: float, other: float) -> None:
    with pytest.raises(rs.BadInput, match="radius"):
        decode_settings(MarkerAppearance, {"radius_1": one, "radius_2": other}, "markers")


OPTIONAL_TABLES: dict[str, dict[str, Any]] = {
    "mechanism": {"insertion_zero": -15.6},
    "tool": {"spacing": 50.0},
    **{name: {} for name in (*SECTIONS, "thresholds")},
}
"""Every optional table of a rig file, with its required keys."""
DEVICES: dict[str, Any] = {"arm": ARM_KINDS, "camera": CAMERA_KINDS}
REQUIRED_KEYS: dict[str, dict[str, Any]] = {
    "arm": {"kind": "galil", "address": "127.0.0.1", "counts": [1e4, 1e4, 1e2]},
    "camera": {"kind": "opencv", "source": "0"},
}
"""Tables of devices, which have no default, with their required keys."""


def decode_all(tables: dict[str, Any]) -> RigDescription:
    """Return the rig of a rig file after decoding all of its sections."""
    lab = decode_rig_tables(tables)
    for name, kinds in DEVICES.items():
        if name in lab.devices:
            lab.decode_device_settings(name, kinds)
    read_rig_settings(lab)
    return lab


@pytest.mark.parametrize("name", OPTIONAL_TABLES)
def test_keys_that_a_table_omits_have_the_built_in_values(name: str) -> None:
    assert decode_all({name: {}}) == replace(
        RigDescription(), simulation=decode_rig_tables({name: {}}).simulation
    )
    made = getattr(decode_all({name: OPTIONAL_TABLES[name]}), name, None)
    assert made is None or made == replace(getattr(RigDescription(), name), **OPTIONAL_TABLES[name])


@pytest.mark.parametrize("kind", MECHANISMS)
def test_every_kind_of_mechanism_has_its_own_default_limits(kind: str) -> None:
    assert decode_rig_tables({"mechanism": {"kind": kind}}).mechanism == MECHANISMS[kind]()


def test_a_tool_of_another_kind_does_not_inherit_the_built_in_values() -> None:
    with pytest.raises(rs.BadInput, match=r"tool\.scale must be given"):
        decode_rig_tables({"tool": {"kind": "scaled", "offset": 1.0}})


@pytest.mark.parametrize(
    ("name", "table", "meant"),
    [
        ("mechanism", {"insertion_zeros": 1.0}, "insertion_zero"),
        ("tool", {"spacings": 50.0}, "spacing"),
        ("tool", {"kind": "scaled", "scales": 1.2}, "scale"),
        ("markers", {"colour_11": "red"}, "colour_1"),
        ("gate", {"speeds": [1.0, 1.0, 1.0]}, "speed"),
        ("thresholds", {"arm_timeouts": 0.1}, "arm_timeout"),
        ("camera", {"widths": 640}, "width"),
        ("drive", {"delays": 0.1}, "delay"),
        ("appearance", {"lights": 1.0}, "light"),
        ("scene", {"travels": 1.0}, "travel"),
        ("arm", {"kind": "galil", "adress": "127.0.0.1"}, "address"),
        ("arm", {"adress": "127.0.0.1"}, "address"),
        ("camera", {"kind": "opencv", "sources": "0"}, "source"),
        ("camera", {"kindd": "opencv"}, "kind"),
        ("camera", {"kindd": "opencv", "source": "0"}, "kind"),
        ("tool", {"kindd": "rigid"}, "kind"),
        ("tool", {"kindd": "rigid", "spacing": 50.0}, "kind"),
        ("mechanism", {"kindd": "spherical"}, "kind"),
        ("arm", {"kindd": "galil"}, "kind"),
        ("arm", {"kindd": "galil", "address": "127.0.0.1"}, "kind"),
    ],
)
def test_an_unknown_key_of_any_table_is_reported_with_the_intended_key(
    name: str, table: dict[str, Any], meant: str
) -> None:
    unknown = next(key for key in table if key not in (meant, "kind", "source", "address"))
    with pytest.raises(rs.BadInput) as refused:
        decode_all({name: table})
    assert refused.value.field == f"{name}.{unknown}"
    assert f"(did you mean {meant}?)" in refused.value.expected


@pytest.mark.parametrize("name", ["arm", "camera"])
def test_a_device_has_no_kind_by_default(name: str) -> None:
    table = {key: value for key, value in REQUIRED_KEYS[name].items() if key != "kind"}
    with pytest.raises(rs.BadInput, match=rf"{name}\.kind must be one of "):
        decode_rig_tables({name: table}).decode_device_settings(name, DEVICES[name])
