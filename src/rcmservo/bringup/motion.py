"""Moving one joint a little, there and back, and looking all the while.

A person has switched the drive on, and says yes to each motion; it is on only while something
moves. What goes out passes the gate with a tenth of its speed. A joint that does not go, another
that goes with it, a longer way than was asked for, a drive that goes off by itself, an arm or a
camera that falls silent: then the drive goes off, and nothing more moves.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from rcmservo.bringup.wiring import Finding, Robot
from rcmservo.errors import RcmServoError
from rcmservo.guard.gate import Gate
from rcmservo.interfaces import Camera, Clock, Floats, Observation, Tracker
from rcmservo.live.lab import FallsSilent, LabArm
from rcmservo.loop.clock import ticks
from rcmservo.loop.plant import Plant

RATE = 100.0
"""Ticks per s."""
SHARE = 0.1
"""Of the gate's speed that is used."""
GAIN = 3.0
"""1/s with which a joint goes to its place."""
ARRIVED = 0.03
"""Share of its way within which it is there,"""
NEARLY = 0.3
"""or, where it stands still,"""
STANDS = 0.3
"""for so many s: friction holds it."""
WITHIN = 8.0
"""s within which it must be there."""
OVER = 1.2
"""Of the way asked for that it may go at most,"""
BEHIND = 0.6
"""and that it may be behind its commands;"""
ASIDE = 0.4
"""what another joint may go with it."""
PLAY = 4.0
"""Counts that are nothing."""
STILL = 0.25
"""s after which what has come to its place stands still, and the picture of it."""
FRAMES = 60
"""Over which the markers are averaged at rest."""
SEEN = 0.5
"""Share of the frames that must show both markers."""
UNDER_WAY = 0.3
"""Share of its way after which an arm is left alone,"""
ALONE, AT_REST = 0.4, 0.15
"""s for how long, and from when on it must be at rest."""
UNSEEN = 0.5
"""s without a frame after which it ends while the drive is on."""
PATIENCE = 3.0
"""s without a frame, or without an answer of the arm, while it is off."""

WITHOUT_PICTURE = 640, 480
"""px, of a camera that tells the markers' places alone."""


class Trouble(RcmServoError):
    """A motion that was ended, with the drive off, and why."""

    def __init__(self, finding: Finding) -> None:
        super().__init__(finding.what)
        self.finding = finding


@dataclass(frozen=True, eq=False)
class Sight:
    """The joints and the markers at one place, at rest."""

    q: Floats
    """The joints (3,) as the arm told them, the mean."""
    points: Floats
    """The markers (2, 2) px, the mean over frames."""
    noise: float
    """px, the standard deviation of a coordinate in one frame."""
    frames: int
    """In which both markers were seen, and"""
    missed: int
    """in which not."""

    @property
    def mean_noise(self) -> float:
        """px, that of a coordinate of the mean."""
        return self.noise / float(np.sqrt(self.frames))


@dataclass(eq=False)
class Track:
    """All that was told while something moved."""

    answers: list[tuple[int, Floats, Floats]] = field(
        default_factory=list[tuple[int, Floats, Floats]]
    )
    """When the joints were read (ns), the joints (3,), and the rates (3,) taken before."""
    frames: list[tuple[int, int, Floats]] = field(default_factory=list[tuple[int, int, Floats]])
    """When a frame was exposed and when it arrived (ns), and its markers (2, 2) px."""


