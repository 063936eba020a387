"""Settings of a CRTK arm: the section [arm] with kind = "crtk" of a rig file.

CRTK (collaborative robotics toolkit) is a convention for topics and states of surgical robots in
ROS.
"""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from rcmservo.bringup.axis_wiring import Wiring
from rcmservo.constraints import Checked, Limit, Triple, between, each, matching

MAX_LEAD = 0.5, 0.5, 50.0
"""Upper limit of the setting ``max_lead``, rad, rad, mm."""
LEAD = Limit(
    lambda lead: all(0.0 < x <= largest for x, largest in zip(lead, MAX_LEAD, strict=True)),
    "positive, at most 0.5 rad, 0.5 rad and 50 mm",
)
SIGNS = each(Limit((1.0, -1.0).__contains__, ""), "three numbers, each 1 or -1")
ROS_VERSION = Limit((1, 2).__contains__, "1 or 2")
TOPIC_PATTERN = r"\w+(/\w+)*"
DOMAIN = between(0, 232, "a whole number")
NAMESPACE = matching(TOPIC_PATTERN, "letters, digits and _, such as PSM1")
INTERFACE = matching(r"[\w.:-]{1,15}", "a network interface's name, such as lo")


@dataclass(frozen=True, kw_only=True)
class RosConnection(Checked):
    """Version of ROS, and the network that it uses.

    Parameters
    ----------
    ros : int
        ROS version: 2, or 1 with the master in ROS_MASTER_URI.
    domain : int
        Domain of ROS 2 (ROS_DOMAIN_ID).
    interface : str
        Network interface of ROS 2; lo is within this computer.
    """

    ros: Annotated[int, ROS_VERSION] = 2
    domain: Annotated[int, DOMAIN] = 0
    interface: Annotated[str, INTERFACE] = "lo"


@dataclass(frozen=True)
class CrtkSettings(RosConnection, section="arm"):
    """Connection of a CRTK arm whose first three joints are those of the mechanism.

    Parameters
    ----------
    namespace : str
        Namespace of the arm's topics, such as PSM1.
    signs : Triple
        Direction of each joint relative to the mechanism's, 1 or -1.
    max_lead : Triple
        Largest distance of the setpoint from the measured position, rad, rad, mm. When this program
        dies, the arm moves by this distance at most.
    jv : bool
        True to send speeds (servo_jv) instead of positions. Only for an arm that `rig check` has
        observed to stop by itself without commands.
    reply_timeout : float
        Time limit for the arm to execute a state command, s.
    """

    name: ClassVar[str] = "crtk"
    """Kind of the arm in rig files."""

    namespace: Annotated[str, NAMESPACE]
    signs: Annotated[Triple, SIGNS] = (1.0, 1.0, 1.0)
    max_lead: Annotated[Triple, LEAD] = (0.1, 0.1, 10.0)
    jv: bool = False
    reply_timeout: Annotated[float, between(0.1, 30.0, "a time", "s")] = 2.0

    @property
    def wiring(self) -> Wiring:
        """Directions of the joints."""
        return Wiring(self.signs, "signs")
