"""Rig file: TOML description of a robot, its devices and the settings of its simulation.

Each section of the file is one settings dataclass, and its keys are the fields of this class. The
sections of the robot are the fields of `RigDescription`, decoded and checked when the file is read.
The sections of devices and simulation stay tables until a command needs them.
"""

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields, make_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

from rcmservo.config import toml_json_parsing
from rcmservo.config.atomic_files import read_limited
from rcmservo.config.class_registry import (
    KIND_KEY,
    MECHANISMS,
    PART_CLASSES,
    decode_kind,
    find_class,
)
from rcmservo.config.strict_decoding import decode_settings, expect_one_of, quote_key
from rcmservo.errors import BadInput
from rcmservo.geometry.kinematics import JointLimits, Kinematics, SphericalRcm
from rcmservo.geometry.tool import Tool
from rcmservo.safety.gate import Gate
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.servo import Servo, make_default_tool
from rcmservo.tracking import MarkerAppearance

MAX_RIG_FILE_BYTES = 64 * 1024
DEVICE_SECTIONS = ("arm", "camera", "tracker")
"""Sections of real devices and of a user-defined tracker. A [camera] is a device if it has the key
`kind`."""
SIMULATION_SECTIONS = ("camera", "drive", "appearance", "scene", "imperfections")
"""Sections of the simulation. A [camera] without the key `kind` describes a simulated camera."""

SectionSettings = TypeVar("SectionSettings")
Tables = Mapping[str, toml_json_parsing.Table]
"""Sections of a rig file by name, as undecoded tables."""


def make_default_markers() -> MarkerAppearance:
    """Return the markers of the built-in rig: visible on red tissue, with different colours."""
    return MarkerAppearance(colour_1="green", colour_2="blue", radius_1=3.5, radius_2=3.5)


@dataclass(frozen=True)
class RigDescription:
    """Description of a rig: robot, markers, bounds, devices and simulation.

    Parameters
    ----------
    mechanism : Kinematics
        Kinematics of the arm.
    tool : Tool
        Positions of the markers on the tool.
    markers : MarkerAppearance
        Appearance of the markers, by which the tracker detects them in images.
    gate : Gate
        Bounds on every command.
    thresholds : Thresholds
        Thresholds of the checks.
    devices : Tables
        Sections of the file among `DEVICE_SECTIONS`, undecoded; `decode_device_settings` decodes
        them.
    simulation : Tables
        Sections of the file among `SIMULATION_SECTIONS`, undecoded;
        `decode_simulation_settings` decodes them.
    file : Path or None
        Rig file, next to which modules of user-defined devices may be; None without a file.
    """

    mechanism: Kinematics = field(default_factory=SphericalRcm)
    tool: Tool = field(default_factory=make_default_tool)
    markers: MarkerAppearance = field(default_factory=make_default_markers)
    gate: Gate = field(default_factory=Gate)
    thresholds: Thresholds = field(default_factory=Thresholds)
    devices: Tables = field(default_factory=dict[str, toml_json_parsing.Table])
    simulation: Tables = field(default_factory=dict[str, toml_json_parsing.Table])
    file: Path | None = field(default=None, compare=False)

    @property
    def has_tracker(self) -> bool:
        """True if the rig file names a user-defined tracker."""
        return "tracker" in self.devices

    @property
    def tracking(self) -> MarkerAppearance | toml_json_parsing.Table:
        """Appearance of the markers, or the section of the user-defined tracker that detects them.

        A target is valid only for this appearance or tracker.
        """
        return self.devices.get("tracker", self.markers)

    def make_servo(self, **parts: Any) -> Servo:
        """Return a servo for this rig; of the `METHOD_PARTS`, omitted ones have their defaults."""
        robot_parts = {p: getattr(self, p) for p in PART_CLASSES if p not in METHOD_PARTS}
        return Servo(**robot_parts, **parts)

    def decode_device_settings(self, name: str, kinds: Mapping[str, type[Any]]) -> Any:
        """Return the settings of a device, of the class that the key `kind` of its section names.

        Parameters
        ----------
        name : str
            Name of the section.
        kinds : Mapping[str, type]
            Permitted classes by name.

        Returns
        -------
        object
            Settings, an instance of one of the classes.

        Raises
        ------
        BadInput
            If the section is missing or invalid.
        """
        table = self.devices.get(name, self.simulation.get(name))
        if table is None:
            raise BadInput(f"section {name}", None, f"given, with a kind: {' or '.join(kinds)}")
        return decode_kind(kinds, table, name)

    def decode_simulation_settings(
        self, name: str, settings_class: type[SectionSettings], **known: object
    ) -> SectionSettings:
        """Return the settings in a section of the simulation; a missing section has the defaults.

        Parameters
        ----------
        name : str
            Name of the section.
        settings_class : type
            Dataclass of the settings.
        **known : object
            Values that the robot's sections determine; this section must omit their keys.

        Returns
        -------
        SectionSettings
            Instance of `settings_class`.

        Raises
        ------
        BadInput
            If the section is invalid.
        """
        table = self.simulation.get(name, {})
        for key in known:
            if key in table:
                expected = "left out: the robot's sections determine it"
                raise BadInput(f"{name}.{key}", table[key], expected)
        other_keys = (KIND_KEY,) if name in DEVICE_SECTIONS else ()
        return decode_settings(settings_class, {**table, **known}, name, other_keys)


