"""A whole simulated laboratory: arm, tool, camera and markers, drawn from a seed. Its truth stays
in here."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, cast

import numpy as np

from rcmservo.constraints import Checked, between, not_negative
from rcmservo.errors import BadInput, require
from rcmservo.interfaces import Camera, Floats, Image
from rcmservo.method.kinematics import Kinematics, SphericalRcm
from rcmservo.method.tool import RigidTool, Tool
from rcmservo.sim.arm import Drive, SimulatedArm, SimulatedClock
from rcmservo.sim.cameras import PictureCamera, PointCamera, Timing, by_chance, in_order
from rcmservo.sim.disturbances.arm_faults import DisturbedArm
from rcmservo.sim.disturbances.camera_moves import Hands
from rcmservo.sim.disturbances.camera_view import View
from rcmservo.sim.disturbances.computer_faults import Stalls
from rcmservo.sim.disturbances.disturbance import Disturbance
from rcmservo.sim.disturbances.frame_delivery import Delivery
from rcmservo.sim.disturbances.kinds import KINDS
from rcmservo.sim.disturbances.schedule import Event, Schedule
from rcmservo.sim.ground_truth import Truth
from rcmservo.sim.rendering import Look, Renderer
from rcmservo.sim.scene import Scene, SceneSettings
from rcmservo.sim.scenes.sampling import Draws, draw, relocated
from rcmservo.sim.tool_body import Body

SETTLE = 100_000_000
"""ns that pass after the tool was placed by hand, so that every frame in flight shows it there."""

PIXELS = between(64, 4096, "a whole number of px")
NOISE = not_negative("number of px")


@dataclass(frozen=True, kw_only=True)
class Picture(Checked):
    """Picture of a simulated camera."""

    width: Annotated[int, PIXELS] = 640
    """Of the picture, px."""

    height: Annotated[int, PIXELS] = 480
    """Of the picture, px."""

    point_noise: Annotated[float, NOISE] = 0.3
    """px, root mean square, of a camera that delivers points."""


@dataclass(frozen=True)
class RigSettings(Picture, section="rig"):
    """What a simulated laboratory is made of."""

    mechanism: Kinematics = field(default_factory=SphericalRcm)
    """The arm's kinematics."""

    tool: Tool = field(default_factory=lambda: RigidTool(spacing=30.0))
    """Where the markers are on the tool."""

    drive: Drive = field(default_factory=Drive)
    """What stands between a command and a motion."""

    timing: Timing = field(default_factory=Timing)
    """When the camera takes its frames, and when they arrive."""

    look: Look = field(default_factory=Look)
    """How the scene looks in pictures."""

    scene: SceneSettings = field(default_factory=SceneSettings)
    """What camera, start and target are drawn from."""


def drawn(seed: int, settings: RigSettings) -> tuple[Scene, np.random.Generator]:
    """The scene of the rig with this seed, and the chance that its camera's noise comes from."""
    drawing, noise, *_ = _seeds(seed)
    body = Body(settings.mechanism, settings.tool)
    return draw(_draws(settings, body, drawing)), np.random.default_rng(noise)


def _seeds(seed: int) -> list[np.random.SeedSequence]:
    """Of the scene, the camera's noise, another place of the camera, and the disturbances."""
    not_negative("whole number").require("seed", seed)
    return np.random.SeedSequence(seed).spawn(4)


def _draws(s: RigSettings, body: Body, seed: np.random.SeedSequence) -> Draws:
    size, radius = (s.width, s.height), max(s.look.marker_radii)
    return Draws(s.scene, body, size, radius, np.random.default_rng(seed))


def _check_kinds(settings: object, pictures: object, disturbances: object, scene: object) -> None:
    """Refuse arguments of a rig that are of another kind."""
    require(isinstance(settings, RigSettings | None), "settings", settings, "a RigSettings")
    require(isinstance(pictures, bool), "pictures", pictures, "true or false")
    several = cast(Sequence[object], disturbances)
    good = isinstance(cast(object, several), Sequence)
    good = good and all(isinstance(one, Disturbance) for one in several)
    require(good, "disturbances", disturbances, "a list of Disturbance")
    require(isinstance(scene, Scene | None), "scene", scene, "a Scene")


