"""Options of `rcmservo run`, `live` and `serve`: a new option of these commands is a field here.

`RunOptions` are those of `run`. `LabOptions` are common to all three, `RunToTargetOptions` to `run`
and `live`; `LiveOptions` and `ServeOptions` in live.py and lab/serve.py add those of one command.
The type and limit of an option are its annotation, and its help is its entry under Parameters. The
properties make the lab and the servo that the options define.
"""

from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from rcmservo.cli.servo_options import EstimatorName, ServoOptions
from rcmservo.config.rig_file import (
    RigDescription,
    decode_rig_file,
    name_origin_in_errors,
    read_rig_file,
)
from rcmservo.config.verified_rigs import compute_digest
from rcmservo.constraints import Limit, between, not_negative
from rcmservo.errors import require
from rcmservo.loop.target_frames import FRAME_COUNT, TEACHING_FRAMES
from rcmservo.servo.servo import Servo

if TYPE_CHECKING:
    from rcmservo.sim import Disturbance, RigSettings

SEED_LIMIT = not_negative("whole number")
DURATION_LIMIT = Limit(lambda s: 1.0 < s <= 3600.0, "more than 1 and at most 3600 s")


@dataclass(frozen=True, kw_only=True)
class LabOptions(ServoOptions):
    """Options that `run`, `live` and `serve` share.

    Parameters
    ----------
    seed : int
        Seed of camera, start, target and noise.
    estimator : EstimatorName
        Estimator of the Jacobian: one of those below, or your own.
    rig : Path or None
        TOML file with your own mechanism, tool, markers, camera and scene, and with devices for
        live and serve.
    teaching_frames : int
        Number of frames over which a taught target is averaged: 300 are 5 s at 60 frames/s.
    out : Path or None
        New or empty output folder; by default a new one under runs/.
    """

    seed: Annotated[int, SEED_LIMIT] = 0
    estimator: EstimatorName = "dlt"
    rig: Path | None = None
    teaching_frames: Annotated[int, FRAME_COUNT] = TEACHING_FRAMES
    out: Path | None = None

    @cached_property
    def _rig_bytes(self) -> bytes:
        return b"" if self.rig is None else read_rig_file(self.rig)

    @cached_property
    def lab(self) -> RigDescription:
        """Robot, markers and devices of the rig file, or the built-in ones."""
        return RigDescription() if self.rig is None else decode_rig_file(self.rig, self._rig_bytes)

    @property
    def digest(self) -> str:
        """SHA-256 of the bytes of the rig file, by which its check is remembered."""
        return compute_digest(self._rig_bytes)

    @cached_property
    def rig_settings(self) -> "RigSettings":
        """Settings of the simulated arm and camera that the rig file describes."""
        from rcmservo.sim.rig_file import read_rig_settings

        with name_origin_in_errors(self.rig) if self.rig else nullcontext():
            return read_rig_settings(self.lab)

    @cached_property
    def servo(self) -> Servo:
        """Servo for the lab, with the estimator and settings of these options."""
        return self.make_servo(self.estimator, self.lab)

    def has_devices(self) -> bool:
        """Return True if the rig file has an arm; raise `BadInput` if a seed is given as well."""
        if "arm" not in self.lab.devices:
            return False
        expected = f"left out: {self.rig} has an arm, so nothing is simulated"
        require(self.seed == 0, "--seed", self.seed, expected)
        return True


@dataclass(frozen=True, kw_only=True)
class RunToTargetOptions(LabOptions):
    """Options of `run` and `live`, which servo to one target.

    Parameters
    ----------
    duration : float
        Length of the run, s.
    target : Path or None
        File with the target, as --save-target writes it; by default the target is taught first.
    save_target : Path or None
        New file in which the taught target is saved.
    json : bool
        Print one JSON object and nothing else.
    """

    duration: Annotated[float, DURATION_LIMIT] = 30.0
    target: Path | None = None
    save_target: Path | None = None
    json: bool = False


@dataclass(frozen=True, kw_only=True)
class RunOptions(RunToTargetOptions):
    """Servo a simulated arm to a taught target with an uncalibrated camera.

    Parameters
    ----------
    video : bool
        Write the overlay video.
    frames : bool
        Store all frames in the record for `export`.
    disturb : tyro.conf.UseAppendAction[tuple[str, ...]]
        Disturbance, as kind:at=5,for=0.5,key=value; repeatable. --disturb help lists all kinds.
    arm : Literal['ideal', 'good', 'worn']
        Quality of the arm.
    resumes : int
        Number of times that a scripted operator resumes after a pause, or teaches the target
        again if needed.
    """

    video: bool = True
    frames: bool = False
    disturb: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    arm: Literal["ideal", "good", "worn"] = "ideal"
    resumes: Annotated[int, between(0, 1000, "a whole number")] = 0

    @cached_property
    def rig_settings(self) -> "RigSettings":
        """Settings of the simulated arm and camera of the rig file, with an arm of this quality."""
        from rcmservo.sim.rig_file import read_rig_settings

        with name_origin_in_errors(self.rig) if self.rig else nullcontext():
            return read_rig_settings(self.lab, self.arm)

    @cached_property
    def disturbances(self) -> "tuple[Disturbance, ...]":
        """Disturbances that `disturb` describes."""
        from rcmservo.sim import Disturbance

        return tuple(map(Disturbance.parse, self.disturb))
