"""Rig: arm, camera, tracker, mechanism, tool and clock as one object.

`rcmservo.rig.run` moves the tool of a rig. The simulated rig and the rig of a rig file derive from
`Rig`, so the same program runs on all of them.
"""

from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any, Self

from rcmservo.errors import RcmServoError, require
from rcmservo.geometry.kinematics import Kinematics
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Arm, Camera, Clock, Target, Tracker
from rcmservo.live.device_protocols import NotReady, close_at_end
from rcmservo.live.tracking_thread import TrackingThread
from rcmservo.loop.clock import WallClock
from rcmservo.loop.plant import Plant
from rcmservo.loop.target_frames import TEACHING_FRAMES
from rcmservo.loop.teach import teach
from rcmservo.loop.tick import Tick
from rcmservo.recording.writer import Recorder, ThreadedRecorder
from rcmservo.safety.gate import Gate
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.servo import Servo
from rcmservo.servo.user_estimator import format_class_name_of

WARM_UP_FRAMES = 2
"""Number of frames after which all kernels of a tracker are compiled: it searches the whole first
frame, and only near the markers in the second."""

DEVICE_METHODS = {
    "arm": ("enable", "measure", "apply"),
    "camera": ("latest",),
    "tracker": ("find", "reset"),
}
"""Methods that each device must have."""

FIRST_FRAME_TIMEOUT_S = 10.0
"""Time in s within which a camera must deliver a frame."""

AnyRecorder = Recorder | ThreadedRecorder


