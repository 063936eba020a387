"""Camera that delivers changed frames, and changes that no disturbance of the simulator makes.

A change is made for one run by `misplace(0.05)(random, rig, start)`, with the time `start` in ns
from which on it acts. It returns the frame to deliver from the present one and the last delivered
one.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

import rcmservo as rs
from rcmservo.interfaces import Camera, Floats, Frame

ChangeFrame = Callable[[Frame, Frame | None], Frame]
MakeChange = Callable[[np.random.Generator, rs.sim.Rig, int], ChangeFrame]

MISPLACED_PX = 30.0, 100.0
"""Smallest and largest distance (px) of a wrong marker from its place."""

NOISE_PX = 0.3


class ChangedCamera:
    """Camera that delivers the frames of another one, changed if there is a `change`."""

    def __init__(self, camera: Camera, change: ChangeFrame | None = None) -> None:
        self.change = change
        self._camera = camera
        self._newest: Frame | None = None
        self._delivered: Frame | None = None

    def latest(self) -> Frame | None:
        newest = self._camera.latest()
        if newest is not None and newest is not self._newest:
            self._newest = newest
            self._delivered = self.change(newest, self._delivered) if self.change else newest
        return self._delivered


def misplace_marker(frame: Frame, random: np.random.Generator) -> Frame:
    """Return a frame with one marker 30 to 100 px from its place."""
    points, angle = get_points(frame).copy(), random.uniform(0.0, 2.0 * np.pi)
    distance = random.uniform(*MISPLACED_PX)
    points[random.integers(2)] += distance * np.array([np.cos(angle), np.sin(angle)])
    return replace(frame, points=points)


def get_points(frame: Frame) -> Floats:
    """Return the markers (2, 2) px of a frame of a camera of points."""
    assert frame.points is not None
    return frame.points


def swap_markers(frame: Frame, random: np.random.Generator) -> Frame:
    """Return a frame with each marker at the place of the other."""
    return replace(frame, points=get_points(frame)[::-1].copy())


def repeat_last(frame: Frame, delivered: Frame | None) -> Frame:
    """Return the frame with the content of the last one."""
    return frame if delivered is None else replace(frame, points=delivered.points)


def change_fraction(
    fraction: float, change: Callable[[Frame, np.random.Generator], Frame]
) -> MakeChange:
    """Return a change that acts in a random fraction of the frames."""

    def make(random: np.random.Generator, rig: rs.sim.Rig, start: int) -> ChangeFrame:
        def act(frame: Frame, _: Frame | None) -> Frame:
            is_changed = frame.exposure >= start and random.random() < fraction
            return change(frame, random) if is_changed else frame

        return act

    return make


def repeat_every(period: int) -> MakeChange:
    """Return a change that shows the last content again in every `period`-th frame."""

    def make(random: np.random.Generator, rig: rs.sim.Rig, start: int) -> ChangeFrame:
        return lambda frame, delivered: (
            frame if frame.number % period else repeat_last(frame, delivered)
        )

    return make


def freeze_with_noise(noise_px: float) -> MakeChange:
    """Return a change that shows the first picture from `start` on, with fresh noise."""

    def make(random: np.random.Generator, rig: rs.sim.Rig, start: int) -> ChangeFrame:
        held = list[Floats]()

        def act(frame: Frame, _: Frame | None) -> Frame:
            if frame.exposure < start:
                return frame
            held.append(get_points(frame))
            return replace(frame, points=held[0] + noise_px * random.standard_normal((2, 2)))

        return act

    return make


def release_joint(joint: int | None = None) -> MakeChange:
    """Return a change that shows the tool as if a joint, 0 to 2, no longer moved it.

    None draws the joint.
    """

    def make(random: np.random.Generator, rig: rs.sim.Rig, start: int) -> ChangeFrame:
        held = list[Floats]()
        released = int(random.integers(3)) if joint is None else joint

        def act(frame: Frame, _: Frame | None) -> Frame:
            if frame.exposure < start:
                return frame
            held.append(rig.truth.arm.joints_at(frame.exposure).copy())
            q = held[-1].copy()
            q[released] = held[0][released]
            points = rig.scene.optics.project(rig.body.points(q)[:2])
            return replace(frame, points=points + NOISE_PX * random.standard_normal((2, 2)))

        return act

    return make


def stand_still(random: np.random.Generator, rig: rs.sim.Rig, start: int) -> ChangeFrame:
    """Return a change that shows two things that do not move with the tool instead of the markers.

    They lie as far from each other as the markers in the first frame, somewhere else.
    """
    held = list[Floats]()

    def act(frame: Frame, _: Frame | None) -> Frame:
        if not held:
            held.append(get_points(frame) + random.uniform(-60.0, 60.0, 2))
        return replace(frame, points=held[0] + NOISE_PX * random.standard_normal((2, 2)))

    return act
