"""Simulated laboratory: arm, tool, camera, markers and disturbances, all from one seed."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, cast

import numpy as np

from rcmservo.constraints import Checked, between, not_negative
from rcmservo.errors import BadInput, require
from rcmservo.geometry.kinematics import Kinematics, SphericalRcm
from rcmservo.geometry.tool import RigidTool, Tool
from rcmservo.interfaces import Camera, Floats, Image
from rcmservo.sim.arm import Drive, SimulatedArm, SimulatedClock
from rcmservo.sim.cameras import (
    PictureCamera,
    PointCamera,
    Timing,
    make_gaussian_noise,
    make_recorded_noise,
)
from rcmservo.sim.disturbances.arm_faults import DisturbedArm
from rcmservo.sim.disturbances.camera_moves import CameraMotion
from rcmservo.sim.disturbances.camera_view import DisturbedView
from rcmservo.sim.disturbances.computer_faults import ProcessDelays
from rcmservo.sim.disturbances.disturbance import Disturbance
from rcmservo.sim.disturbances.frame_delivery import FrameDelivery
from rcmservo.sim.disturbances.kinds import DISTURBANCE_KINDS
from rcmservo.sim.disturbances.schedule import Event, Schedule
from rcmservo.sim.ground_truth import GroundTruth
from rcmservo.sim.rendering import Appearance, Renderer
from rcmservo.sim.scene import Scene, SceneSettings
from rcmservo.sim.scenes.sampling import SceneSampler, sample_relocated_scene, sample_scene
from rcmservo.sim.tool_body import ToolBody

SETTLE_TIME_NS = 100_000_000
"""Time (ns) that passes after the tool is placed by hand: no frame in flight is older than that."""

IMAGE_SIZE_LIMIT = between(64, 4096, "a whole number of px")
POINT_NOISE_LIMIT = not_negative("number of px")


@dataclass(frozen=True, kw_only=True)
class Picture(Checked):
    """Image of a simulated camera.

    Parameters
    ----------
    width : int
        Width of the image, px.
    height : int
        Height of the image, px.
    point_noise : float
        Root mean square noise (px) of the markers of the camera without images.
    """

    width: Annotated[int, IMAGE_SIZE_LIMIT] = 640

    height: Annotated[int, IMAGE_SIZE_LIMIT] = 480

    point_noise: Annotated[float, POINT_NOISE_LIMIT] = 0.3


@dataclass(frozen=True)
class RigSettings(Picture, section="rig"):
    """Parts of a simulated laboratory.

    Parameters
    ----------
    mechanism : Kinematics
        Kinematics of the arm.
    tool : Tool
        Positions of the markers on the tool.
    drive : Drive
        Delay, lag, deadband and errors of the drives and encoders.
    timing : Timing
        Frame rate, exposure and delay of the camera.
    appearance : Appearance
        Geometry, colours, light and sensor noise of rendered images.
    scene : SceneSettings
        Distributions from which camera, start and target are sampled.

    Raises
    ------
    BadInput
        If a field is outside its range.
    """

    mechanism: Kinematics = field(default_factory=SphericalRcm)

    tool: Tool = field(default_factory=lambda: RigidTool(spacing=30.0))

    drive: Drive = field(default_factory=Drive)

    timing: Timing = field(default_factory=Timing)

    appearance: Appearance = field(default_factory=Appearance)

    scene: SceneSettings = field(default_factory=SceneSettings)


def sample_scene_of_seed(seed: int, settings: RigSettings) -> tuple[Scene, np.random.Generator]:
    """Return the scene of the rig with this seed, and the generator of its camera's noise."""
    drawing, noise, *_ = _spawn_seeds(seed)
    body = ToolBody(settings.mechanism, settings.tool)
    return sample_scene(_sampler_of(settings, body, drawing)), np.random.default_rng(noise)


def _spawn_seeds(seed: int) -> list[np.random.SeedSequence]:
    """Return the seeds of the scene, the camera's noise, its relocation and the disturbances."""
    not_negative("whole number").require("seed", seed)
    return np.random.SeedSequence(seed).spawn(4)


