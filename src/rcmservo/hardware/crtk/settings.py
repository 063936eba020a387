"""[arm] kind = "crtk": how an arm that speaks CRTK is reached, and how it may be moved."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from rcmservo.bringup.axis_wiring import Wiring
from rcmservo.constraints import Checked, Limit, Triple, between, each, matching

LEAD = Limit(
    lambda lead: all(0.0 < x <= most for x, most in zip(lead, (0.5, 0.5, 50.0), strict=True)),
    "positive, at most 0.5 rad, 0.5 rad and 50 mm",
)
SIGNS = each(Limit((1.0, -1.0).__contains__, ""), "three numbers, each 1 or -1")
ROS = Limit((1, 2).__contains__, "1 or 2")
TOPIC = r"\w+(/\w+)*"
NAMESPACE = matching(TOPIC, "letters, digits and _, such as PSM1")
DOMAIN = between(0, 232, "a whole number")
INTERFACE = matching(r"[\w.:-]{1,15}", "a network interface's name, such as lo")


@dataclass(frozen=True, kw_only=True)
class RosConnection(Checked):
    """Version of ROS, and the network that it is spoken on."""

    ros: Annotated[int, ROS] = 2
    """Version of ROS: 2, or 1 by the master that ROS_MASTER_URI names."""
    domain: Annotated[int, DOMAIN] = 0
    """ROS 2's domain (ROS_DOMAIN_ID)."""
    interface: Annotated[str, INTERFACE] = "lo"
    """Network interface on which ROS 2 is spoken; lo is within this computer."""


@dataclass(frozen=True)
class CrtkSettings(RosConnection, section="arm"):
    """An arm that speaks CRTK, whose first three joints are those of the mechanism."""

    name: ClassVar[str] = "crtk"
    """Its kind in rig files."""

    namespace: Annotated[str, NAMESPACE]
    """Its name before all of its topics, such as PSM1."""
    signs: Annotated[Triple, SIGNS] = (1.0, 1.0, 1.0)
    """1 or -1 for each joint: which way it counts, beside the mechanism's."""
    lead: Annotated[Triple, LEAD] = (0.1, 0.1, 10.0)
    """rad, rad, mm by which what is asked for may run ahead of where the arm is. It is as far as
    the arm goes on when this program dies."""
    jv: bool = False
    """Whether the arm is sent speeds (servo_jv) in place of positions: only where `rig check` has
    seen it come to rest by itself when nothing was sent."""
    answer_within: Annotated[float, between(0.1, 30.0, "a time", "s")] = 2.0
    """s within which it does what its state commands say."""

    @property
    def wiring(self) -> Wiring:
        """How the joints count."""
        return Wiring(self.signs, "signs")