class Rig:
    """A simulated laboratory at the start of a run. Everything in it follows from the seed, but for
    a `scene` of one's own.

    A plant is made of its `arm`, `camera` and `clock`. `truth` is for the judge of the run.
    ``pictures=False`` gives the camera that tells points instead of frames. ``disturbances`` happen
    in the run that `begin` starts.
    """

    def __init__(
        self,
        seed: int = 0,
        settings: RigSettings | None = None,
        pictures: bool = True,
        disturbances: Sequence[Disturbance] = (),
        scene: Scene | None = None,
    ) -> None:
        _check_kinds(settings, pictures, disturbances, scene)
        self.seed, self.settings = seed, settings or RigSettings()
        s = self.settings
        drawing, noise, elsewhere, chance = _seeds(seed)
        self.body = Body(s.mechanism, s.tool)
        self.scene = scene or draw(_draws(s, self.body, drawing))
        self._elsewhere = _draws(s, self.body, elsewhere)
        self._arm = SimulatedArm(s.mechanism, s.drive)
        self._camera = self._new_camera(pictures, np.random.default_rng(noise))
        self.clock = SimulatedClock(self._arm)
        self.truth = Truth(self._arm, self.body, self.scene.optics)
        self.schedule, self._hands = Schedule(disturbances, chance), Hands()
        self._drawn: tuple[Scene, Renderer] | None = None
        self.arm: SimulatedArm | DisturbedArm = self._arm
        self.camera: Camera = self._camera
        if disturbances:
            self._disturb()
        self.go_home()

    def _new_camera(
        self, pictures: bool, random: np.random.Generator
    ) -> PictureCamera | PointCamera:
        s = self.settings
        if pictures:
            return PictureCamera(self._arm, self.body, s.timing, self._renderer())
        noise = by_chance(s.point_noise, random)
        return PointCamera(self._arm, self.body, s.timing, self.scene.optics, noise)

    def _renderer(self) -> Renderer:
        return Renderer(self.scene.optics, self.settings.look, self.scene.tissue, self.seed)

    def _disturb(self) -> None:
        """Put the disturbances between the software and the devices."""
        for disturbance in self.schedule.disturbances:
            kind = disturbance.kind
            suffers = isinstance(self._camera, PointCamera) or KINDS[kind].pictures
            require(suffers, "disturbance", kind, "one that a camera with pictures can suffer")
        self.arm = DisturbedArm(self._arm, self.schedule)
        view = View(self._camera, self.settings.look, self.schedule, self._touch_camera)
        self.camera = Delivery(view, self.clock.now, self.schedule)
        self.clock.stalls = Stalls(self.schedule)

    def open_to_trouble(self, arm: Any = None) -> None:
        """Let disturbances come while it runs, by its schedule. The camera is before `arm`, which
        moves elsewhere, if one is given."""
        if arm is not None:
            self._camera.arm = self.truth.arm = arm
        self._disturb()

    def begin(self) -> None:
        """The run begins: the disturbances' times count from here."""
        self.schedule.begin(self.clock.now())

    def let_pass(self, until: int) -> None:
        """Let time pass until a moment (ns), even if the process that would wait was killed."""
        self._arm.advance_until(until)

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
        self._arm.place(q)
        self.clock.wait_until(self.clock.now() + SETTLE)

    def picture(self, time: int, number: int) -> Image:
        """What the camera without pictures would have seen at a moment (ns) of the last second, as
        a frame of this number: for a film."""
        scene, renderer = self._drawn or (None, None)
        if scene is not self.scene or renderer is None:
            renderer = self._renderer()
            self._drawn = self.scene, renderer
        return renderer.render(self.body.points(self._arm.joints_at(time))[None], number)

    def see_noise(self, noise: Floats) -> None:
        """From the next frame on the camera without pictures sees the markers with the noise
        (frames, 2, 2) px, a row for each frame that arrives: what the compiled twin is given."""
        camera = self._camera
        if not isinstance(camera, PointCamera):
            raise BadInput("camera", type(camera).__name__, "the one without pictures")
        camera.latest()  # the frame that is there already has the noise of before
        camera.noise = in_order(noise, camera.timing.newest(self.clock.now())[0])

    def relocate_camera(self) -> None:
        """Somebody moves and rolls the camera. It sees the tool from another side from the next
        frame on."""
        self._see(relocated(self._elsewhere, self.scene))

    def _touch_camera(self, event: Event, part: float) -> None:
        """Move the camera by a part, 0 to 1, of an event's motion."""
        if event.kind == "relocate":
            self.relocate_camera()
            return
        markers = self.truth.markers(self.truth.arm.time)
        moved = self._hands.moved(event, part, self.scene.optics, markers)
        self._see(replace(self.scene, optics=moved))

    def _see(self, scene: Scene) -> None:
        """From the next frame on the camera sees this scene."""
        self.scene, self.truth.optics = scene, scene.optics
        if isinstance(self._camera, PictureCamera):
            self._camera.renderer = self._renderer()
        else:
            self._camera.move(scene.optics)
