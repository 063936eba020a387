"""The check of a laboratory, from the first look to what is wrong with its rig file.

It is told nothing but what arm and camera tell, and what a person answers. It ends with the drive
off, however it ends.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from rcmservo.bringup.asking import agreed, one_of
from rcmservo.bringup.deciding import decided
from rcmservo.bringup.findings import findings, may_pass
from rcmservo.bringup.guesses import RIGHT, Guess, Weighed, explains, members, places
from rcmservo.bringup.motion import AT_REST, Mover
from rcmservo.bringup.ranging import Ranging
from rcmservo.bringup.sights import Sight, Track
from rcmservo.bringup.timing import Lateness, Rhythm, drive_lag, lateness, pace, wrongly_late
from rcmservo.bringup.troubles import Trouble
from rcmservo.bringup.wiring import Finding, Robot
from rcmservo.errors import Stopped
from rcmservo.guard.gate import Gate
from rcmservo.guard.thresholds import Thresholds
from rcmservo.interfaces import Floats
from rcmservo.live.lab import FallsSilent, Person

SWINGS = 6
"""To and fro, for the times."""
LAG_OFF = 0.01
"""s by which a drive's lag may be off."""
LEAST_RATE = 10.0
"""Frames per s."""
LEAST_FOUND = 0.9
"""Share of the frames that must show both markers."""
ROOM = 3.0
"""mm, and times this many hundredths of a rad, that the joints must be from their limits."""
POSSIBILITY = "possibility"
"""Said where even the answers of the person left several explanations, one of which is true."""


@dataclass
class CheckReport:
    """What the check found."""

    findings: list[Finding] = field(default_factory=list[Finding])
    """All that is not as it must be."""
    q: Floats | None = None
    """The joints (3,) at first."""
    arm: Rhythm | None = None
    """How often the arm answers."""
    camera: Rhythm | None = None
    """How often frames are exposed."""
    rest: Sight | None = None
    """What was seen at first."""
    lateness: Lateness | None = None
    """By how much frames are late."""
    lag: float = 0.0
    """s that the drives are behind; 0 where it was not measured."""
    farthest: float = 0.0
    """px that a marker went at most."""
    undecided: list[str] = field(default_factory=list[str])
    """What was told apart only by asking, in words."""
    unclear: list[str] = field(default_factory=list[str])
    """What might be wrong by more than the picture told, in words."""
    done: bool = False
    """Whether it came to its end."""

    @property
    def ok(self) -> bool:
        """Whether all is as the rig file says."""
        return self.done and not self.findings


def check(
    mover: Mover, person: Person, robot: Robot, thresholds: Thresholds, latency: float | None
) -> CheckReport:
    """Look, move a little, decide; `latency` (s) is what the rig file says of the camera's, None
    where nobody has measured it and frames are told as if exposed when they arrive."""
    report = CheckReport()
    try:
        _whole(report, mover, person, robot, thresholds, latency)
        report.done = True
    except Trouble as trouble:
        report.findings.append(trouble.finding)
    except Stopped as stopped:
        words = "to its end, with every motion agreed to"
        report.findings.append(Finding("the check was ended", "person", str(stopped), words))
    finally:
        mover.off()
    return report


def warm_up(robot: Robot, gate: Gate) -> None:
    """Have all compiled before an arm is connected, which must not wait for it."""
    command = gate.admit(np.zeros(3), gate.rest(), np.zeros(3), robot.mechanism.rcm(), 1).command
    gate.stop(command, 2)
    drive_lag(Track(answers=[(k, np.zeros(3), np.zeros(3)) for k in range(3)]), np.ones(3))
    q = np.array(robot.mechanism.limits.arrays).mean(axis=0)
    robot.way(q, 0)
    places(Guess(), robot, q[None], q, 0.0)


def _whole(
    report: CheckReport,
    mover: Mover,
    person: Person,
    robot: Robot,
    thresholds: Thresholds,
    latency: float | None,
) -> None:
    _require_homed(mover)
    report.rest = rest = _look(report, mover, robot)
    person.tell(
        "Each motion is asked for. It is slow, a few mm at most, and the drive is on only "
        "meanwhile. Have a hand on the emergency stop."
    )
    if one_of(person, "May the drive be switched on for that?", ("enable", "no")) == "no":
        raise Stopped("the drive may not be switched on")
    ranging = Ranging(mover, person, robot, rest)
    kinds = ranging.run(lambda joint: _alone(mover, person, ranging, joint))
    report.farthest = float(ranging.shown.max())
    _times(report, mover, person, ranging, thresholds, latency)
    _judge(report, mover, person, robot, ranging, kinds)


def _require_homed(mover: Mover) -> None:
    """Refuse an arm that does not know where it stands."""
    if not mover.arm.homed():
        raise Trouble(
            Finding(
                "the arm does not know where it stands",
                "arm",
                "nobody has said so since it was reset",
                "homed, or its position defined at a mark",
            )
        )


