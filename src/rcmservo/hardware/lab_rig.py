"""Rig of a rig file with devices: arm, camera and tracker are opened with its context."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from rcmservo.config.rig_file import RigDescription
from rcmservo.config.verified_rigs import is_rig_verified
from rcmservo.hardware.device_kinds import open_arm, open_camera
from rcmservo.live.device_protocols import NotReady
from rcmservo.live.unchecked_rig_speed import UNCHECKED_SPEED_SCALE, reduce_speed
from rcmservo.rig.rig import Rig
from rcmservo.servo.servo import Servo
from rcmservo.tracking import ColourMarkers


class Unconnected:
    """Arm or camera that is not connected: every method raises `NotReady`."""

    def _refuse(self, *_: object) -> Any:
        raise NotReady("the rig is not open: write `with rig:` around what uses it")

    enable = measure = apply = latest = _refuse


UNCONNECTED: Any = Unconnected()


class LabRig(Rig):
    """Arm and camera of a lab, which ``with rig:`` connects with the drive off.

    Until ``rcmservo rig check`` has passed for the bytes of the file, the arm moves at a tenth of
    its speed.

    Parameters
    ----------
    path : Path
        Rig file, for messages and the record.
    description : RigDescription
        Content of the file.
    digest : str
        SHA-256 of the bytes of the file in hexadecimal.
    """

    def __init__(self, path: Path, description: RigDescription, digest: str) -> None:
        self._path, self._description, self._digest = path, description, digest
        super().__init__(
            UNCONNECTED,
            UNCONNECTED,
            ColourMarkers(description.markers),
            description.mechanism,
            description.tool,
            gate=description.gate,
            thresholds=description.thresholds,
        )

    @property
    def speed_scale(self) -> float:
        """Fraction of the full speed that is allowed."""
        return 1.0 if is_rig_verified(self._digest) else UNCHECKED_SPEED_SCALE

    def _connect(self) -> None:
        """Connect arm and camera; the arm is closed again if the camera cannot be opened."""
        self.arm = open_arm(self._description)
        try:
            self.camera = open_camera(self._description)
        except BaseException:
            self.arm.close()
            raise

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        self.arm, self.camera = UNCONNECTED, UNCONNECTED

    def adapt(self, servo: Servo) -> Servo:
        """Return the servo for this rig, at the speed that is allowed."""
        return reduce_speed(super().adapt(servo), self.speed_scale)

    def describe(self) -> dict[str, Any]:
        """Return what the record stores of the lab: rig file, its digest, devices and speed."""
        return {
            "simulation": False,
            "rig_file": str(self._path),
            "rig_sha256": self._digest,
            "rig_checked": self.speed_scale == 1.0,
            "speed_scale": self.speed_scale,
            "devices": dict(self._description.devices),
            "markers": asdict(self._description.markers),
        }

    def __str__(self) -> str:
        speed = f"at {100.0 * self.speed_scale:g} % of the full speed"
        if self.speed_scale < 1.0:
            speed += " until `rcmservo rig check` passes"
        if isinstance(self.arm, Unconnected):
            return f"{self._path}, not connected, {speed}"
        return f"{self._path}: {super().__str__()}, {speed}"
