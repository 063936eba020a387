"""User-defined arms, cameras and trackers, which a rig file names as module:class.

The class needs only the methods of the protocol `Arm`, `Camera` or `Tracker`. The other keys of its
section are the arguments of its constructor. `UserArm` and `UserCamera` supply what a live run
needs in addition.
"""

import inspect
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, make_dataclass
from typing import Any, ClassVar

from rcmservo.bringup.axis_wiring import Wiring
from rcmservo.config.class_registry import KIND_KEY
from rcmservo.config.rig_file import RigDescription, name_origin_in_errors
from rcmservo.config.strict_decoding import decode_settings
from rcmservo.config.toml_json_parsing import Table
from rcmservo.config.user_classes import CLASS_PATH, import_user_object
from rcmservo.errors import BadInput, Stopped, require, shorten_to_line
from rcmservo.interfaces import Arm, ArmMeasurement, Camera, Command, Floats, Frame, Tracker
from rcmservo.live.device_protocols import LabArm, LabCamera, NotReady
from rcmservo.loop.run_result import CameraStatistics

PROTOCOLS: Mapping[str, type[Any]] = {"arm": Arm, "camera": Camera, "tracker": Tracker}
"""Protocol that the class of each section implements."""
LATENCY_KEY = "latency"
"""Argument of a camera's constructor that holds its latency in s, if it has one."""


@dataclass(frozen=True)
class UserDevice:
    """User-defined class that a rig file names, with the arguments of its constructor.

    Parameters
    ----------
    section : str
        Section of the rig file: arm, camera or tracker.
    kind : str
        Name of the class as module:class.
    device_class : type
        Imported class.
    arguments : Mapping[str, Any]
        Arguments of the constructor, decoded to its annotated types.
    """

    wiring: ClassVar[Wiring] = Wiring((1.0, 1.0, 1.0), key="")
    """Joints of a user-defined arm: it reports rad, rad, mm, and has no counts in the rig file."""

    section: str
    kind: str
    device_class: type[Any]
    arguments: Mapping[str, Any]

    @property
    def latency(self) -> float | None:
        """Latency in s that a camera's constructor receives; None if it has no such argument."""
        parameter = inspect.signature(self.device_class).parameters.get(LATENCY_KEY)
        if parameter is None:
            return None
        latency = self.arguments.get(LATENCY_KEY, parameter.default)
        return float(latency) if isinstance(latency, int | float) else 0.0

    def construct(self) -> Any:
        """Return a new instance of the class.

        Raises
        ------
        BadInput
            If the constructor raises an error.
        """
        try:
            return self.device_class(**self.arguments)
        except Stopped:
            raise
        except BadInput as error:
            name = error.field.removeprefix(f"{self.section}.")
            raise BadInput(f"{self.section}.{name}", error.value, error.expected) from error
        except (Exception, SystemExit) as error:  # the code of the class may raise anything
            raised = shorten_to_line(f"{type(error).__name__}: {error}")
            expected = f"a class whose constructor accepts its settings; it raised {raised}"
            raise BadInput(f"{self.section}.{KIND_KEY}", self.kind, expected) from error


def read_user_device(rig: RigDescription, section: str) -> UserDevice | None:
    """Return the user-defined device in a section of a rig file; None if the section names none.

    Its module is imported, but nothing is constructed.

    Raises
    ------
    BadInput
        If the class cannot be imported, lacks a method, or does not accept the other keys.
    """
    table = rig.devices.get(section, {})
    kind = table.get(KIND_KEY)
    if not isinstance(kind, str) or ":" not in kind:
        return None
    key, protocol = f"{section}.{KIND_KEY}", PROTOCOLS[section]
    require(bool(CLASS_PATH.fullmatch(kind)), key, kind, "module:class such as my_lab:MyClass")
    found = import_user_object(kind, key, None if rig.file is None else rig.file.parent)
    module, _, name = kind.partition(":")
    if not isinstance(found, type):
        raise BadInput(key, kind, f"a class; {module} has no class {name}")
    missing = [method for method in _list_methods(protocol) if not _has_method(found, method)]
    expected = f"a class with all methods of rcmservo.{protocol.__name__}; it lacks"
    require(not missing, key, kind, f"{expected} {', '.join(missing)}")
    values = {name: value for name, value in table.items() if name != KIND_KEY}
    return UserDevice(section, kind, found, _decode_arguments(found, values, section))


def construct_user_device(rig: RigDescription, device: UserDevice) -> Any:
    """Return a new instance of a device's class; errors name the rig file."""
    with name_rig_file(rig):
        return device.construct()


def name_rig_file(rig: RigDescription) -> AbstractContextManager[None]:
    """Return a context that prefixes the field of a `BadInput` with the rig file, if any."""
    return name_origin_in_errors(rig.file) if rig.file else nullcontext()


def adapt_arm(arm: Any) -> LabArm:
    """Return a user-defined arm with all methods of `LabArm`."""
    return _adapt(arm, LabArm, UserArm)


