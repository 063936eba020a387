"""Rig whose devices are connected when its context begins, in whichever process that happens."""

from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from typing import Any

from rcmservo.geometry.kinematics import Kinematics
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Arm, Camera, Tracker
from rcmservo.live.device_protocols import NotReady, close_at_end
from rcmservo.rig.rig import Rig
from rcmservo.safety.gate import Gate
from rcmservo.safety.thresholds import Thresholds


class Unconnected:
    """Arm, camera or tracker that is not connected: every method raises `NotReady`."""

    def _refuse(self, *_: object) -> Any:
        raise NotReady("the rig is not open: write `with rig:` around what uses it")

    enable = measure = apply = latest = find = reset = _refuse


UNCONNECTED: Any = Unconnected()


class LazyRig(Rig):
    """Rig that makes its arm, camera and tracker when they are connected.

    Outside its context it holds no open device, and can be passed to another process if its
    functions can be pickled.

    Parameters
    ----------
    arm : Callable[[], Arm]
        Function that connects to the arm, with the drive off.
    camera : Callable[[], Camera]
        Function that opens the camera.
    tracker : Callable[[], Tracker]
        Function that makes the marker tracker.
    mechanism : Kinematics
        Kinematics of the arm.
    tool : Tool
        Positions of the markers on the tool.
    gate : Gate or None
        Bounds on every command of this arm; by default those of the servo.
    thresholds : Thresholds or None
        Thresholds of the checks for this rig; by default those of the servo.
    """

    def __init__(
        self,
        arm: Callable[[], Arm],
        camera: Callable[[], Camera],
        tracker: Callable[[], Tracker],
        mechanism: Kinematics,
        tool: Tool,
        *,
        gate: Gate | None = None,
        thresholds: Thresholds | None = None,
    ) -> None:
        self._makers = {"tracker": tracker, "arm": arm, "camera": camera}
        unconnected = UNCONNECTED, UNCONNECTED, UNCONNECTED
        super().__init__(*unconnected, mechanism, tool, gate=gate, thresholds=thresholds)

    @contextmanager
    def connected(self) -> Generator[None]:
        with ExitStack() as stack:
            stack.callback(self._forget_devices)
            for name, make in self._makers.items():  # if the tracker fails, nothing is connected
                device = make()
                setattr(self, name, device)
                close_at_end(device, stack)
            yield

    def _forget_devices(self) -> None:
        self.arm = self.camera = self.tracker = UNCONNECTED