class Mover:
    """An arm that moves a little where a person has said yes, and a camera that looks on.

    While its drive is on, the arm may not answer for ``silence`` s at most. ``trouble`` tells what
    is wrong with the camera.
    """

    def __init__(
        self,
        arm: LabArm,
        camera: Camera,
        tracker: Tracker,
        clock: Clock,
        robot: Robot,
        gate: Gate,
        silence: float,
        trouble: Callable[[], str],
    ) -> None:
        self.arm, self.clock, self.robot, self.gate, self._trouble = (
            arm,
            clock,
            robot,
            gate,
            trouble,
        )
        self.track = Track()
        """Of the last motion."""
        self.size = WITHOUT_PICTURE
        """px of the picture."""
        self.plant = Plant(arm, camera, tracker, clock)
        self._rcm = robot.mechanism.rcm()
        self._count = robot.wiring.steps
        self._last = gate.rest()
        self._asked, self._silence = np.zeros(3), silence
        self._frame, self._new = -1, False

    def off(self) -> None:
        """Zero and off, now."""
        self._last = self.gate.stop(self._last, self.clock.now())
        self.plant.send(self._last)

    def look(self, frames: int = FRAMES) -> Sight:
        """What is seen with the drive off."""
        self._begin()
        return self._averaged(None, frames)

    def there_and_back(self, joint: int, ways: Sequence[float]) -> list[Sight]:
        """Move a joint to places that are so far (rad or mm) from here, one after the other, and
        back again; what is seen at each. Whatever happens, the drive is off then."""
        here = self._begin()
        sights: list[Sight] = []
        try:
            self.plant.enable()
            for way in (*ways, 0.0):
                wanted = here.copy()
                wanted[joint] += way
                self._go(joint, wanted, here, max(map(abs, ways)))
                sights.append(self._averaged(wanted, FRAMES))
        finally:
            self.off()
        return sights

    def to_and_fro(self, joint: int, way: float, times: int) -> Track:
        """Move a joint so far to either side so many times, without a rest; what was told."""
        here = self._begin()
        try:
            self.plant.enable()
            for k in range(times + 1):
                wanted = here.copy()
                wanted[joint] += 0.0 if k == times else way if k % 2 == 0 else -way
                self._go(joint, wanted, here, way)
            self._averaged(here, 5)
        finally:
            self.off()
        return self.track

    def left_alone(self, joint: int, way: float) -> bool:
        """Whether an arm that is sent speeds comes to rest by itself once nothing is sent, while a
        joint moves by `way` at most. It is switched off in the end."""
        assert isinstance(self.arm, FallsSilent)
        here = self._begin()
        wanted, places = here.copy(), list[float]()
        wanted[joint] += way
        try:
            self.plant.enable()
            for _ in ticks(self.clock, RATE, WITHIN):
                gone = self._tick(wanted) - here
                self._watch(joint, gone, gone, way)
                if abs(gone[joint]) >= UNDER_WAY * way:
                    break
            self.arm.fall_silent()
            for _ in ticks(self.clock, RATE, ALONE):
                places.append(float(self.plant.read().q[joint]))
                if not abs(places[-1] - here[joint]) <= way:
                    break
        finally:
            self.off()
        rest = places[round(AT_REST * RATE) :]
        return bool(rest) and max(rest) - min(rest) <= PLAY * self._count[joint]

    def _begin(self) -> Floats:
        """Forget what was seen before, and wait until the markers were looked for anew, which takes
        longer at first; the joints now."""
        self.track, self._frame = Track(), -1
        self.plant.reset()
        began = self.clock.now()
        for _ in ticks(self.clock, RATE):
            seen = self._read()
            if self._new:
                return seen.q.copy()
            if not self.clock.now() - began <= PATIENCE * 1e9:
                break
        raise Trouble(_silent_camera(self._trouble(), PATIENCE))

    def _go(self, joint: int, wanted: Floats, here: Floats, way: float) -> None:
        """Bring the joint to its place, `way` from `here` at most."""
        count = float(self._count[joint])
        began = last = q = self._read().q.copy()
        self._asked, since = np.zeros(3), self.clock.now()
        for _ in ticks(self.clock, RATE, WITHIN):
            q = self._tick(wanted)
            self._watch(joint, q - here, q - began, way)
            if abs(q[joint] - last[joint]) > 0.5 * count:
                last, since = q, self.clock.now()
            stands = self.clock.now() - since > STANDS * 1e9
            near = max(NEARLY * way, PLAY * count) if stands else max(ARRIVED * way, 1.5 * count)
            if abs(q[joint] - wanted[joint]) <= near:
                return
        raise Trouble(self._astray(joint, q - began, f"not there within {WITHIN:g} s"))

    def _averaged(self, wanted: Floats | None, most: int) -> Sight:
        """Stay at the joints wanted, or with the drive off, and average what is seen."""
        points: list[Floats] = []
        joints: list[Floats] = []
        missed, began = 0, self.clock.now()
        newest = began
        for _ in ticks(self.clock, RATE):
            q = self._read().q if wanted is None else self._tick(wanted)
            patience = PATIENCE if wanted is None else UNSEEN
            if not self.clock.now() - newest <= patience * 1e9:
                raise Trouble(_silent_camera(self._trouble(), patience))
            if not self._new:
                continue
            newest = self.clock.now()
            exposure, _, seen = self.track.frames[-1]
            if exposure < began + round(STILL * 1e9):
                continue
            joints.append(q)
            if np.isfinite(seen).all():
                points.append(seen)
            else:
                missed += 1
            if len(points) >= most or missed > most / SEEN - most:
                break
        if missed > most / SEEN - most:
            raise Trouble(_unseen(len(points), missed))
        noise = float(np.std(points, axis=0, ddof=1).mean())
        q, mean = np.mean(joints, axis=0), np.mean(points, axis=0)
        return Sight(q, mean, noise, len(points), missed)

    def _tick(self, wanted: Floats) -> Floats:
        """One command towards the joints wanted; the joints that were told before."""
        seen = self._read()
        if not seen.enabled:
            raise Trouble(_went_off(self.arm.why_off))
        apart = wanted - seen.q
        rates = np.where(np.abs(apart) < self._count, 0.0, GAIN * apart)
        self._last = self.gate.admit(rates, self._last, seen.q, self._rcm, seen.now, SHARE).command
        self._asked = self._asked + self.plant.send(self._last) / RATE
        return seen.q.copy()

    def _read(self) -> Observation:
        """What arm and camera tell."""
        seen = self.plant.read()
        patience = self._silence if self._last.enabled else PATIENCE
        if not seen.now - seen.q_time <= patience * 1e9:
            raise Trouble(_silent_arm(self.arm.why_off, patience))
        answers = self.track.answers
        if not answers or seen.q_time > answers[-1][0]:
            answers.append((seen.q_time, seen.q, seen.applied))
        self._new = seen.frame > self._frame
        if self._new:
            self._frame = seen.frame
            self.track.frames.append((seen.exposure, seen.arrival, seen.points))
            image = None if self.plant.frame is None else self.plant.frame.image
            if image is not None:
                self.size = image.shape[1], image.shape[0]
        return seen

    def _watch(self, joint: int, moved: Floats, gone: Floats, way: float) -> None:
        """End it where a joint goes further than was asked for, does not follow, or takes another
        one with it."""
        counts, allowed = np.abs(moved) / self._count, way / self._count[joint]
        behind = abs(self._asked[joint] - gone[joint]) / self._count[joint]
        if not counts[joint] <= OVER * allowed + PLAY:
            raise Trouble(self._astray(joint, moved, "further than was asked for"))
        others = [k for k in range(3) if k != joint]
        if not max(counts[k] for k in others) <= ASIDE * allowed + PLAY:
            raise Trouble(self._astray(joint, moved, "another joint counts"))
        if not behind <= BEHIND * 2.0 * allowed + PLAY:
            raise Trouble(self._astray(joint, gone, "it does not follow"))

    def _astray(self, joint: int, moved: Floats, why: str) -> Finding:
        counts = ", ".join(f"{c:+.0f}" for c in moved / self._count)
        return Finding(
            f"joint {joint + 1} does not do what it is told: {why}",
            f"joint {joint + 1}",
            f"counts of joints 1, 2, 3: {counts}",
            f"counts of joint {joint + 1} alone: look at brake, motor and encoder cables",
        )


def _went_off(why: str) -> Finding:
    words = why or "the arm tells no reason"
    return Finding("the drive went off by itself", "arm", words, "on until it is switched off")


def _silent_arm(why: str, patience: float) -> Finding:
    words = why or f"no answer for {patience:g} s"
    return Finding("the arm does not answer", "arm", words, "an answer in every tick")


def _silent_camera(trouble: str, patience: float) -> Finding:
    words = trouble or f"no frame for {patience:g} s"
    return Finding("no frames come", "camera", words, "frames all the time")


def _unseen(seen: int, missed: int) -> Finding:
    return Finding(
        "the markers are not seen",
        "markers",
        f"both in {seen} of {seen + missed} frames",
        "both in nearly every frame: light, focus, and the colours in [markers]",
    )
