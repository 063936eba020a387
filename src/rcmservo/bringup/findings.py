"""Finding of `rig check`, and the exception that aborts the check with a finding."""

from dataclasses import dataclass

from rcmservo.errors import RcmServoError


@dataclass(frozen=True)
class Finding:
    """Mismatch between the rig file, the devices and the image.

    Parameters
    ----------
    what : str
        Mismatch in a few words.
    where : str
        Setting, for example arm.counts[1], or device.
    found : str
        Present value, or observation.
    expected : str
        Expected value, with the next step where no line corrects the file.
    line : str
        Line that corrects the rig file; empty if no line does.
    """

    what: str
    where: str
    found: str
    expected: str
    line: str = ""


class CheckAborted(RcmServoError):
    """Raised to abort the check with a finding; the drive is then switched off.

    Parameters
    ----------
    fields : str
        Fields of the finding, in their order.
    """

    def __init__(self, *fields: str) -> None:
        self.finding = Finding(*fields)
        super().__init__(self.finding.what)
