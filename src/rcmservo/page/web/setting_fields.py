"""Forms for the settings: fields of the dataclasses, with the text of their docstrings."""

import re
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, get_type_hints

from rcmservo.config.field_docs import describe_class, describe_field
from rcmservo.config.registry import PART_CLASSES
from rcmservo.config.servo_json import describe_servo
from rcmservo.constraints import choices_of
from rcmservo.page.settings import EDITABLE_PARTS, IMMEDIATE_PARTS
from rcmservo.servo.servo import Servo

UNIT_PATTERN = r"(?:1/s|rad|px|mm/s|mm|s/mm²|1/rad²|s)"
UNIT_IN_TEXT = re.compile(
    rf"(?:^|, |\()({UNIT_PATTERN}(?:, {UNIT_PATTERN})*)(?=[.:;)]|$| whatever)"
)
"""Pattern of a unit in the docstring of a setting."""


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
            name=f.name,
            unit=find_unit(describe_field(kind, f.name)),
            description=describe_field(kind, f.name),
            default=getattr(defaults, f.name),
            choices=list(choices_of(types[f.name])),
        )
        for f in fields(kind)
    ]


def find_unit(text: str) -> str:
    """Return the first unit in a text, or ""."""
    found = UNIT_IN_TEXT.search(text)
    return found[1] if found else ""


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
                    "description": _one_line(kind),
                    "fields": [vars(field) for field in list_fields(kind)],
                }
                for name, kind in PART_CLASSES[part].items()
            },
            "selected": selected[part],
            "active": None if active is None else active[part],
        }
        for part in EDITABLE_PARTS
    ]


def _one_line(kind: type[Any]) -> str:
    return " ".join(describe_class(kind).split())