def _sampler_of(
    settings: RigSettings, body: ToolBody, seed: np.random.SeedSequence
) -> SceneSampler:
    size, radius = (settings.width, settings.height), max(settings.appearance.marker_radii)
    return SceneSampler(settings.scene, body, size, radius, np.random.default_rng(seed))


def _check_argument_types(
    settings: object, pictures: object, disturbances: object, scene: object
) -> None:
    """Raise `BadInput` if an argument of `Rig` has another type than it should."""
    require(isinstance(settings, RigSettings | None), "settings", settings, "a RigSettings")
    require(isinstance(pictures, bool), "pictures", pictures, "true or false")
    items = cast(Sequence[object], disturbances)
    valid = isinstance(cast(object, items), Sequence)
    valid = valid and all(isinstance(item, Disturbance) for item in items)
    require(valid, "disturbances", disturbances, "a list of Disturbance")
    require(isinstance(scene, Scene | None), "scene", scene, "a Scene")


class Rig:
    """Simulated laboratory at the start of a run.

    A plant is made of its `arm`, `camera` and `clock`; `truth` is for the evaluation of the run.
    Everything follows from the seed, unless `scene` is given.

    Parameters
    ----------
    seed : int
        Seed of the scene, the noise and the disturbances, at least 0.
    settings : RigSettings, optional
        Parts of the laboratory.
    pictures : bool
        False for a camera whose frames hold the markers' centres instead of images.
    disturbances : sequence of Disturbance
        Disturbances of the run that `begin` starts.
    scene : Scene, optional
        Scene to use instead of the seed's.

    Raises
    ------
    BadInput
        If an argument has another type, or the camera cannot have a disturbance.
    NoScene
        If no scene within the settings is found.
    """

    def __init__(
        self,
        seed: int = 0,
        settings: RigSettings | None = None,
        pictures: bool = True,
        disturbances: Sequence[Disturbance] = (),
        scene: Scene | None = None,
    ) -> None:
        _check_argument_types(settings, pictures, disturbances, scene)
        self.seed, self.settings = seed, settings or RigSettings()
        parts = self.settings
        drawing, noise, elsewhere, chance = _spawn_seeds(seed)
        self.body = ToolBody(parts.mechanism, parts.tool)
        self.scene = scene or sample_scene(_sampler_of(parts, self.body, drawing))
        self._relocation_sampler = _sampler_of(parts, self.body, elsewhere)
        self._arm = SimulatedArm(parts.mechanism, parts.drive)
        self._camera = self._make_camera(pictures, np.random.default_rng(noise))
        self.clock = SimulatedClock(self._arm)
        self.truth = GroundTruth(self._arm, self.body, self.scene.optics)
        self.schedule, self._camera_motion = Schedule(disturbances, chance), CameraMotion()
        self._film_renderer: tuple[Scene, Renderer] | None = None
        self.arm: SimulatedArm | DisturbedArm = self._arm
        self.camera: Camera = self._camera
        if disturbances:
            self._insert_disturbances()
        self.move_to_start()

    def _make_camera(
        self, pictures: bool, random: np.random.Generator
    ) -> PictureCamera | PointCamera:
        parts = self.settings
        if pictures:
            return PictureCamera(self._arm, self.body, parts.timing, self._make_renderer())
        noise = make_gaussian_noise(parts.point_noise, random)
        return PointCamera(self._arm, self.body, parts.timing, self.scene.optics, noise)

    def _make_renderer(self) -> Renderer:
        return Renderer(self.scene.optics, self.settings.appearance, self.scene.tissue, self.seed)

    def _insert_disturbances(self) -> None:
        """Insert the disturbances between the software and the devices."""
        for disturbance in self.schedule.disturbances:
            kind = disturbance.kind
            possible = isinstance(self._camera, PointCamera) or DISTURBANCE_KINDS[kind].pictures
            require(possible, "disturbance", kind, "one that a camera with images can have")
        self.arm = DisturbedArm(self._arm, self.schedule)
        view = DisturbedView(
            self._camera, self.settings.appearance, self.schedule, self._move_camera
        )
        self.camera = FrameDelivery(view, self.clock.now, self.schedule)
        self.clock.stalls = ProcessDelays(self.schedule)

    def accept_live_disturbances(self, arm: Any = None) -> None:
        """Accept disturbances that are added to the schedule while the laboratory runs.

        Parameters
        ----------
        arm : object with joints_at, optional
            Arm in another process that the camera observes instead of the rig's own.
        """
        if arm is not None:
            self._camera.arm = self.truth.arm = arm
        self._insert_disturbances()

    def begin(self) -> None:
        """Start the run: the disturbances' times count from now."""
        self.schedule.begin(self.clock.now())

    def advance_until(self, until: int) -> None:
        """Let time pass, even if a disturbance killed the waiting process.

        Parameters
        ----------
        until : int
            End of the wait, ns.
        """
        self._arm.advance_until(until)

    def disk_full(self) -> bool:
        """Return True while the disk on which the run is recorded is full."""
        return any(self.schedule.active(self.clock.now(), "disk_full"))

    def move_to_target(self) -> None:
        """Bring the tool to the target by hand and hold it there."""
        self.place(self.scene.target)

    def move_to_start(self) -> None:
        """Bring the tool back to the start by hand."""
        self.place(self.scene.start)

    def place(self, q: Floats) -> None:
        """Bring the tool to joints by hand and wait until all frames show it there.

        Parameters
        ----------
        q : Floats, shape (3,)
            Joints (rad, rad, mm).
        """
        self._arm.place(q)
        self.clock.wait_until(self.clock.now() + SETTLE_TIME_NS)

    def picture(self, time: int, number: int) -> Image:
        """Return a rendered image of a rig whose camera has no images, for a video.

        Parameters
        ----------
        time : int
            Time (ns) within the last second.
        number : int
            Number of the frame.

        Returns
        -------
        Image, shape (height, width, 3)
            Image in blue, green, red.
        """
        scene, renderer = self._film_renderer or (None, None)
        if scene is not self.scene or renderer is None:
            renderer = self._make_renderer()
            self._film_renderer = self.scene, renderer
        return renderer.render(self.body.points(self._arm.joints_at(time))[None], number)

    def set_point_noise(self, noise: Floats) -> None:
        """Give the camera without images the noise of the following frames.

        A run then has the same noise as a run of the study's compiled kernel.

        Parameters
        ----------
        noise : Floats, shape (frames, 2, 2)
            Noise (px) of each frame that arrives from now on.

        Raises
        ------
        BadInput
            If the camera has images, or the shape differs.
        """
        camera = self._camera
        if not isinstance(camera, PointCamera):
            raise BadInput(
                "camera", type(camera).__name__, "the one without pictures: Rig(pictures=False)"
            )
        camera.latest()  # the frame that has already arrived keeps its own noise
        camera.noise = make_recorded_noise(noise, camera.timing.newest(self.clock.now())[0])

    def relocate_camera(self) -> None:
        """Move and roll the camera to another side of the tool, from the next frame on."""
        self._use_scene(sample_relocated_scene(self._relocation_sampler, self.scene))

    def _move_camera(self, event: Event, fraction: float) -> None:
        """Apply a `fraction` (0 to 1) of a disturbance's camera motion."""
        if event.kind == "relocate":
            self.relocate_camera()
            return
        markers = self.truth.markers(self.truth.arm.time)
        moved = self._camera_motion.apply(event, fraction, self.scene.optics, markers)
        self._use_scene(replace(self.scene, optics=moved))

    def _use_scene(self, scene: Scene) -> None:
        """Use another scene from the next frame on."""
        self.scene, self.truth.optics = scene, scene.optics
        if isinstance(self._camera, PictureCamera):
            self._camera.renderer = self._make_renderer()
        else:
            self._camera.move(scene.optics)