def adapt_camera(camera: Any) -> LabCamera:
    """Return a user-defined camera with all methods of `LabCamera`."""
    return _adapt(camera, LabCamera, UserCamera)


class UserArm:
    """User-defined arm, with default values for what only `LabArm` has.

    Parameters
    ----------
    arm : Arm
        Arm. Of `off_reason`, `is_homed`, `set_position` and `close`, it may have any.
    """

    def __init__(self, arm: Any) -> None:
        self._arm = arm

    @property
    def off_reason(self) -> str:
        """Reason for which the drive went off by itself; empty if the arm reports none."""
        return getattr(self._arm, "off_reason", "")

    def is_homed(self) -> bool:
        """Return True, unless the arm reports that its joint values are unknown."""
        return self._arm.is_homed() if hasattr(self._arm, "is_homed") else True

    def set_position(self, q: Floats) -> None:
        """Set the present joint values (3,) in rad, rad, mm, if the arm permits it.

        Raises
        ------
        NotReady
            If the arm has no such method.
        """
        if not hasattr(self._arm, "set_position"):
            name = type(self).__name__
            raise NotReady(f"{name} has no method set_position: home the arm by its own software")
        self._arm.set_position(q)

    def enable(self) -> None:
        self._arm.enable()

    def measure(self) -> ArmMeasurement:
        return self._arm.measure()

    def apply(self, command: Command) -> Floats:
        return self._arm.apply(command)

    def close(self) -> None:
        """Close the arm, if it has such a method."""
        _close(self._arm)


class UserCamera:
    """User-defined camera whose frames are counted, unless it counts them itself.

    Parameters
    ----------
    camera : Camera
        Camera. Of `counts` and `close`, it may have any.
    """

    def __init__(self, camera: Any) -> None:
        self._camera, self._last, self._count = camera, None, 0

    def latest(self) -> Frame | None:
        frame = self._camera.latest()
        self._count += frame is not self._last
        self._last = frame
        return frame

    def counts(self) -> CameraStatistics:
        """Return the camera's own counts, or the number of frames that it delivered."""
        if hasattr(self._camera, "counts"):
            return self._camera.counts()
        return CameraStatistics(frames=self._count)

    def close(self) -> None:
        """Close the camera, if it has such a method."""
        _close(self._camera)


def _list_methods(protocol: type[Any]) -> list[str]:
    """Return the names of the methods and attributes of a protocol and its bases."""
    bases = [base for base in protocol.__mro__ if base.__module__.startswith("rcmservo.")]
    return [name for base in reversed(bases) for name in vars(base) if not name.startswith("_")]


def _has_method(device_class: type[Any], name: str) -> bool:
    return callable(getattr(device_class, name, None))


def _adapt(device: Any, protocol: type[Any], adapter: type[Any]) -> Any:
    """Return a device that has all methods of a protocol itself, or else its adapter.

    The adapter's class has the name of the device's class, which error messages quote.
    """
    if all(hasattr(device, name) for name in _list_methods(protocol)):
        return device
    return type(type(device).__name__, (adapter,), {})(device)


def _close(device: Any) -> None:
    if hasattr(device, "close"):
        device.close()


def _decode_arguments(device_class: type[Any], values: Table, section: str) -> dict[str, Any]:
    """Return the arguments of a constructor from the keys of a section.

    The constructor's signature is the schema: its parameters are the keys, and their annotations
    are the types. A parameter that accepts any keyword leaves the values as they are.
    """
    parameters = _read_signature(device_class, section)
    other_values: Table = {}
    if any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
        other_values = {k: v for k, v in values.items() if k not in parameters}
    named = {
        p.name: p
        for p in parameters.values()
        if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)
    }
    schema: type[Any] = make_dataclass(
        device_class.__name__,
        [
            # defaults stay with the constructor; the schema only records that there is one
            (
                name,
                _choose_type(p, values),
                field() if p.default is p.empty else field(default=None),
            )
            for name, p in named.items()
        ],
        kw_only=True,
    )
    given = {k: v for k, v in values.items() if k not in other_values}
    decoded = decode_settings(schema, given, section, (KIND_KEY,))
    return {name: getattr(decoded, name) for name in given} | other_values


def _read_signature(device_class: type[Any], section: str) -> Mapping[str, inspect.Parameter]:
    """Return the parameters of a constructor, with evaluated annotations where possible."""
    try:
        try:
            return inspect.signature(device_class, eval_str=True).parameters
        except NameError:  # an annotation that only type checkers import
            return inspect.signature(device_class).parameters
    except (TypeError, ValueError) as error:
        expected = "a class whose constructor has named arguments"
        raise BadInput(f"{section}.{KIND_KEY}", device_class.__name__, expected) from error


def _choose_type(parameter: inspect.Parameter, values: Table) -> Any:
    """Return the annotated type of a parameter that the section gives, or Any."""
    annotation = parameter.annotation
    is_known = annotation is not parameter.empty and not isinstance(annotation, str)
    return annotation if is_known and parameter.name in values else Any
