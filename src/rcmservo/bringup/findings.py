"""Findings of the check, and the end of a check by one."""

from dataclasses import dataclass

from rcmservo.errors import RcmServoError


@dataclass(frozen=True)
class Finding:
    """A mismatch between the rig file, the devices and the picture.

    Parameters
    ----------
    what : str
        The mismatch in a few words.
    where : str
        The setting, such as arm.counts[1], or the device.
    found : str
        The present value, or the observation.
    expected : str
        The value that it would have to be.
    line : str
        The line of the rig file that corrects it; empty where none does.
    """

    what: str
    where: str
    found: str
    expected: str
    line: str = ""


class CheckAborted(RcmServoError):
    """A finding that ends the check, with the drive off."""

    def __init__(self, what: str, where: str, found: str, expected: str, line: str = "") -> None:
        super().__init__(what)
        self.finding = Finding(what, where, found, expected, line)
