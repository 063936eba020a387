"""Small guarded motions of one joint, there and back, under observation.

An operator has switched the drive on and says yes to each motion; the drive is on only while
something moves. Commands pass the gate at a tenth of its speed. The drive goes off, and nothing
moves any more, if a joint does not follow or moves too far, another joint moves with it, the drive
goes off by itself, or the arm or the camera falls silent.
"""

from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager

import numpy as np

from rcmservo.bringup.axis_wiring import Robot
from rcmservo.bringup.findings import CheckAborted
from rcmservo.bringup.observations import MotionTrace, PixelBound, StillView
from rcmservo.interfaces import Camera, Clock, Floats, Observation, Tracker
from rcmservo.live.device_protocols import LabArm, SuspendsCommunication
from rcmservo.loop.clock import ticks
from rcmservo.loop.plant import Plant
from rcmservo.safety.gate import Gate

TICK_RATE = 100.0
"""Commands per s."""
POLL_RATE = 1000.0
"""Readings per s with the drive off, so that the measured rates are those of the devices."""
SPEED_SCALE = 0.1
"""Fraction of the gate's speed that is used."""
GAIN = 3.0
"""Gain (1/s) of a joint's motion to its place."""
ARRIVED = 0.03
"""Fraction of its motion within which a joint has arrived,"""
NEARLY_ARRIVED, STUCK_TIME = 0.3, 0.3
"""or, where it has stood still for so many s, because friction holds it."""
MOTION_TIMEOUT = 8.0
"""Time (s) within which it must arrive."""
MAX_OVERSHOOT = 1.2
"""Fraction of the agreed motion that the joint may move,"""
MAX_LAG = 1.2
"""that it may be behind its commands,"""
MAX_COUPLING = 0.4
"""and that another joint may move with it."""
PLAY_COUNTS = 4.0
"""Counts that are no motion."""
SETTLING_TIME = 0.25
"""Time (s) after which a joint that arrived is at rest, and the picture of it."""
FRAMES = 60
"""Frames over which the markers are averaged at rest."""
MIN_SEEN = 0.5
"""Fraction of the frames that must show both markers."""
UNDER_WAY = 0.3
"""Fraction of its motion after which an arm is left alone,"""
ALONE_TIME, REST_TIME = 0.4, 0.15
"""for how long (s), and the time (s) after which it must be at rest."""
DRIVEN_PATIENCE = 0.5
"""Time (s) without a frame after which a motion ends while the drive is on."""
PATIENCE = 3.0
"""Time (s) without a frame, or without an answer of the arm, while it is off."""
DEFAULT_SIZE = 640, 480
"""Size (px) of the picture of a camera that delivers the markers alone."""


class Leg:
    """Part of a motion of one joint from `home` (3,), and what is monitored in it.

    ``offset`` is its goal from home and ``limit`` the largest distance from there, rad or mm.
    """

    def __init__(self, joint: int, offset: float, limit: float, home: Floats) -> None:
        self.joint, self.limit, self.home = joint, limit, home
        self.goal = home.copy()
        self.goal[joint] += offset
        self.start = home
        """The joints (3,) where this part began."""
        self.commanded = np.zeros(3)
        """Motion (3,) commanded since then."""


