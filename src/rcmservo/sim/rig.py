"""A whole simulated laboratory: arm, tool, camera and markers, drawn from a seed. Its truth stays
in here."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from rcmservo.errors import require
from rcmservo.interfaces import Camera, Floats
from rcmservo.method.kinematics import Kinematics, SphericalRcm
from rcmservo.method.tool import RigidTool, Tool
from rcmservo.sim.arm import Drive, SimulatedArm
from rcmservo.sim.cameras import Body, PictureCamera, PointCamera, Timing
from rcmservo.sim.disturb.arm import DisturbedArm
from rcmservo.sim.disturb.delivery import Delivery
from rcmservo.sim.disturb.elsewhere import bumped, rolled
from rcmservo.sim.disturb.kinds import KINDS, Disturbance
from rcmservo.sim.disturb.process import Stalls
from rcmservo.sim.disturb.schedule import Event, Schedule
from rcmservo.sim.disturb.view import View
from rcmservo.sim.renderer import Look, Renderer
from rcmservo.sim.scene import Scene, SceneSettings, draw, relocated
from rcmservo.sim.truth import Truth
from rcmservo.sim.world import World

SETTLE = 100_000_000
"""ns that pass after the tool was placed by hand, so that every frame in flight shows it there."""


@dataclass(frozen=True)
class RigSettings:
    """A simulated laboratory. ``width``, ``height`` px; ``point_noise`` px of the camera without
    pictures."""

    mechanism: Kinematics = field(default_factory=SphericalRcm)
    tool: Tool = field(default_factory=lambda: RigidTool(spacing=30.0))
    drive: Drive = field(default_factory=Drive)
    timing: Timing = field(default_factory=Timing)
    look: Look = field(default_factory=Look)
    scene: SceneSettings = field(default_factory=SceneSettings)
    width: int = 640
    height: int = 480
    point_noise: float = 0.3

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            value = getattr(self, name)
            require(64 <= value <= 4096, f"camera.{name}", value, "from 64 to 4096 px")
        good = 0.0 <= self.point_noise < np.inf
        require(good, "camera.point_noise", self.point_noise, "a number of px that is not negative")


class Rig:
    """A simulated laboratory at the start of a run: `mechanism`, `camera`, `clock`, and the judge's
    `truth`.

    ``pictures=False`` gives the camera that delivers points instead of frames. Everything follows
    from the seed. ``disturbances`` go wrong in the run that `begin` starts.
    """

    def __init__(
        self,
        seed: int = 0,
        settings: RigSettings | None = None,
        pictures: bool = True,
        disturbances: Sequence[Disturbance] = (),
    ) -> None:
        require(seed >= 0, "seed", seed, "a whole number that is not negative")
        self.seed, self.settings = seed, settings or RigSettings()
        s = self.settings
        drawing, noise, elsewhere, chance = np.random.SeedSequence(seed).spawn(4)
        self.body = Body(s.mechanism, s.tool)
        radius = max(s.look.marker_radii)
        self.scene = draw(
            s.scene, self.body, (s.width, s.height), radius, np.random.default_rng(drawing)
        )
        self._elsewhere = np.random.default_rng(elsewhere)
        arm = SimulatedArm(s.mechanism, s.drive)
        self.clock = World(arm)
        self._camera = self._new_camera(pictures, np.random.default_rng(noise))
        self.truth = Truth(self.clock, self.body, self.scene.optics)
        self.schedule = Schedule(disturbances, chance)
        self.arm: SimulatedArm | DisturbedArm = arm
        self.camera: Camera = self._camera
        if disturbances:
            self._disturb(arm)
        self.go_home()

    def _new_camera(
        self, pictures: bool, random: np.random.Generator
    ) -> PictureCamera | PointCamera:
        s = self.settings
        if pictures:
            renderer = Renderer(self.scene.optics, s.look, self.scene.tissue, self.seed)
            return PictureCamera(self.clock, self.body, renderer, s.timing)
        return PointCamera(
            self.clock, self.body, self.scene.optics, s.timing, s.point_noise, random
        )

    def _disturb(self, arm: SimulatedArm) -> None:
        """Put the disturbances between the software and the devices."""
        for disturbance in self.schedule.disturbances:
            suffers = isinstance(self._camera, PointCamera) or KINDS[disturbance.kind].pictures
            require(
                suffers,
                "disturbance",
                disturbance.kind,
                "one that a camera with pictures can suffer",
            )
        self.arm = DisturbedArm(arm, self.clock, self.schedule)
        view = View(self._camera, self.settings.look, self.schedule, self._touch_camera)
        self.camera = Delivery(view, self.clock.now, self.schedule)
        self.clock.stalls = Stalls(self.schedule)

    def begin(self) -> None:
        """The run begins: the disturbances' times count from here."""
        self.schedule.begin(self.clock.now())

    def disk_full(self) -> bool:
        """Whether the disk on which the run would be recorded is full now."""
        return any(self.schedule.acting(self.clock.now(), "disk_full"))

    def show_target(self) -> None:
        """A person brings the tool to the target and holds it there."""
        self.place(self.scene.target)

    def go_home(self) -> None:
        """A person brings the tool back to the start."""
        self.place(self.scene.start)

    def place(self, q: Floats) -> None:
        """A person brings the tool to the joints q (3,) and holds it there."""
        self.clock.place(q)
        self.clock.wait_until(self.clock.now() + SETTLE)

    def relocate_camera(self) -> None:
        """Somebody moves and rolls the camera; from the next frame on it sees the tool from another
        side."""
        s = self.settings
        self._see(
            relocated(self.scene, self.body, s.scene, max(s.look.marker_radii), self._elsewhere)
        )

    def _touch_camera(self, event: Event) -> None:
        """What an event does to where the camera stands."""
        if event.kind == "relocate":
            self.relocate_camera()
            return
        optics, markers = self.scene.optics, self.truth.markers(self.clock.now())
        if event.kind == "bump":
            moved = bumped(optics, markers, event.number("px"), event.random)
        else:
            moved = rolled(optics, markers, np.radians(event.number("deg")))
        self._see(replace(self.scene, optics=moved))

    def _see(self, scene: Scene) -> None:
        """From the next frame on the camera sees this scene."""
        self.scene, self.truth.optics = scene, scene.optics
        if isinstance(self._camera, PictureCamera):
            self._camera.renderer = Renderer(
                scene.optics, self.settings.look, scene.tissue, self.seed
            )
        else:
            self._camera.optics = scene.optics
