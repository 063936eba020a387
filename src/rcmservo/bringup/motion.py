"""Small monitored motions of one joint, from the present joints and back.

The drive is on only during motions. Commands pass the safety gate at a tenth of its speed. The
check aborts with the drive off if a joint does not follow its commands, moves too far or moves
together with another joint, if the drive switches off by itself, or if the arm or the camera stops
sending data.
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
"""Command rate (1/s)."""
POLL_RATE = 1000.0
"""Rate (1/s) of readings with the drive off; above the devices' rates, which are measured."""
SPEED_SCALE = 0.1
"""Fraction of the safety gate's speed that motions use."""
GAIN = 3.0
"""Proportional gain (1/s) of a joint's motion to its goal."""
ARRIVAL_FRACTION = 0.03
"""Remaining distance, as a fraction of the motion, at which a joint has arrived."""
STUCK_FRACTION, STUCK_TIME = 0.3, 0.3
"""Remaining distance, as a fraction of the motion, that friction may leave; it counts as arrival if
the joint stands still for this time (s)."""
MOTION_TIMEOUT = 8.0
"""Time (s) within which a joint must arrive."""
MAX_OVERSHOOT = 1.2
"""Largest distance of the joint from its start, as a fraction of the agreed motion."""
MAX_LAG = 1.2
"""Largest distance of the joint behind its commands, as a fraction of the agreed motion."""
MAX_COUPLING = 0.4
"""Largest motion of another joint in counts, as a fraction of the agreed motion in counts."""
PLAY_COUNTS = 4.0
"""Encoder counts that do not count as motion."""
SETTLING_TIME = 0.25
"""Time (s) after the arrival until joint and image are at rest."""
AVERAGED_FRAMES = 60
"""Frames over which the markers are averaged at rest."""
MIN_VISIBLE_FRACTION = 0.5
"""Smallest fraction of the frames with both markers; below it the check aborts."""
INTERRUPT_FRACTION = 0.3
"""Fraction of a motion after which the test of a rate-controlled arm interrupts its commands."""
INTERRUPT_TIME, REST_TIME = 0.4, 0.15
"""Duration (s) of that interruption, and time (s) after which the arm must be at rest."""
DRIVEN_FRAME_TIMEOUT = 0.5
"""Time (s) without a frame after which a motion ends, with the drive on."""
IDLE_TIMEOUT = 3.0
"""Time (s) without a frame or an answer of the arm after which the check aborts, drive off."""
DEFAULT_SIZE = 640, 480
"""Assumed image size (px) of a camera that delivers markers without images."""


class Leg:
    """Motion of one joint to a goal, with the quantities that are monitored.

    A whole motion has several legs: to each offset, and back.

    Parameters
    ----------
    joint : int
        Index of the joint.
    offset : float
        Goal relative to `home` in rad or mm.
    limit : float
        Largest agreed distance from `home` in rad or mm.
    home : Floats
        Joints (3,) at the start of the whole motion.
    """

    def __init__(self, joint: int, offset: float, limit: float, home: Floats) -> None:
        self.joint, self.limit, self.home = joint, limit, home
        self.goal = home + offset * np.eye(3)[joint]
        self.start = home
        """Joints (3,) at the start of this leg."""
        self.commanded = np.zeros(3)
        """Commanded motion (3,) since `start`."""


