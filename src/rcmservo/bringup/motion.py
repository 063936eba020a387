"""Moving one joint a little, there and back, and looking all the while.

A person has switched the drive on, and says yes to each motion; it is on only while something
moves. What goes out passes the gate with a tenth of its speed. A joint that does not go, another
that goes with it, a longer way than was asked for, a drive that goes off by itself, an arm or a
camera that falls silent: then the drive goes off, and nothing more moves.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rcmservo.bringup.sights import Reach, Sight, Track
from rcmservo.bringup.troubles import (
    Trouble,
    astray,
    silent_arm,
    silent_camera,
    unseen,
    went_off,
)
from rcmservo.bringup.wiring import Robot
from rcmservo.guard.gate import Gate
from rcmservo.interfaces import Camera, Clock, Floats, Observation, Tracker
from rcmservo.live.lab import FallsSilent, LabArm
from rcmservo.loop.clock import ticks
from rcmservo.loop.plant import Plant

RATE = 100.0
"""Ticks per s."""
OFTEN = 1000.0
"""Looks per s with the drive off, so that the rates told are the devices' own."""
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


@dataclass(frozen=True, eq=False)
class Leg:
    """What is watched for while the drive is on."""

    joint: int
    """The joint that moves."""
    way: float
    """rad or mm that it may be from `here` at most."""
    here: Floats
    """The joints (3,) where the motion began,"""
    began: Floats
    """and where this part of it did."""


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
        self._leg = Leg(0, 0.0, np.zeros(3), np.zeros(3))
        self._asked, self._silence = np.zeros(3), silence
        self._frame, self._new = -1, False

    def off(self) -> None:
        """Zero and off, now."""
        self._last = self.gate.stop(self._last, self.clock.now())
        self.plant.send(self._last)

    def look(self, frames: int = FRAMES) -> Sight:
        """What is seen with the drive off."""
        self._begin()
        return self._averaged(frames)

    def there_and_back(self, joint: int, ways: Sequence[float], reach: Reach) -> list[Sight]:
        """Move a joint to places that are so far (rad or mm) from here, one after the other, and
        back again; what is seen at each. Where the markers leave their reach it turns back, and
        goes to none of the other places. Whatever happens, the drive is off then."""
        here = self._begin()
        sights: list[Sight] = []
        most = max(map(abs, ways))
        try:
            self.plant.enable()
            for way in ways:
                wanted = here.copy()
                wanted[joint] += way
                there = self._go(joint, wanted, here, most, reach)
                sights.append(self._averaged(FRAMES))
                if not there:
                    break
            self._go(joint, here, here, most)
            sights.append(self._averaged(FRAMES))
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
            self._averaged(5)
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
            self._set_out(Leg(joint, way, here, here))
            for _ in ticks(self.clock, RATE, WITHIN):
                if abs(self._tick(wanted)[joint] - here[joint]) >= UNDER_WAY * way:
                    break
            self.arm.fall_silent()
            for _ in ticks(self.clock, RATE, ALONE):
                places.append(float(self._read().q[joint]))
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
        for _ in ticks(self.clock, OFTEN):
            seen = self._read()
            if self._new:
                return seen.q.copy()
            if not self.clock.now() - began <= PATIENCE * 1e9:
                break
        raise Trouble(silent_camera(self._trouble(), PATIENCE))

    def _go(
        self, joint: int, wanted: Floats, here: Floats, way: float, reach: Reach | None = None
    ) -> bool:
        """Bring the joint to its place, `way` from `here` at most; whether it is there, and not
        where the markers left their reach."""
        count = float(self._count[joint])
        began = last = q = self._read().q.copy()
        self._set_out(Leg(joint, way, here, began))
        since = self.clock.now()
        for _ in ticks(self.clock, RATE, WITHIN):
            q = self._tick(wanted)
            if abs(q[joint] - last[joint]) > 0.5 * count:
                last, since = q, self.clock.now()
            stands = self.clock.now() - since > STANDS * 1e9
            near = max(NEARLY * way, PLAY * count) if stands else max(ARRIVED * way, 1.5 * count)
            if abs(q[joint] - wanted[joint]) <= near:
                return True
            if reach is not None and self._new and reach.left(self.track.frames[-1][2]):
                return False
        raise Trouble(astray(joint, (q - began) / self._count, f"not there within {WITHIN:g} s"))

    def _set_out(self, leg: Leg) -> None:
        self._leg, self._asked = leg, np.zeros(3)

    def _averaged(self, most: int) -> Sight:
        """Stay here, with the drive on or off, and average what is seen."""
        points: list[Floats] = []
        joints: list[Floats] = []
        missed, began = 0, self.clock.now()
        newest = began
        on = self._last.enabled
        for _ in ticks(self.clock, RATE if on else OFTEN):
            q = self._tick(None) if on else self._read().q
            patience = UNSEEN if on else PATIENCE
            if not self.clock.now() - newest <= patience * 1e9:
                raise Trouble(silent_camera(self._trouble(), patience))
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
            raise Trouble(unseen(len(points), missed))
        noise = float(np.std(points, axis=0, ddof=1).mean())
        q, mean = np.mean(joints, axis=0), np.mean(points, axis=0)
        return Sight(q, mean, noise, len(points), missed)

    def _tick(self, wanted: Floats | None) -> Floats:
        """One command towards the joints wanted, or to stay; the joints that were told before."""
        seen = self._read()
        if not seen.enabled:
            raise Trouble(went_off(self.arm.why_off))
        self._watch(self._leg, seen.q)
        apart = np.zeros(3) if wanted is None else wanted - seen.q
        rates = np.where(np.abs(apart) < self._count, 0.0, GAIN * apart)
        self._last = self.gate.admit(rates, self._last, seen.q, self._rcm, seen.now, SHARE).command
        self._asked = self._asked + self.plant.send(self._last) / RATE
        return seen.q.copy()

    def _read(self) -> Observation:
        """What arm and camera tell."""
        seen = self.plant.read()
        patience = self._silence if self._last.enabled else PATIENCE
        if not seen.now - seen.q_time <= patience * 1e9:
            raise Trouble(silent_arm(self.arm.why_off, patience))
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

    def _watch(self, leg: Leg, q: Floats) -> None:
        """End it where a joint goes further than was asked for, does not follow, or takes another
        one with it."""
        joint, moved, gone = leg.joint, q - leg.here, q - leg.began
        counts, allowed = np.abs(moved) / self._count, leg.way / self._count[joint]
        behind = abs(self._asked[joint] - gone[joint]) / self._count[joint]
        if not counts[joint] <= OVER * allowed + PLAY:
            raise Trouble(astray(joint, moved / self._count, "further than was asked for"))
        others = [k for k in range(3) if k != joint]
        if not max(counts[k] for k in others) <= ASIDE * allowed + PLAY:
            raise Trouble(astray(joint, moved / self._count, "another joint counts"))
        if not behind <= BEHIND * 2.0 * allowed + PLAY:
            raise Trouble(astray(joint, gone / self._count, "it does not follow"))