class Rig:
    """Arm, camera, tracker, mechanism, tool and clock, which `run` moves.

    In wall time a rig is used as a context manager. Then a thread tracks the markers next to the
    loop, and at the end arm and camera are closed if they have a method ``close``. A rig with a
    clock of its own, such as a simulation, needs no context. A class of your own that derives from
    `Rig` may override `go_home` and `measure_true_error`. For a simulation of your own, set
    ``rig.is_simulated = True``: then `run` asks nobody before it switches the drive on.

    Parameters
    ----------
    arm : Arm
        Arm that accepts joint rates.
    camera : Camera
        Source of the frames.
    tracker : Tracker
        Detector of the markers in a frame.
    mechanism : Kinematics
        Kinematics of the arm with its joint limits: `SphericalRcm` or `PitchYawRcm`.
    tool : Tool
        Positions of the markers on the tool: `RigidTool` or `ScaledTool`.
    clock : Clock or None
        Clock of all times; None, the default, for `WallClock`, the time of this computer.
    gate : Gate or None
        Bounds on every command of this arm; by default those of the servo.
    thresholds : Thresholds or None
        Thresholds of the checks for this rig; by default those of the servo.

    Examples
    --------
    An arm and a camera of your own, of classes with the methods of `Arm` and `Camera`::

        tracker, tool = rs.tracking.ColourMarkers(), rs.RigidTool(30.0)
        with rs.Rig(MyArm(), MyCamera(), tracker, rs.SphericalRcm(), tool) as rig:
            target = rig.teach()
            input("Move the tool away, then press Enter")
            result = rs.run(rig, rs.Servo(), target, confirm=input)
    """

    arm: Arm
    camera: Camera
    is_simulated: bool = False
    """True if no real arm can move: then `run` asks nobody before it switches the drive on. Set it
    for a simulation of your own."""

    def __init__(
        self,
        arm: Arm,
        camera: Camera,
        tracker: Tracker,
        mechanism: Kinematics,
        tool: Tool,
        clock: Clock | None = None,
        *,
        gate: Gate | None = None,
        thresholds: Thresholds | None = None,
    ) -> None:
        for name, device in {"arm": arm, "camera": camera, "tracker": tracker}.items():
            _require_methods(name, device, DEVICE_METHODS[name])
        require_kind("mechanism", mechanism, Kinematics, "such as SphericalRcm()")
        require_kind("tool", tool, Tool, "such as RigidTool(spacing=30.0)")
        self.arm, self.camera, self.tracker = arm, camera, tracker
        self.mechanism, self.tool = mechanism, tool
        self._robot_parts = {"mechanism": mechanism, "tool": tool} | {
            name: part
            for name, part in {"gate": gate, "thresholds": thresholds}.items()
            if part is not None
        }
        self.clock: Clock = WallClock() if clock is None else clock
        self._plant: Plant | None = None
        self._stack = ExitStack()

    @property
    def is_in_wall_time(self) -> bool:
        """True if time passes by itself, as on hardware."""
        return isinstance(self.clock, WallClock)

    @property
    def plant(self) -> Plant:
        """Plant of the rig, for a loop of your own.

        Raises
        ------
        NotReady
            In wall time, outside the context of the rig.
        """
        if self._plant is None and self.is_in_wall_time:
            raise NotReady("the rig is not open: write `with rig:` around what uses it")
        if self._plant is None:
            self._plant = Plant(self.arm, self.camera, self.tracker, self.clock)
        return self._plant

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            stack.enter_context(self.connected())
            if self.is_in_wall_time:
                tracking = TrackingThread(self.camera, self.tracker, self.clock)
                stack.enter_context(tracking)
                tracking.wait_for(WARM_UP_FRAMES, FIRST_FRAME_TIMEOUT_S)
                self._plant = Plant(self.arm, tracking, tracking, self.clock)
                self._require_frame(self._plant)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        if self.is_in_wall_time:
            self._plant = None
        self._stack.__exit__(*error)

    @contextmanager
    def connected(self) -> Generator[None]:
        """Connect arm, camera and tracker, with the drive off, and close them at the end.

        ``with rig:`` also tracks the markers. A loop with a tracking thread of its own, such as the
        servo process of ``rcmservo live``, needs the devices only.
        """
        with ExitStack() as stack:
            for device in (self.arm, self.camera, self.tracker):
                close_at_end(device, stack)
            yield

    def _require_frame(self, plant: Plant) -> None:
        """Raise an error if the camera has delivered no usable frame."""
        if plant.camera.latest() is None:
            name, seconds = type(self.camera).__name__, FIRST_FRAME_TIMEOUT_S
            raise NotReady(
                f"{name} has delivered no frame for {seconds:g} s; if it has a clock of its own, "
                "as in a simulation, give it to Rig as clock="
            )

    def teach(self, frames: int = TEACHING_FRAMES) -> Target:
        """Teach the present pose of the tool as a target. Nothing moves.

        Parameters
        ----------
        frames : int
            Number of frames whose mean becomes the target, 300 by default.

        Returns
        -------
        Target
            Markers in raw px and joints, for `run` or a target file.

        Raises
        ------
        TeachingFailed
            If no frame shows both markers for 2 s, or if the frames do not agree.
        """
        return teach(self.plant, frames)

    def go_home(self) -> None:
        """Bring the tool to the start of a run, where the rig can do this without the servo.

        Raises
        ------
        NotReady
            If the tool must be moved by hand, as with real arms.
        """
        raise NotReady("this rig cannot go home by itself: move the tool to its start by hand")

    def adapt(self, servo: Servo) -> Servo:
        """Return the servo with the mechanism, the tool and any bounds of the rig.

        Raises
        ------
        BadInput
            If the servo has such a part of its own that differs.
        """
        default = Servo()
        for name, part in self._robot_parts.items():
            own, expected = getattr(servo, name), f"left out or equal to that of the rig, {part}"
            require(own in (getattr(default, name), part), f"servo.{name}", own, expected)
        return replace(servo, **self._robot_parts)

    def require_ready(self) -> None:
        """Raise an error if the drive must not be switched on now.

        Raises
        ------
        NotReady
            If the drive is on already, or the arm does not know its joint values.
        """
        require_drive_off(self.plant)
        is_homed = getattr(self.arm, "is_homed", None)
        if is_homed is not None and not is_homed():
            raise NotReady(
                "the joint values of the arm are unknown since it was reset: move it by hand to "
                "known joints and call rig.arm.set_position(q), q in rad, rad, mm"
            )

    def begin(self) -> None:
        """Note that a run begins now: the disturbances of a simulation count from here."""

    def measure_true_error(self, target: Target) -> float:
        """Return the true distance (mm) of marker 2 from its taught position; NaN if unknown.

        Only a simulation knows it.
        """
        return float("nan")

    def compute_bound(self, target: Target, frames: int) -> float:
        """Return the smallest pose error (mm) that an unbiased servo can have; NaN if unknown.

        Only a simulation knows it. `frames` is the number of frames that the servo has used.
        """
        return float("nan")

    def record_tick(self, recorder: AnyRecorder, tick: Tick) -> None:
        """Write a tick into the record."""
        recorder.write(tick)

    def describe(self) -> dict[str, Any]:
        """Return what the record stores of the rig, for JSON."""
        devices = {"arm": self.arm, "camera": self.camera, "tracker": self.tracker}
        names = {name: format_class_name_of(device) for name, device in devices.items()}
        return {"simulation": self.is_simulated, "devices": names}

    def __str__(self) -> str:
        devices = (self.arm, self.camera, self.tracker)
        names = ", ".join(type(device).__name__ for device in devices)
        return f"{names}; {self.mechanism.name} RCM, {self.tool.name} tool; {self._find_state()}"

    def _find_state(self) -> str:
        """Return whether the devices answer, and whether the drive is on."""
        try:
            is_enabled = self.plant.arm.measure().enabled
        except RcmServoError as error:
            return str(error)
        return "drive on" if is_enabled else "drive off"


def require_drive_off(plant: Plant) -> None:
    """Refuse an arm whose drive another program has enabled, because the arm could move."""
    if plant.arm.measure().enabled:
        raise NotReady("another program has switched the arm's drive on: switch it off there first")


def _require_methods(field: str, device: object, methods: tuple[str, ...]) -> None:
    """Raise `BadInput` if a device lacks a method of its protocol."""
    missing = [name for name in methods if not callable(getattr(device, name, None))]
    expected = f"an object with the methods {', '.join(methods)}; it lacks {', '.join(missing)}"
    require(not missing, field, device, expected)


def require_kind(field: str, value: object, kind: type, expected: str) -> None:
    """Raise `BadInput` if a value is of another kind."""
    require(isinstance(value, kind), field, value, expected)