class Mover:
    """An arm that makes the small motions to which an operator has agreed, watched by a camera.

    While its drive is on, the arm may not answer for ``silence`` s at most. ``trouble`` returns
    what is wrong with the camera.
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
        self.arm, self.clock, self.robot, self.gate = arm, clock, robot, gate
        self._silence, self._trouble = silence, trouble
        self.trace = MotionTrace()
        """All answers and frames of the last motion."""
        self.size = DEFAULT_SIZE
        """Size of the picture, px."""
        self.plant = Plant(arm, camera, tracker, clock)
        self._rcm = robot.mechanism.rcm()
        self._steps = robot.wiring.steps
        self._last = gate.rest()
        self._leg = Leg(0, 0.0, 0.0, np.zeros(3))
        self._frame, self._is_new = -1, False

    def off(self) -> None:
        """Send zero and switch the drive off."""
        self._last = self.gate.stop(self._last, self.clock.now())
        self.plant.send(self._last)

    def look(self) -> StillView:
        """Average joints and markers with the drive off."""
        self._begin()
        return self._average()

    def visit(
        self, joint: int, offsets: Sequence[float], bound: PixelBound | None = None
    ) -> list[StillView]:
        """Move a joint to offsets (rad or mm) from here, one after the other, and back again.

        With a bound on the markers it rests at each offset, and where they leave the bound it turns
        back and goes to none of the others. Without, it rests at the end only.
        """
        views: list[StillView] = []
        limit = max(map(abs, offsets))
        with self._driving() as home:
            for offset in offsets:
                has_arrived = self._go(Leg(joint, offset, limit, home), bound)
                if bound is not None:
                    views.append(self._average())
                if not has_arrived:
                    break
            self._go(Leg(joint, 0.0, limit, home))
            views.append(self._average())
        return views

    def stops_by_itself(self, joint: int, offset: float) -> bool:
        """Return whether an arm that takes rates comes to rest once nothing is sent, while a joint
        moves by an offset at most.
        """
        assert isinstance(self.arm, SuspendsCommunication)
        path: list[float] = []
        with self._driving() as home:
            self._leg = leg = Leg(joint, offset, offset, home)
            for _ in ticks(self.clock, TICK_RATE, MOTION_TIMEOUT):
                if abs(self._tick(leg.goal)[joint] - home[joint]) >= UNDER_WAY * offset:
                    break
            self.arm.fall_silent()
            for _ in ticks(self.clock, TICK_RATE, ALONE_TIME):
                path.append(float(self._read().q[joint]))
                if not abs(path[-1] - home[joint]) <= offset:
                    break
        rest = path[round(REST_TIME * TICK_RATE) :]
        return bool(rest) and max(rest) - min(rest) <= PLAY_COUNTS * self._steps[joint]

    @contextmanager
    def _driving(self) -> Generator[Floats]:
        """Switch the drive on for a motion from the present joints (3,), and off whatever
        happens.
        """
        home = self._begin()
        try:
            self.plant.enable()
            yield home
        finally:
            self.off()

    def _begin(self) -> Floats:
        """Forget earlier observations and wait for the first markers, which take longer to find;
        return the present joints.
        """
        self.trace, self._frame = MotionTrace(), -1
        self.plant.reset()
        began = self.clock.now()
        for _ in ticks(self.clock, POLL_RATE):
            observation = self._read()
            if self._is_new:
                return observation.q.copy()
            self._require_frames(began, PATIENCE)
        raise AssertionError("ticks without a duration never end")

    def _go(self, leg: Leg, bound: PixelBound | None = None) -> bool:
        """Bring a joint to its goal; return whether it arrived before the markers left a bound."""
        joint, step = leg.joint, float(self._steps[leg.joint])
        leg.start = last = q = self._read().q.copy()
        self._leg, since = leg, self.clock.now()
        for _ in ticks(self.clock, TICK_RATE, MOTION_TIMEOUT):
            q = self._tick(leg.goal)
            if abs(q[joint] - last[joint]) > 0.5 * step:
                last, since = q, self.clock.now()
            near = max(ARRIVED * leg.limit, 1.5 * step)
            if self.clock.now() - since > STUCK_TIME * 1e9:
                near = max(NEARLY_ARRIVED * leg.limit, PLAY_COUNTS * step)
            if abs(q[joint] - leg.goal[joint]) <= near:
                return True
            if bound is not None and self._is_new and bound.is_left(self.trace.frames[-1][2]):
                return False
        raise self._astray(q - leg.start, f"not there within {MOTION_TIMEOUT:g} s")

    def _average(self) -> StillView:
        """Stay here, with the drive on or off, and average joints and markers."""
        points, joints = list[Floats](), list[Floats]()
        missed, began = 0, self.clock.now()
        newest, on = began, self._last.enabled
        for _ in ticks(self.clock, TICK_RATE if on else POLL_RATE):
            q = self._tick(None) if on else self._read().q
            self._require_frames(newest, DRIVEN_PATIENCE if on else PATIENCE)
            if not self._is_new:
                continue
            newest = self.clock.now()
            exposure, _, markers = self.trace.frames[-1]
            if exposure < began + round(SETTLING_TIME * 1e9):
                continue
            joints.append(q)
            if np.isfinite(markers).all():
                points.append(markers)
            else:
                missed += 1
            if missed > FRAMES / MIN_SEEN - FRAMES:
                raise CheckAborted(
                    "the markers are not seen",
                    "markers",
                    f"both in {len(points)} of {len(points) + missed} frames",
                    "both in nearly every frame: light, focus, and the colours in [markers]",
                )
            if len(points) >= FRAMES:
                break
        noise = float(np.std(points, axis=0, ddof=1).mean())
        q, mean = np.mean(joints, axis=0), np.mean(points, axis=0)
        return StillView(q, mean, noise, len(points), missed)

    def _require_frames(self, newest: int, patience: float) -> None:
        if not self.clock.now() - newest <= patience * 1e9:
            found = self._trouble() or f"no frame for {patience:g} s"
            raise CheckAborted("no frames come", "camera", found, "frames all the time")

    def _tick(self, goal: Floats | None) -> Floats:
        """Send one command towards the goal (3,), or to stay; return the joints read before."""
        observation = self._read()
        if not observation.enabled:
            found = self.arm.why_off or "the arm reports no reason"
            expected = "on until it is switched off"
            raise CheckAborted("the drive went off by itself", "arm", found, expected)
        q = observation.q
        self._monitor(q)
        error = np.zeros(3) if goal is None else goal - q
        rates = np.where(np.abs(error) < self._steps, 0.0, GAIN * error)
        passed = self.gate.admit(rates, self._last, q, self._rcm, observation.now, SPEED_SCALE)
        self._last = passed.command
        self._leg.commanded = self._leg.commanded + self.plant.send(self._last) / TICK_RATE
        return q.copy()

    def _read(self) -> Observation:
        """Read arm and camera, and record new answers and frames."""
        observation = self.plant.read()
        patience = self._silence if self._last.enabled else PATIENCE
        if not observation.now - observation.q_time <= patience * 1e9:
            found = self.arm.why_off or f"no answer for {patience:g} s"
            raise CheckAborted("the arm does not answer", "arm", found, "an answer in every tick")
        answers, time = self.trace.answers, observation.q_time
        if not answers or time > answers[-1][0]:
            answers.append((time, observation.q, observation.applied))
        self._is_new = observation.frame > self._frame
        if self._is_new:
            self._frame = observation.frame
            frame = observation.exposure, observation.arrival, observation.points
            self.trace.frames.append(frame)
            image = None if self.plant.frame is None else self.plant.frame.image
            if image is not None:
                self.size = image.shape[1], image.shape[0]
        return observation

    def _monitor(self, q: Floats) -> None:
        """Abort where a joint goes further than agreed, does not follow, or moves another one."""
        leg, moved = self._leg, q - self._leg.home
        counts, allowed = np.abs(moved) / self._steps, leg.limit / self._steps[leg.joint]
        lag = abs(leg.commanded - (q - leg.start))[leg.joint] / self._steps[leg.joint]
        others = np.delete(counts, leg.joint)
        if not counts[leg.joint] <= MAX_OVERSHOOT * allowed + PLAY_COUNTS:
            raise self._astray(moved, "further than was asked for")
        if not others.max() <= MAX_COUPLING * allowed + PLAY_COUNTS:
            raise self._astray(moved, "another joint counts")
        if not lag <= MAX_LAG * allowed + PLAY_COUNTS:
            raise self._astray(q - leg.start, "it does not follow")

    def _astray(self, moved: Floats, why: str) -> CheckAborted:
        """Return the abort of a motion whose joints moved (3,) otherwise than commanded."""
        joint = f"joint {self._leg.joint + 1}"
        counts = ", ".join(f"{count:+.0f}" for count in moved / self._steps)
        return CheckAborted(
            f"{joint} does not do as commanded: {why}",
            joint,
            f"counts of joints 1, 2, 3: {counts}",
            f"counts of {joint} alone: look at brake, motor and encoder cables",
        )
