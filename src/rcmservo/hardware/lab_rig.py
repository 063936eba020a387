"""Rig of a rig file with devices: arm, camera and tracker are opened with its context."""

from pathlib import Path
from typing import Any

from rcmservo.config.rig_file import RigDescription, name_origin_in_errors
from rcmservo.config.verified_rigs import is_rig_verified
from rcmservo.errors import require
from rcmservo.hardware.crtk.settings import CrtkSettings
from rcmservo.hardware.device_kinds import (
    make_tracker,
    open_arm,
    open_camera,
    prepare_tracker,
    read_arm,
    require_known_latency,
)
from rcmservo.live.device_protocols import NotReady
from rcmservo.live.unchecked_rig_speed import UNCHECKED_SPEED_SCALE, reduce_speed
from rcmservo.rig.rig import Rig
from rcmservo.servo.servo import Servo


class Unconnected:
    """Arm, camera or tracker that is not connected: every method raises `NotReady`."""

    def _refuse(self, *_: object) -> Any:
        raise NotReady("the rig is not open: write `with rig:` around what uses it")

    enable = measure = apply = latest = find = reset = _refuse


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
        require_devices(description, path, digest)
        self._path, self._description, self._digest = path, description, digest
        super().__init__(
            UNCONNECTED,
            UNCONNECTED,
            UNCONNECTED,
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
        self.tracker = make_tracker(self._description)
        self.arm = open_arm(self._description)
        try:
            self.camera = open_camera(self._description)
        except BaseException:
            self.arm.close()
            raise

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        self.arm = self.camera = self.tracker = UNCONNECTED

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
        }

    def __str__(self) -> str:
        speed = f"at {100.0 * self.speed_scale:g} % of the full speed"
        if self.speed_scale < 1.0:
            speed += " until `rcmservo rig check` passes"
        if isinstance(self.arm, Unconnected):
            return f"{self._path}, not connected, {speed}"
        return f"{self._path}: {super().__str__()}, {speed}"


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
