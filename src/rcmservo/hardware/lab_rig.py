"""Rig of a rig file with devices: arm, camera and tracker are opened with its context."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from rcmservo.config.rig_file import RigDescription, name_origin_in_errors
from rcmservo.config.verified_rigs import is_rig_verified
from rcmservo.errors import require
from rcmservo.hardware.crtk.settings import CrtkSettings
from rcmservo.hardware.device_kinds import (
    open_arm,
    open_camera,
    prepare_tracker,
    read_arm,
    require_known_latency,
)
from rcmservo.interfaces import Arm, Camera
from rcmservo.live.unchecked_rig_speed import UNCHECKED_SPEED_SCALE, reduce_speed
from rcmservo.rig.lazy_rig import LazyRig, Unconnected
from rcmservo.servo.servo import Servo


class LabRig(LazyRig):
    """Arm and camera of a lab, which ``with rig:`` connects with the drive off.

    Until ``rcmservo rig check`` has passed for the bytes of the file, the arm moves at a tenth of
    its speed.

    Parameters
    ----------
    path : Path or None
        Rig file, for messages and the record.
    description : RigDescription
        Content of the file.
    digest : str
        SHA-256 of the bytes of the file in hexadecimal.
    arm : Callable[[RigDescription], Arm]
        Function that connects to the arm of the file.
    camera : Callable[[RigDescription], Camera]
        Function that opens the camera of the file.
    """

    speed_scale: float
    """Fraction of the full speed that was allowed when the rig was made or last adapted a servo."""

    def __init__(
        self,
        path: Path | None,
        description: RigDescription,
        digest: str,
        *,
        arm: Callable[[RigDescription], Arm] = open_arm,
        camera: Callable[[RigDescription], Camera] = open_camera,
    ) -> None:
        require_devices(description, path, digest)
        self.path, self.description, self.digest = path, description, digest
        self.speed_scale = self._find_speed_scale()
        super().__init__(
            partial(arm, description),
            partial(camera, description),
            prepare_tracker(description),
            description.mechanism,
            description.tool,
            gate=description.gate,
            thresholds=description.thresholds,
        )

    def adapt(self, servo: Servo) -> Servo:
        """Return the servo for this rig, at the speed that is allowed now.

        `describe` then states this speed, also if ``rig check`` passes later.
        """
        self.speed_scale = self._find_speed_scale()
        return reduce_speed(super().adapt(servo), self.speed_scale)

    def _find_speed_scale(self) -> float:
        return 1.0 if is_rig_verified(self.digest) else UNCHECKED_SPEED_SCALE

    def describe(self) -> dict[str, Any]:
        """Return what the record stores of the lab: rig file, its digest, devices and speed."""
        return {
            "simulation": False,
            "rig_file": str(self.path),
            "rig_sha256": self.digest,
            "rig_checked": self.speed_scale == 1.0,
            "speed_scale": self.speed_scale,
            "devices": dict(self.description.devices),
        }

    def __str__(self) -> str:
        speed = f"at {100.0 * self.speed_scale:g} % of the full speed"
        if self.speed_scale < 1.0:
            speed += " until `rcmservo rig check` passes"
        if isinstance(self.arm, Unconnected):
            return f"{self.path}, not connected, {speed}"
        return f"{self.path}: {super().__str__()}, {speed}"


def require_devices(lab: RigDescription, rig: Path | None, digest: str) -> None:
    """Refuse, before anything is connected, a rig file without complete devices.

    An arm that receives speeds (arm.jv) is refused as well until `rig check` has verified that it
    stops by itself.
    """
    with name_origin_in_errors(rig):
        arm = read_arm(lab)
        stops = not (isinstance(arm, CrtkSettings) and arm.jv) or is_rig_verified(digest)
        expected = "false until `rig check` of this file has verified that the arm stops by itself"
        require(stops, "arm.jv", True, expected)
        require_known_latency(lab)
    prepare_tracker(lab)
