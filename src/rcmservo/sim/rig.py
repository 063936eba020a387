"""A whole simulated laboratory: arm, tool, camera and markers, drawn from a seed. Its truth stays in here."""

from dataclasses import dataclass, field

import numpy as np

from rcmservo.errors import require
from rcmservo.mechanism import Kinematics, SphericalRcm
from rcmservo.plant import Camera, Floats
from rcmservo.sim.arm import Arm, Drive
from rcmservo.sim.cameras import Body, PictureCamera, PointCamera, Timing
from rcmservo.sim.renderer import Look, Renderer
from rcmservo.sim.scene import SceneSettings, draw, relocated
from rcmservo.sim.truth import Truth
from rcmservo.sim.world import World
from rcmservo.tool import RigidTool, Tool

SETTLE = 100_000_000
"""ns that pass after the tool was placed by hand, so that every frame in flight shows it there."""


@dataclass(frozen=True)
class RigSettings:
    """A simulated laboratory. ``width``, ``height`` px; ``point_noise`` px of the camera without pictures."""

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
    """A simulated laboratory at the start of a run: `mechanism`, `camera`, `clock`, and the judge's `truth`.

    ``pictures=False`` gives the camera that delivers points instead of frames. Everything follows from the seed.
    """

    def __init__(self, seed: int = 0, settings: RigSettings | None = None, pictures: bool = True) -> None:
        require(seed >= 0, "seed", seed, "a whole number that is not negative")
        self.seed, self.settings = seed, settings or RigSettings()
        s = self.settings
        drawing, noise, elsewhere = np.random.SeedSequence(seed).spawn(3)
        self.body = Body(s.mechanism, s.tool)
        radius = max(s.look.marker_radii)
        self.scene = draw(s.scene, self.body, (s.width, s.height), radius, np.random.default_rng(drawing))
        self._elsewhere = np.random.default_rng(elsewhere)
        self.mechanism = Arm(s.mechanism, s.drive)
        self.clock = World(self.mechanism)
        self.camera: Camera = self._camera(pictures, np.random.default_rng(noise))
        self.truth = Truth(self.clock, self.body, self.scene.optics)
        self.go_home()

    def _camera(self, pictures: bool, random: np.random.Generator) -> Camera:
        s = self.settings
        if pictures:
            renderer = Renderer(self.scene.optics, s.look, self.scene.tissue, self.seed)
            return PictureCamera(self.clock, self.body, renderer, s.timing)
        return PointCamera(self.clock, self.body, self.scene.optics, s.timing, s.point_noise, random)

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
        """Somebody moves and rolls the camera; from the next frame on it sees the tool from another side."""
        s = self.settings
        self.scene = relocated(self.scene, self.body, s.scene, max(s.look.marker_radii), self._elsewhere)
        self.truth.optics = self.scene.optics
        if isinstance(self.camera, PictureCamera):
            self.camera.renderer = Renderer(self.scene.optics, s.look, self.scene.tissue, self.seed)
        elif isinstance(self.camera, PointCamera):
            self.camera.optics = self.scene.optics
