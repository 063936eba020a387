"""Public names of `rs.hardware`: they exist, and every kind of a rig file is among them."""

import pytest

import rcmservo as rs
from rcmservo.hardware.device_kinds import DRIVERS


@pytest.mark.parametrize("name", rs.hardware.__all__)
def test_every_public_name_can_be_used(name: str) -> None:
    assert getattr(rs.hardware, name).__name__ == name
    assert name in (rs.hardware.__doc__ or "")


def test_every_kind_of_device_has_its_settings_and_its_driver() -> None:
    public = set(rs.hardware.__all__)
    assert {kind.__name__ for kind in DRIVERS} <= public
    assert {driver.partition(":")[2] for driver in DRIVERS.values()} <= public


def test_the_program_of_the_documentation_is_valid() -> None:
    settings = rs.hardware.GalilSettings(address="192.168.1.7", counts=(2e5, 2e5, 1e3))
    assert settings.axes == "ABC"
