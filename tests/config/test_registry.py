"""Registry: every part, class and setting of the servo is in options, records, studies and page."""

from dataclasses import fields, is_dataclass

import pytest

import rcmservo as rs
from conftest import make_laboratory
from rcmservo.cli.argument_parsing.option_introspection import list_options
from rcmservo.cli.run_options import RunOptions
from rcmservo.config.class_registry import PART_CLASSES, REGISTERED_CLASSES
from rcmservo.config.rig_file import METHOD_PARTS, RigDescription
from rcmservo.config.servo_json import describe_servo
from rcmservo.page.selected_settings import EDITABLE_PARTS
from rcmservo.page.web.setting_fields import build_forms
from rcmservo.study.plan.method import make_method

CLASSES = {kind for classes in PART_CLASSES.values() for kind in classes.values()}
METHOD_SETTINGS = {
    (kind, f.name)
    for part in METHOD_PARTS
    for kind in PART_CLASSES[part].values()
    for f in fields(kind)
}


def test_every_field_of_a_servo_except_its_rate_is_a_part_with_distinct_class_names() -> None:
    assert [*PART_CLASSES, "rate"] == [f.name for f in fields(rs.Servo)]
    assert set(REGISTERED_CLASSES) <= CLASSES and all(map(is_dataclass, CLASSES))
    assert sum(map(len, PART_CLASSES.values())) == len(CLASSES)


def test_every_part_belongs_to_the_rig_file_or_to_the_method() -> None:
    robot = {f.name for f in fields(RigDescription)} & set(PART_CLASSES)
    assert robot | set(METHOD_PARTS) == set(PART_CLASSES) and not robot & set(METHOD_PARTS)
    assert (
        set(EDITABLE_PARTS)
        == set(METHOD_PARTS)
        == set(make_method("a", estimator=rs.DltEstimator()).parts)
    )


def test_every_setting_of_the_method_is_an_option_and_a_field_of_the_page() -> None:
    assert {(one.owner, one.field) for one in list_options(RunOptions)} > METHOD_SETTINGS
    page_fields = {
        (PART_CLASSES[form["part"]][name], field["name"])
        for form in build_forms(make_laboratory().servo(), None)
        for name, kind in form["kinds"].items()
        for field in kind["fields"]
    }
    assert page_fields == METHOD_SETTINGS


@pytest.mark.parametrize("part", METHOD_PARTS)
def test_every_setting_of_a_part_is_in_records(part: str) -> None:
    for kind in PART_CLASSES[part].values():
        servo = rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0), **{part: kind()})
        assert set(describe_servo(servo)[part]) == {"kind", *(f.name for f in fields(kind))}