OTHER_FIELDS = "devices", "simulation", "file"
"""Fields of `RigDescription` that are no sections."""
ROBOT_SECTIONS = tuple(f.name for f in fields(RigDescription) if f.name not in OTHER_FIELDS)
"""Sections of the robot: all other fields of `RigDescription`."""
METHOD_PARTS = tuple(part for part in PART_CLASSES if part not in ROBOT_SECTIONS)
"""Parts of a servo that no rig file describes, such as the estimator and the controller. The
command line, studies and the page set them."""


def load_rig_file(path: Path | None) -> RigDescription:
    """Return the rig in a TOML file, with built-in values where it omits them or is None."""
    return RigDescription() if path is None else decode_rig_file(path, read_rig_file(path))


def read_rig_file(path: Path) -> bytes:
    """Return the bytes of a rig file; raise `UnusableFile` if it cannot be read."""
    return read_limited(path, MAX_RIG_FILE_BYTES, "a rig file")


def decode_rig_file(path: Path, data: bytes) -> RigDescription:
    """Return the rig that the bytes of a rig file describe; errors name the file `path`."""
    with toml_json_parsing.name_file_in_errors(path, "TOML"):
        return replace(decode_rig_tables(toml_json_parsing.parse_toml(data)), file=path)


@contextmanager
def name_origin_in_errors(origin: object) -> Generator[None]:
    """Prefix the field of a `BadInput` that is raised in the context with its file or origin."""
    try:
        yield
    except BadInput as error:
        raise BadInput(f"{origin}: {error.field}", error.value, error.expected) from error


def decode_rig_tables(tables: toml_json_parsing.Table) -> RigDescription:
    """Return the rig that the sections of a rig file describe."""
    known = tuple(dict.fromkeys((*ROBOT_SECTIONS, *DEVICE_SECTIONS, *SIMULATION_SECTIONS)))
    for name, table in tables.items():
        if name not in known or not toml_json_parsing.is_table(table):
            raise BadInput(f"section {quote_key(name)}", table, expect_one_of(name, known))
    default = RigDescription()
    devices = {name: tables[name] for name in DEVICE_SECTIONS if _is_device(name, tables)}
    simulation = {
        name: tables[name] for name in SIMULATION_SECTIONS if name in tables and name not in devices
    }
    robot = {
        name: _decode_robot_section(name, tables.get(name, {}), getattr(default, name))
        for name in ROBOT_SECTIONS
    }
    return RigDescription(**robot, devices=devices, simulation=simulation)


def _is_device(name: str, tables: toml_json_parsing.Table) -> bool:
    """Return True if a section exists and describes a real device."""
    return name in tables and (name not in SIMULATION_SECTIONS or KIND_KEY in tables[name])


def _decode_robot_section(name: str, table: toml_json_parsing.Table, default: Any) -> Any:
    """Return the settings in a section of the robot; omitted values are the default ones."""
    if name == "mechanism":
        return _decode_mechanism(table, default.name)
    only_class = {name: cast(type[Any], type(default))}
    return decode_kind(PART_CLASSES.get(name, only_class), table, name, default)


def _decode_mechanism(table: toml_json_parsing.Table, default_name: str) -> Kinematics:
    """Return the mechanism in a table, of the default class if the table has no key `kind`.

    The table has the ends of `JointLimits` as keys of its own, without a subtable `limits`.
    """
    mechanism_class = find_class(MECHANISMS, table.get(KIND_KEY, default_name), "mechanism")
    values = asdict(mechanism_class().limits) | table
    values.pop(KIND_KEY, None)
    flat_class = _make_flat_mechanism_class(mechanism_class)
    flat: Any = decode_settings(flat_class, values, "mechanism", (KIND_KEY,))
    settings = {name: getattr(flat, name) for name in values}
    limits = {end.name: settings.pop(end.name) for end in fields(JointLimits)}
    decode_settings(JointLimits, limits, "mechanism")  # errors say mechanism.lower, not .limits
    return decode_settings(mechanism_class, {**settings, "limits": limits}, "mechanism")


@cache
def _make_flat_mechanism_class(mechanism_class: type[Kinematics]) -> type[Any]:
    """Return the schema of a mechanism's section, with the ends of the joint limits as fields."""
    limits = [(end.name, Any) for end in fields(JointLimits)]
    others = [(f.name, f.type, f) for f in fields(mechanism_class) if f.name != "limits"]
    return make_dataclass("Mechanism", [*limits, *others])