def _look(report: CheckReport, mover: Mover, robot: Robot) -> Sight:
    """What arm and camera tell while nothing moves."""
    rest = mover.look()
    report.q = rest.q
    report.arm = pace([time for time, _, _ in mover.track.answers])
    report.camera = pace([exposure for exposure, _, _ in mover.track.frames])
    limits = robot.mechanism.limits
    lower, upper = limits.arrays
    room = np.array([robot.way(rest.q, joint) * ROOM for joint in range(3)])
    near = (rest.q < lower + room) | (rest.q > upper - room)
    if not (~near).all():
        joint = int(np.argmax(near))
        raise Trouble(
            Finding(
                f"joint {joint + 1} ({robot.mechanism.joint_names[joint]}) is at a limit, or "
                "beyond it",
                f"mechanism.{'lower' if rest.q[joint] < lower[joint] + room[joint] else 'upper'}"
                f"[{joint}]",
                f"{rest.q[joint]:.4g}",
                f"{lower[joint]:.4g} to {upper[joint]:.4g}, with {ROOM:g} mm of room: bring the "
                "tool there by hand, or home the arm anew",
            )
        )
    if not report.camera.rate >= LEAST_RATE:
        rate = f"{report.camera.rate:.3g} frames/s"
        right = f"at least {LEAST_RATE:g} frames/s"
        report.findings.append(Finding("frames come seldom", "camera", rate, right))
    found = rest.frames / (rest.frames + rest.missed)
    if not found >= LEAST_FOUND:
        report.findings.append(
            Finding(
                "the markers are seen now and then only",
                "markers",
                f"both in {100 * found:.0f} % of the frames",
                f"{100 * LEAST_FOUND:.0f} %: light, focus, and the colours in [markers]",
            )
        )
    return rest


def _alone(mover: Mover, person: Person, ranging: Ranging, joint: int) -> None:
    """An arm that is sent speeds must come to rest by itself once nothing is sent, or nothing more
    moves."""
    if not (isinstance(mover.arm, FallsSilent) and mover.arm.by_speeds):
        return
    way = float(ranging.ways[joint])
    agreed(person, ranging.question(joint, way, ", and be left alone on the way"))
    if not mover.left_alone(joint, way):
        raise Trouble(
            Finding(
                "the arm goes on when nothing is sent",
                "arm.jv",
                f"joint {joint + 1} still moved when nothing had been sent for {AT_REST:g} s",
                "at rest by itself: send it positions",
                "jv = false",
            )
        )


def _times(
    report: CheckReport,
    mover: Mover,
    person: Person,
    ranging: Ranging,
    thresholds: Thresholds,
    latency: float | None,
) -> None:
    """How late frames come and drives follow."""
    joint = int(np.argmax(ranging.shown))
    way = ranging.next_way(joint)
    agreed(person, ranging.question(joint, way, f" to and fro, {SWINGS} times"))
    track = mover.to_and_fro(joint, way, SWINGS)
    report.lateness = late = lateness(track, joint)
    report.lag = drive_lag(track, np.array(mover.gate.speed))
    if late is None:
        report.findings.append(
            Finding(
                "how late frames are cannot be told",
                "camera.latency",
                f"too few frames with both markers while joint {joint + 1} moved",
                "both markers in nearly every frame",
            )
        )
    else:
        report.findings += wrongly_late(late, latency)
    known = thresholds.drive_lag > 0.0 and report.lag > 0.0
    if known and not abs(report.lag - thresholds.drive_lag) <= LAG_OFF:
        report.findings.append(
            Finding(
                "the drives follow otherwise",
                "thresholds.drive_lag",
                f"{thresholds.drive_lag:g} s",
                f"{report.lag:.3f} s",
                f"drive_lag = {report.lag:.3f}",
            )
        )


def _judge(
    report: CheckReport,
    mover: Mover,
    person: Person,
    robot: Robot,
    ranging: Ranging,
    kinds: list[Weighed],
) -> None:
    """What is wrong with the rig file."""
    seen = ranging.seen()
    if not explains(kinds[0], seen):
        report.findings.append(
            Finding(
                "no single mistake explains what was seen",
                "arm, mechanism, tool, markers",
                f"the nearest leaves over {np.sqrt(kinds[0].misfit / seen.points.size):.1f} times "
                "the noise",
                "one mistake at most: look at all of [arm], [mechanism], [tool] and [markers]",
            )
        )
        return

    def show(joint: int) -> None:
        way = ranging.next_way(joint)
        agreed(person, ranging.question(joint, way))
        mover.there_and_back(joint, (way,), ranging.reach(joint, way))

    plain = [kind.guess for kind in kinds if kind.guess.wrong == RIGHT]
    unclear = [one for guess in plain for one in ranging.unclear(guess)]
    report.unclear = sorted({may_pass(one, robot) for one in unclear})
    for words in report.unclear:
        person.tell(f"{words}: measure it by hand.")
    start = ranging.start
    named = {m for kind in kinds for m in members(kind)}
    report.undecided = sorted({"; ".join(told(m, robot)) for m in named})
    left = decided(kinds, robot, start, person, show, ranging.next_way)
    for number, guess in enumerate(left, start=1):
        which = f"{POSSIBILITY} {number} of {len(left)}: " if len(left) > 1 else ""
        found = findings(guess, robot)
        report.findings += [replace(one, what=which + one.what) for one in found]


def told(guess: Guess, robot: Robot) -> list[str]:
    """A guess in words."""
    found = findings(guess, robot)
    return [f"{one.where}: {one.what}" for one in found] or ["all as the rig file says"]
