"""[arm] kind = "crtk": how an arm that speaks CRTK is reached, and how it may be moved."""

import re
from dataclasses import dataclass
from typing import ClassVar

from rcmservo.bringup.axis_wiring import Wiring
from rcmservo.errors import require

Joints = tuple[float, float, float]


@dataclass(frozen=True)
class CrtkSettings:
    """An arm that speaks CRTK, whose first three joints are those of the mechanism."""

    name: ClassVar[str] = "crtk"
    """Its kind in rig files."""

    namespace: str
    """Its name before all of its topics, such as PSM1."""
    ros: int = 2
    """Which ROS it speaks: 2 or 1."""
    domain: int = 0
    """ROS 2's domain (ROS_DOMAIN_ID)."""
    interface: str = "lo"
    """The network interface on which ROS 2 is spoken; lo is within this computer."""
    signs: Joints = (1.0, 1.0, 1.0)
    """1 or -1 for each joint: which way it counts, beside the mechanism's."""
    lead: Joints = (0.1, 0.1, 10.0)
    """rad, rad, mm by which what is asked for may run ahead of where the arm is. It is as far as
    the arm goes on when this program dies."""
    jv: bool = False
    """Whether the arm is sent speeds (servo_jv) in place of positions: only where `rig check` has
    seen it come to rest by itself when nothing was sent."""
    answer_within: float = 2.0
    """s within which it does what its state commands say."""

    def __post_init__(self) -> None:
        good = re.fullmatch(r"\w+(/\w+)*", self.namespace, re.ASCII) is not None
        require(good, "arm.namespace", self.namespace, "letters, digits and _, such as PSM1")
        require_ros("arm", self.ros, self.domain, self.interface)
        good = all(abs(sign) == 1.0 for sign in self.signs)
        require(good, "arm.signs", self.signs, "three numbers, each 1 or -1")
        good = all(
            0.0 < lead <= most for lead, most in zip(self.lead, (0.5, 0.5, 50.0), strict=True)
        )
        require(good, "arm.lead", self.lead, "positive, at most 0.5 rad, 0.5 rad and 50 mm")
        good = 0.1 <= self.answer_within <= 30.0
        require(good, "arm.answer_within", self.answer_within, "from 0.1 to 30 s")

    @property
    def wiring(self) -> Wiring:
        """How the joints count."""
        return Wiring(self.signs, "signs")


def require_ros(section: str, ros: int, domain: int, interface: str) -> None:
    """What tells which ROS is spoken, and where."""
    require(ros in (1, 2), f"{section}.ros", ros, "1 or 2")
    require(0 <= domain <= 232, f"{section}.domain", domain, "a whole number from 0 to 232")
    good = re.fullmatch(r"[\w.:-]{1,15}", interface, re.ASCII) is not None
    require(good, f"{section}.interface", interface, "a network interface's name, such as lo")
