"""A laboratory described in a TOML file: what the robot knows of itself, its devices, and what a
simulation of it needs.

The file's sections are the settings dataclasses, its keys their fields. Everything is checked; see
decode.py.
"""

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields, make_dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

from rcmservo.config import texts
from rcmservo.config.atomic_files import read_small
from rcmservo.config.registry import KIND, MECHANISMS, PARTS, decode_kind, find_class
from rcmservo.config.strict_decoding import decode, instead, key_of
from rcmservo.errors import BadInput
from rcmservo.geometry.kinematics import JointLimits, Kinematics, SphericalRcm
from rcmservo.geometry.tool import RigidTool, Tool
from rcmservo.safety.gate import Gate
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.servo import Servo
from rcmservo.tracking import MarkerAppearance

MAX_SIZE = 64 * 1024
DEVICE_SECTIONS = ("arm", "camera")
SIMULATION_SECTIONS = ("camera", "drive", "look", "scene")
"""A [camera] that names a kind is a device; another one is simulated."""

Section = TypeVar("Section")
Tables = Mapping[str, texts.Table]
"""A rig file's sections as they are written."""


def default_markers() -> MarkerAppearance:
    """The built-in rig's markers: seen well on red tissue and told apart by colour."""
    return MarkerAppearance(colour_1="green", colour_2="blue", radius_1=3.5, radius_2=3.5)


@dataclass(frozen=True)
class Lab:
    """A laboratory: the robot's knowledge of itself, how its markers look, and the sections for a
    simulation of it.

    Parameters
    ----------
    mechanism : Kinematics
        The arm's kinematics.
    tool : Tool
        Where the markers are on the tool.
    markers : MarkerLook
        What the markers look like, so that they are found in pictures.
    gate : Gate
        Bounds on every command.
    thresholds : Thresholds
        From where on something is a fault.
    devices : Tables
        Those of DEVICE_SECTIONS that the file has, as they are written; `device` reads them.
    simulation : Tables
        Those of SIMULATION_SECTIONS that the file has, as they are written; `section` reads them.
    """

    mechanism: Kinematics = field(default_factory=SphericalRcm)
    tool: Tool = field(default_factory=lambda: RigidTool(spacing=30.0))
    markers: MarkerAppearance = field(default_factory=default_markers)
    gate: Gate = field(default_factory=Gate)
    thresholds: Thresholds = field(default_factory=Thresholds)
    devices: Tables = field(default_factory=dict[str, texts.Table])
    simulation: Tables = field(default_factory=dict[str, texts.Table])

    def servo(self, **parts: Any) -> Servo:
        """A servo of this laboratory with these METHOD_PARTS; those left out are the default
        ones.
        """
        robot = {part: getattr(self, part) for part in PARTS if part not in METHOD_PARTS}
        return Servo(**robot, **parts)

    def device(self, name: str, kinds: Mapping[str, type[Any]]) -> Any:
        """The settings of a device, of the class that its section's `kind` names."""
        table = self.devices.get(name, self.simulation.get(name))
        if table is None:
            raise BadInput(f"section {name}", None, f"given, with a kind: {' or '.join(kinds)}")
        return decode_kind(kinds, table, name)

    def section(self, name: str, kind: type[Section], **known: object) -> Section:
        """A section for the simulation as its settings; what the robot knows already is `known`,
        and left out in the file.
        """
        table = self.simulation.get(name, {})
        for key in known:
            if key in table:
                raise BadInput(
                    f"{name}.{key}", table[key], "left out: the robot's sections tell it"
                )
        others = (KIND,) if name in DEVICE_SECTIONS else ()
        return decode(kind, {**table, **known}, name, others)


ROBOT_SECTIONS = tuple(f.name for f in fields(Lab) if f.name not in ("devices", "simulation"))
METHOD_PARTS = tuple(part for part in PARTS if part not in {f.name for f in fields(Lab)})
"""Parts of a servo that no rig file describes: the method's, which the command line, studies and
the page set."""


def load_lab(path: Path | None) -> Lab:
    """The laboratory in a TOML file; what the file leaves out, and all without a file, is as in the
    built-in one.
    """
    return Lab() if path is None else lab_of(path, bytes_of(path))


def bytes_of(path: Path) -> bytes:
    """What a rig file holds."""
    return read_small(path, MAX_SIZE, "a rig file")


def lab_of(path: Path, data: bytes) -> Lab:
    """The laboratory that the bytes of a rig file describe."""
    with texts.reading(path, "TOML"):
        return lab_from(texts.toml(data))


@contextmanager
def told_with(place: object) -> Generator[None]:
    """What is wrong with a value that is used in here is told with its file, or another place."""
    try:
        yield
    except BadInput as error:
        raise BadInput(f"{place}: {error.field}", error.value, error.right) from error


def lab_from(tables: texts.Table) -> Lab:
    """The laboratory that the sections of a rig file describe."""
    known = tuple(dict.fromkeys((*ROBOT_SECTIONS, *DEVICE_SECTIONS, *SIMULATION_SECTIONS)))
    for name, table in tables.items():
        if name not in known or not texts.is_table(table):
            raise BadInput(f"section {key_of(name)}", table, instead(name, known))
    default = Lab()
    devices = {name: tables[name] for name in DEVICE_SECTIONS if _is_device(name, tables)}
    simulated = {
        name: tables[name] for name in SIMULATION_SECTIONS if name in tables and name not in devices
    }
    robot = {
        name: _section(name, tables.get(name, {}), getattr(default, name))
        for name in ROBOT_SECTIONS
    }
    return Lab(**robot, devices=devices, simulation=simulated)


def _is_device(name: str, tables: texts.Table) -> bool:
    return name in tables and (name == "arm" or KIND in tables[name])


def _section(name: str, table: texts.Table, default: Any) -> Any:
    """Return the settings in a section of the robot's; those left out are the default ones."""
    if name == "mechanism":
        return _mechanism(table, default.name)
    only = {name: cast(type[Any], type(default))}
    return decode_kind(PARTS.get(name, only), table, name, default)


def _mechanism(table: texts.Table, usual: str) -> Kinematics:
    """The arm of a table, of the kind with the name `usual` where it names none."""
    kind = find_class(MECHANISMS, table.get(KIND, usual), "mechanism")
    given = {name: value for name, value in table.items() if name != KIND}
    given = {**asdict(kind().limits), **given}
    flat: Any = decode(_flat(kind), given, "mechanism", others=(KIND,))
    rest = {name: getattr(flat, name) for name in given}
    limits = {end.name: rest.pop(end.name) for end in fields(JointLimits)}
    decode(JointLimits, limits, "mechanism")
    return decode(kind, {**rest, "limits": limits}, "mechanism")


@cache
def _flat(kind: type[Kinematics]) -> type[Any]:
    """A mechanism's settings as its section has them: the ends of the limits are two of them."""
    others = [(f.name, f.type, f) for f in fields(kind) if f.name != "limits"]
    return make_dataclass("Mechanism", [*((f.name, Any) for f in fields(JointLimits)), *others])
