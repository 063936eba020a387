"""A laboratory described in a TOML file: what the robot knows of itself, its devices, and what a
simulation of it needs.

The file's sections are the settings dataclasses, its keys their fields. Everything is checked; see
decode.py.
"""

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar

from rcmservo.config import texts
from rcmservo.config.decode import decode, key_of
from rcmservo.config.files import read_small
from rcmservo.config.registry import KIND, MECHANISMS, PARTS, TOOLS, decode_kind, find_class
from rcmservo.errors import BadInput
from rcmservo.guard.gate import Gate
from rcmservo.guard.thresholds import Thresholds
from rcmservo.method.kinematics import JointLimits, Kinematics, SphericalRcm
from rcmservo.method.tool import RigidTool, Tool
from rcmservo.servo.servo import Servo
from rcmservo.tracking import MarkerLook

MAX_SIZE = 64 * 1024
ROBOT_SECTIONS = ("mechanism", "tool", "markers", "gate", "thresholds")
DEVICE_SECTIONS = ("arm", "camera")
SIMULATION_SECTIONS = ("camera", "drive", "look", "scene")
"""A [camera] that names a kind is a device; another one is simulated."""

Section = TypeVar("Section")
Tables = Mapping[str, texts.Table]
"""A rig file's sections as they are written."""


def default_markers() -> MarkerLook:
    """The built-in rig's markers: seen well on red tissue and told apart by colour."""
    return MarkerLook(colour_1="green", colour_2="blue", radius_1=3.5, radius_2=3.5)


@dataclass(frozen=True)
class Lab:
    """A laboratory: the robot's knowledge of itself, how its markers look, and the sections for a
    simulation of it."""

    mechanism: Kinematics = field(default_factory=SphericalRcm)
    """The arm's kinematics."""
    tool: Tool = field(default_factory=lambda: RigidTool(spacing=30.0))
    """Where the markers are on the tool."""
    markers: MarkerLook = field(default_factory=default_markers)
    """What the markers look like, so that they are found in pictures."""
    gate: Gate = field(default_factory=Gate)
    """Bounds on every command."""
    thresholds: Thresholds = field(default_factory=Thresholds)
    """From where on something is a fault."""
    devices: Tables = field(default_factory=dict[str, texts.Table])
    """Those of DEVICE_SECTIONS that the file has, as they are written; `device` reads them."""
    simulation: Tables = field(default_factory=dict[str, texts.Table])
    """Those of SIMULATION_SECTIONS that the file has, as they are written; `section` reads them."""

    def servo(self, **parts: Any) -> Servo:
        """A servo of this laboratory with these METHOD_PARTS; those left out are the default
        ones."""
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
        and left out in the file."""
        table = self.simulation.get(name, {})
        for key in known:
            if key in table:
                raise BadInput(
                    f"{name}.{key}", table[key], "left out: the robot's sections tell it"
                )
        others = (KIND,) if name in DEVICE_SECTIONS else ()
        return decode(kind, {**table, **known}, name, others)


METHOD_PARTS = tuple(part for part in PARTS if part not in {f.name for f in fields(Lab)})
"""Parts of a servo that no rig file describes: the method's, which the command line, studies and
the page set."""


def load_lab(path: Path | None) -> Lab:
    """The laboratory in a TOML file; what the file leaves out, and all without a file, is as in the
    built-in one."""
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
            raise BadInput(
                f"section {key_of(name)}", table, f"one of the sections {', '.join(known)}"
            )
    default = Lab()
    devices = {name: tables[name] for name in DEVICE_SECTIONS if _is_device(name, tables)}
    looks = {**asdict(default.markers), **tables.get("markers", {})}
    return Lab(
        mechanism=_mechanism(tables.get("mechanism", {}), default.mechanism.name),
        tool=decode_kind(TOOLS, tables.get("tool", {}), "tool", default.tool),
        markers=decode(MarkerLook, looks, "markers"),
        gate=decode(Gate, tables.get("gate", {}), "gate"),
        thresholds=decode(Thresholds, tables.get("thresholds", {}), "thresholds"),
        devices=devices,
        simulation={
            name: tables[name]
            for name in SIMULATION_SECTIONS
            if name in tables and name not in devices
        },
    )


def _is_device(name: str, tables: texts.Table) -> bool:
    return name in tables and (name == "arm" or KIND in tables[name])


@dataclass(frozen=True)
class _Mechanism:
    """[mechanism]: the kind, its limits' ends and the insertion's zero."""

    kind: str
    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    insertion_zero: float = 0.0


def _mechanism(table: texts.Table, usual: str) -> Kinematics:
    """The arm of a table, of the kind with the name `usual` where it names none."""
    name = table.get(KIND, usual)
    kind = find_class(MECHANISMS, name, "mechanism")
    told = decode(_Mechanism, {KIND: name, **asdict(kind().limits), **table}, "mechanism")
    limits = decode(JointLimits, {"lower": told.lower, "upper": told.upper}, "mechanism")
    rest = {"limits": asdict(limits), "insertion_zero": told.insertion_zero}
    return decode(kind, rest, "mechanism")
