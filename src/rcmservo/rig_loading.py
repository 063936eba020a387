"""Rig of a rig file: the devices that it names, or the simulated laboratory that it describes."""

from pathlib import Path

from rcmservo.config.rig_file import decode_rig_file, read_rig_file
from rcmservo.config.verified_rigs import compute_digest
from rcmservo.errors import require_extra
from rcmservo.rig.rig import Rig


def load_rig(path: str | Path, seed: int = 0) -> Rig:
    """Return the rig of a rig file. Nothing is connected before ``with rig:``.

    Parameters
    ----------
    path : str or Path
        Rig file in TOML. With a section [arm] it is a lab, whose arm and camera are connected, with
        the drive off, when the context of the rig begins. Without [arm] it is a simulated
        laboratory.
    seed : int
        Seed of a simulated laboratory, at least 0.

    Returns
    -------
    Rig
        Rig for `run`.

    Raises
    ------
    UnusableFile
        If the file cannot be read.
    BadInput
        If the content of the file is invalid.

    Notes
    -----
    Until ``rcmservo rig check`` has passed for a file with an arm, the arm moves at a tenth of its
    speed.
    """
    file = Path(path)
    data = read_rig_file(file)
    description = decode_rig_file(file, data)
    if "arm" in description.devices:
        from rcmservo.hardware.lab_rig import LabRig

        return LabRig(file, description, compute_digest(data))
    with require_extra("load_rig", "sim"):
        from rcmservo.sim import Rig as SimulatedRig
        from rcmservo.sim.rig_file import read_rig_settings
    from rcmservo.hardware.device_kinds import make_tracker

    return SimulatedRig(
        seed,
        read_rig_settings(description),
        tracker=make_tracker(description),
        gate=description.gate,
        thresholds=description.thresholds,
    )
