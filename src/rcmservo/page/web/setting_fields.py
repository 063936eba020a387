"""Descriptions of the settings forms: fields of the dataclasses, with the text of their docstrings.

The widget ``static/widgets/settings_tab.js`` builds the forms from them.
"""

import re
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, get_type_hints

from rcmservo.config.class_registry import PART_CLASSES
from rcmservo.config.field_docs import describe_class, describe_field
from rcmservo.config.servo_json import describe_servo
from rcmservo.constraints import find_choices
from rcmservo.page.selected_settings import EDITABLE_PARTS, IMMEDIATE_PARTS
from rcmservo.servo.servo import Servo

UNIT_PATTERN = r"(?:1/mm|1/s|rad|px|mm/s|mm|s/mm²|1/rad²|s)"
"""Pattern of a unit."""
UNIT_IN_TEXT = re.compile(
    rf"(?:^|, |\()({UNIT_PATTERN}(?:, {UNIT_PATTERN})*)"
    r"(?=[.:;)]|$|, (?:positive|not negative|from|above|at most|at least))"
)
"""Pattern of the units in the docstring of a setting: "..., mm.", "..., mm, positive"
or "(rad, px, px)"."""


@dataclass(frozen=True)
class SettingField:
    """Field of a form.

    Parameters
    ----------
    name : str
        Name, as in files and on the command line.
    unit : str
        Unit of its number, or one for each of its numbers; empty if it has none.
    description : str
        Description.
    default : Any
        Default.
    choices : list[str]
        Allowed values of a text; empty for other types.
    """

    name: str
    unit: str
    description: str
    default: Any
    choices: list[str]


def list_fields(kind: type[Any]) -> list[SettingField]:
    """Return the fields of a settings dataclass."""
    if not is_dataclass(kind):
        return []
    defaults, types = kind(), get_type_hints(kind, include_extras=True)
    return [
        SettingField(
            name=name,
            unit=find_unit(describe_field(kind, name)),
            description=describe_field(kind, name),
            default=getattr(defaults, name),
            choices=list(find_choices(types[name])),
        )
        for name in (field.name for field in fields(kind))
    ]


def find_unit(text: str) -> str:
    """Return the first unit in a text, or ""."""
    match = UNIT_IN_TEXT.search(text)
    return match[1] if match else ""


def build_forms(selected_servo: Servo, active_servo: Servo | None) -> list[dict[str, Any]]:
    """Return a form for each part that may change, for JSON.

    Each form has the kinds of the part with their fields, and the selected and active settings.
    """
    active = None if active_servo is None else describe_servo(active_servo)
    selected = describe_servo(selected_servo)
    return [
        {
            "part": part,
            "title": (part[0].upper() + part[1:]).replace("_rcm", " RCM").replace("_", " "),
            "immediate": part in IMMEDIATE_PARTS,
            "kinds": {
                name: {
                    "description": " ".join(describe_class(kind).split()),
                    "fields": [vars(field) for field in list_fields(kind)],
                }
                for name, kind in PART_CLASSES[part].items()
            },
            "selected": selected[part],
            "active": None if active is None else active[part],
        }
        for part in EDITABLE_PARTS
    ]