class Mover:
    """Small motions of an arm, monitored by its encoders and a camera.

    Parameters
    ----------
    arm : LabArm
        Arm to move.
    camera : Camera
        Camera that observes the markers.
    tracker : Tracker
        Tracker of the markers.
    clock : Clock
        Clock of the plant.
    robot : Robot
        Arm as the rig file describes it.
    gate : Gate
        Limits of the commands.
    answer_timeout : float
        Longest time (s) without an answer of the arm while its drive is on.
    trouble : Callable[[], str]
        Function that describes the present fault of the camera; empty if there is none.
    """

    def __init__(
        self,
        arm: LabArm,
        camera: Camera,
        tracker: Tracker,
        clock: Clock,
        robot: Robot,
        gate: Gate,
        answer_timeout: float,
        trouble: Callable[[], str],
    ) -> None:
        self.arm, self.clock, self.robot, self.gate = arm, clock, robot, gate
        self._answer_timeout, self._describe_camera_fault = answer_timeout, trouble
        self.trace = MotionTrace()
        """Answers and frames of the last motion."""
        self.size = DEFAULT_SIZE
        """Width and height of the image in px."""
        self.plant = Plant(arm, camera, tracker, clock)
        self._rcm = robot.mechanism.to_struct()
        self._steps = robot.wiring.steps
        self._last_command = gate.rest()
        self._leg = Leg(0, 0.0, 0.0, np.zeros(3))
        self._frame, self._is_new = -1, False

    def switch_off(self) -> None:
        """Command zero rates and switch the drive off."""
        self._last_command = self.gate.stop(self._last_command, self.clock.now())
        self.plant.send(self._last_command)

    def observe_at_rest(self) -> StillView:
        """Average joints and markers with the drive off."""
        self._begin()
        return self._average()

    def visit(
        self, joint: int, offsets: Sequence[float], bound: PixelBound | None = None
    ) -> list[StillView]:
        """Move a joint to each of `offsets` (rad or mm) from its present position, then back.

        With a `bound`, the joint rests at each offset and the markers are averaged there. If a
        marker leaves the bound, the joint returns and omits the other offsets. Without a bound it
        rests only at the end.

        Returns
        -------
        list[StillView]
            One view per rest; the last one is at the initial position.

        Raises
        ------
        CheckAborted
            If a monitored quantity exceeds its limit, the joint does not arrive in time, or
            measurements are missing.
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

    def stops_without_commands(self, joint: int, offset: float) -> bool:
        """Interrupt the commands of a rate-controlled arm in motion; return whether it stops.

        The joint moves by `offset` (rad or mm) at most.
        """
        assert isinstance(self.arm, SuspendsCommunication)
        positions: list[float] = []
        with self._driving() as home:
            self._leg = leg = Leg(joint, offset, offset, home)
            for _ in ticks(self.clock, TICK_RATE, MOTION_TIMEOUT):
                if abs(self._tick(leg.goal)[joint] - home[joint]) >= INTERRUPT_FRACTION * offset:
                    break
            self.arm.suspend_communication()
            for _ in ticks(self.clock, TICK_RATE, INTERRUPT_TIME):
                positions.append(float(self._read().q[joint]))
                if not abs(positions[-1] - home[joint]) <= offset:
                    break
        at_rest = positions[round(REST_TIME * TICK_RATE) :]
        return bool(at_rest) and max(at_rest) - min(at_rest) <= PLAY_COUNTS * self._steps[joint]

    @contextmanager
    def _driving(self) -> Generator[Floats]:
        """Switch the drive on, yield the present joints (3,), and always switch it off again."""
        home = self._begin()
        try:
            self.plant.enable()
            yield home
        finally:
            self.switch_off()

    def _begin(self) -> Floats:
        """Discard earlier observations, wait for a frame, and return the present joints (3,).

        The first search for the markers takes longer than tracking, hence the wait.
        """
        self.trace, self._frame = MotionTrace(), -1
        self.plant.reset()
        start_ns = self.clock.now()
        for _ in ticks(self.clock, POLL_RATE):
            observation = self._read()
            if self._is_new:
                return observation.q.copy()
            self._require_frames(start_ns, IDLE_TIMEOUT)
        raise AssertionError("ticks without a duration never end")

    def _go(self, leg: Leg, bound: PixelBound | None = None) -> bool:
        """Move a joint to its goal; return False if a marker leaves the bound before that."""
        joint, step = leg.joint, float(self._steps[leg.joint])
        leg.start = last_q = q = self._read().q.copy()
        self._leg, still_since_ns = leg, self.clock.now()
        for _ in ticks(self.clock, TICK_RATE, MOTION_TIMEOUT):
            q = self._tick(leg.goal)
            if abs(q[joint] - last_q[joint]) > 0.5 * step:
                last_q, still_since_ns = q, self.clock.now()
            tolerance = max(ARRIVAL_FRACTION * leg.limit, 1.5 * step)
            if self.clock.now() - still_since_ns > STUCK_TIME * 1e9:
                tolerance = max(STUCK_FRACTION * leg.limit, PLAY_COUNTS * step)
            if abs(q[joint] - leg.goal[joint]) <= tolerance:
                return True
            if bound is not None and self._is_new and bound.is_exceeded(self.trace.frames[-1][2]):
                return False
        raise self._describe_mismatch(q - leg.start, f"no arrival within {MOTION_TIMEOUT:g} s")

    def _average(self) -> StillView:
        """Hold the position, with the drive on or off, and average joints and markers."""
        points, joints = list[Floats](), list[Floats]()
        missed, start_ns = 0, self.clock.now()
        newest_frame_ns, is_driven = start_ns, self._last_command.enabled
        for _ in ticks(self.clock, TICK_RATE if is_driven else POLL_RATE):
            q = self._tick(None) if is_driven else self._read().q
            timeout_s = DRIVEN_FRAME_TIMEOUT if is_driven else IDLE_TIMEOUT
            self._require_frames(newest_frame_ns, timeout_s)
            if not self._is_new:
                continue
            newest_frame_ns = self.clock.now()
            exposure_ns, _, markers = self.trace.frames[-1]
            if exposure_ns < start_ns + round(SETTLING_TIME * 1e9):
                continue
            joints.append(q)
            if np.isfinite(markers).all():
                points.append(markers)
            else:
                missed += 1
            if missed > AVERAGED_FRAMES / MIN_VISIBLE_FRACTION - AVERAGED_FRAMES:
                raise CheckAborted(
                    "the markers are not visible",
                    "markers",
                    f"both in {len(points)} of {len(points) + missed} frames",
                    "both in nearly every frame: check light, focus, and the colours in [markers]",
                )
            if len(points) >= AVERAGED_FRAMES:
                break
        noise = float(np.std(points, axis=0, ddof=1).mean())
        mean_q, mean_points = np.mean(joints, axis=0), np.mean(points, axis=0)
        return StillView(mean_q, mean_points, noise, len(points), missed)

    def _require_frames(self, newest_frame_ns: int, timeout_s: float) -> None:
        if not self.clock.now() - newest_frame_ns <= timeout_s * 1e9:
            found = self._describe_camera_fault() or f"no frame for {timeout_s:g} s"
            raise CheckAborted("the camera sends no frames", "camera", found, "continuous frames")

    def _tick(self, goal: Floats | None) -> Floats:
        """Send one command towards `goal` (3,), or zero rates; return the joints read before."""
        observation = self._read()
        if not observation.enabled:
            found = self.arm.off_reason or "the arm reports no reason"
            expected = "drive on until the check switches it off"
            raise CheckAborted("the drive switched off by itself", "arm", found, expected)
        q = observation.q
        self._monitor(q)
        error = np.zeros(3) if goal is None else goal - q
        rates = np.where(np.abs(error) < self._steps, 0.0, GAIN * error)
        self._last_command = self.gate.admit(
            rates, self._last_command, q, self._rcm, observation.now, SPEED_SCALE
        ).command
        self._leg.commanded = self._leg.commanded + self.plant.send(self._last_command) / TICK_RATE
        return q.copy()

    def _read(self) -> Observation:
        """Read arm and camera, and record new answers and frames."""
        observation = self.plant.read()
        timeout_s = self._answer_timeout if self._last_command.enabled else IDLE_TIMEOUT
        answers, answer_ns = self.trace.answers, observation.q_time
        if not observation.now - answer_ns <= timeout_s * 1e9:
            found = self.arm.off_reason or f"no answer for {timeout_s:g} s"
            raise CheckAborted("the arm does not answer", "arm", found, "an answer in every tick")
        if not answers or answer_ns > answers[-1][0]:
            answers.append((answer_ns, observation.q, observation.applied))
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
        """Abort if the joint moves further than agreed, lags too much, or another joint moves."""
        leg, motion = self._leg, q - self._leg.home
        counts, agreed_counts = np.abs(motion) / self._steps, leg.limit / self._steps[leg.joint]
        lag_counts = abs(leg.commanded - (q - leg.start))[leg.joint] / self._steps[leg.joint]
        other_counts = np.delete(counts, leg.joint)
        if not counts[leg.joint] <= MAX_OVERSHOOT * agreed_counts + PLAY_COUNTS:
            raise self._describe_mismatch(motion, "it moves further than agreed")
        if not other_counts.max() <= MAX_COUPLING * agreed_counts + PLAY_COUNTS:
            raise self._describe_mismatch(motion, "another joint counts")
        if not lag_counts <= MAX_LAG * agreed_counts + PLAY_COUNTS:
            raise self._describe_mismatch(q - leg.start, "it does not follow")

    def _describe_mismatch(self, motion: Floats, reason: str) -> CheckAborted:
        """Return the exception for a motion (3,) that differs from its command."""
        joint = f"joint {self._leg.joint + 1}"
        counts = ", ".join(f"{count:+.0f}" for count in motion / self._steps)
        return CheckAborted(
            f"{joint} does not move as commanded: {reason}",
            joint,
            f"counts of joints 1, 2, 3: {counts}",
            f"counts of {joint} alone: check brake, motor and encoder cables",
        )
