"""Simulated laboratory: arm, tool, camera, markers and disturbances, all from one seed."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Annotated, Any, NamedTuple, cast
from weakref import WeakKeyDictionary

import numpy as np

from rcmservo.constraints import Checked, between, not_negative
from rcmservo.errors import BadInput, require
from rcmservo.geometry.kinematics import Kinematics, SphericalRcm
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats, Image, Target, Tracker
from rcmservo.loop.target_frames import TEACHING_FRAMES
from rcmservo.loop.tick import Tick
from rcmservo.rig.rig import AnyRecorder, Rig
from rcmservo.safety.gate import Gate
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.servo import make_default_tool
from rcmservo.sim.arm import NO_GAP, Drive, SimulatedArm, SimulatedClock
from rcmservo.sim.cameras import (
    PictureCamera,
    PointCamera,
    Timing,
    make_drifting_noise,
    make_gaussian_noise,
    make_recorded_noise,
)
from rcmservo.sim.cramer_rao import bound
from rcmservo.sim.disturbances.disturbance import Disturbance
from rcmservo.sim.disturbances.disturbance_kinds import DISTURBANCE_KINDS
from rcmservo.sim.disturbances.effects.arm_faults import DisturbedArm
from rcmservo.sim.disturbances.effects.camera_moves import CameraMotion
from rcmservo.sim.disturbances.effects.camera_view import DisturbedView
from rcmservo.sim.disturbances.effects.computer_faults import ProcessDelays
from rcmservo.sim.disturbances.effects.frame_delivery import FrameDelivery
from rcmservo.sim.disturbances.schedule import Event, Schedule
from rcmservo.sim.ground_truth import GroundTruth
from rcmservo.sim.imperfections import Imperfections
from rcmservo.sim.rendering import Appearance, Renderer
from rcmservo.sim.scene import Scene, SceneSettings
from rcmservo.sim.scenes.sampling import SceneSampler, sample_relocated_scene, sample_scene
from rcmservo.sim.tool_body import ToolBody
from rcmservo.tracking import ColourMarkers, PointMarkers

SETTLE_TIME_NS = 100_000_000
"""Time (ns) that passes after the tool is placed by hand, so that older frames have arrived."""


@dataclass(frozen=True, kw_only=True)
class ImageSettings(Checked):
    """Size of the images of a simulated camera, and noise of the markers in it.

    Parameters
    ----------
    width : int
        Width of the image, px; 64 to 4096.
    height : int
        Height of the image, px; 64 to 4096.
    point_noise : float
        Standard deviation (px) of the markers' noise of the camera without images, not negative.
    """

    width: Annotated[int, between(64, 4096, "a whole number of px")] = 640

    height: Annotated[int, between(64, 4096, "a whole number of px")] = 480

    point_noise: Annotated[float, not_negative("number of px")] = 0.3


@dataclass(frozen=True)
class RigSettings(ImageSettings, section="rig"):
    """Parts of a simulated laboratory.

    Parameters
    ----------
    mechanism : Kinematics
        Kinematics of the arm; default ``SphericalRcm()``.
    tool : Tool
        Positions of the markers on the tool; default ``RigidTool(spacing=30.0)``, in mm.
    drive : Drive
        Delay, lag, deadband and errors of the drives and encoders.
    timing : Timing
        Frame rate, exposure and delay of the camera.
    appearance : Appearance
        Geometry, colours, light and sensor noise of rendered images.
    scene : SceneSettings
        Distributions from which camera, start and target are sampled.
    imperfections : Imperfections
        Imperfections of arm, tool and camera; none by default.
    width : int
        Width of the image, px; 64 to 4096.
    height : int
        Height of the image, px; 64 to 4096.
    point_noise : float
        Standard deviation (px) of the markers' noise of the camera without images, not negative.

    Raises
    ------
    BadInput
        If a field is outside its range.
    """

    mechanism: Kinematics = field(default_factory=SphericalRcm)

    tool: Tool = field(default_factory=make_default_tool)

    drive: Drive = field(default_factory=Drive)

    timing: Timing = field(default_factory=Timing)

    appearance: Appearance = field(default_factory=Appearance)

    scene: SceneSettings = field(default_factory=SceneSettings)

    imperfections: Imperfections = field(default_factory=Imperfections)

    def make_body(self, seed: int) -> ToolBody:
        """Return the tool on the arm of a seed, with its imperfections."""
        return ToolBody(self.mechanism, self.tool, self.imperfections.draw(seed))


class TaughtPose(NamedTuple):
    """Truth of a taught pose.

    Parameters
    ----------
    p2 : Floats
        Position of marker 2 (3,), mm.
    frames : int
        Number of frames whose mean is the target.
    noise_px : float
        Standard deviation of a marker coordinate in a frame, px; NaN if unknown.
    """

    p2: Floats
    frames: int
    noise_px: float


def sample_scene_of_seed(seed: int, settings: RigSettings) -> tuple[Scene, np.random.Generator]:
    """Return the scene of the rig with this seed, and the generator of its camera's noise."""
    scene_seed, noise_seed, *_ = _spawn_seeds(seed)
    body = ToolBody(settings.mechanism, settings.tool)
    scene = sample_scene(_make_sampler(settings, body, scene_seed))
    return scene, np.random.default_rng(noise_seed)


def _spawn_seeds(seed: int) -> list[np.random.SeedSequence]:
    """Return the seeds of the scene, the camera's noise, its relocation and the disturbances."""
    not_negative("whole number").require("seed", seed)
    return np.random.SeedSequence(seed).spawn(4)


def _make_sampler(
    settings: RigSettings, body: ToolBody, seed: np.random.SeedSequence
) -> SceneSampler:
    """Return the sampler of scenes for a laboratory."""
    size, radius = (settings.width, settings.height), max(settings.appearance.marker_radii)
    return SceneSampler(settings.scene, body, size, radius, np.random.default_rng(seed))


def _check_argument_types(
    settings: object, pictures: object, disturbances: object, scene: object
) -> None:
    """Raise `BadInput` if an argument of `Rig` has another type than it should."""
    require(isinstance(settings, RigSettings | None), "settings", settings, "a RigSettings")
    require(isinstance(pictures, bool), "pictures", pictures, "true or false")
    items = cast(Sequence[object], disturbances)
    is_list = isinstance(cast(object, items), Sequence)
    is_list = is_list and all(isinstance(item, Disturbance) for item in items)
    require(is_list, "disturbances", disturbances, "a list of Disturbance")
    require(isinstance(scene, Scene | None), "scene", scene, "a Scene")


class SimulatedRig(Rig):
    """Simulated laboratory, with the tool at the start of a run.

    `run` moves it, and `teach` and `go_home` bring the tool to the target and to the start as a
    person would do by hand. `truth` has the true joints, camera and Jacobian, with which a run is
    evaluated; no servo reads them. The same seed and settings give the same laboratory, bit for
    bit.

    Parameters
    ----------
    seed : int
        Seed of the scene, the noise and the disturbances, at least 0.
    settings : RigSettings, optional
        Parts of the laboratory; default ``RigSettings()``.
    pictures : bool
        True for a camera that renders images; False for one whose frames hold the positions (px)
        of the markers instead.
    disturbances : sequence of Disturbance
        Disturbances of the run. Their times count from `begin`.
    scene : Scene, optional
        Scene to use instead of the one that follows from the seed.
    tracker : Tracker, optional
        Detector of the markers; by default `ColourMarkers` for images and `PointMarkers` without.
    gate : Gate, optional
        Bounds on every command; by default those of the servo.
    thresholds : Thresholds, optional
        Thresholds of the checks; by default those of the servo.

    Raises
    ------
    BadInput
        If an argument has another type, or a disturbance is impossible with this camera.
    NoScene
        If no scene within the settings is found.
    """

    is_simulated = True

    def __init__(
        self,
        seed: int = 0,
        settings: RigSettings | None = None,
        pictures: bool = True,
        disturbances: Sequence[Disturbance] = (),
        scene: Scene | None = None,
        tracker: Tracker | None = None,
        gate: Gate | None = None,
        thresholds: Thresholds | None = None,
    ) -> None:
        _check_argument_types(settings, pictures, disturbances, scene)
        self.seed, self.settings = seed, settings or RigSettings()
        parts = self.settings
        scene_seed, noise_seed, relocation_seed, disturbance_seed = _spawn_seeds(seed)
        self.body = parts.make_body(seed)
        ideal_body = ToolBody(parts.mechanism, parts.tool)
        self.scene = scene or sample_scene(_make_sampler(parts, ideal_body, scene_seed))
        self._relocation_sampler = _make_sampler(parts, ideal_body, relocation_seed)
        self._arm = SimulatedArm(parts.mechanism, parts.drive, self.body.imperfections)
        self._camera = self._make_camera(pictures, np.random.default_rng(noise_seed))
        self._clock = SimulatedClock(self._arm)
        if tracker is None:
            tracker = ColourMarkers() if pictures else PointMarkers()
        super().__init__(
            self._arm,
            self._camera,
            tracker,
            parts.mechanism,
            parts.tool,
            self._clock,
            gate=gate,
            thresholds=thresholds,
        )
        self.truth = GroundTruth(self._arm, self.body, self.scene.optics)
        self.schedule = Schedule(disturbances, disturbance_seed)
        self._camera_motion = CameraMotion()
        self._video_renderer: Renderer | None = None
        self._taught = WeakKeyDictionary[Target, TaughtPose]()
        if disturbances:
            self._insert_disturbances()
        self.place(self.scene.start, self.body.imperfections.start_in_gap)

    def _make_camera(
        self, pictures: bool, random: np.random.Generator
    ) -> PictureCamera | PointCamera:
        """Return the camera with images if `pictures`, the one without them otherwise."""
        parts = self.settings
        if pictures:
            return PictureCamera(self._arm, self.body, parts.timing, self._make_renderer())
        noise = make_gaussian_noise(parts.point_noise, random)
        if parts.imperfections.air > 0.0:
            rate, air = parts.timing.frame_rate, parts.imperfections.air
            noise = make_drifting_noise(parts.point_noise, air, rate, random)
        return PointCamera(self._arm, self.body, parts.timing, self.scene.optics, noise)

    def _make_renderer(self) -> Renderer:
        """Return the renderer of the present scene."""
        return Renderer(self.scene.optics, self.settings.appearance, self.scene.tissue, self.seed)

    def _insert_disturbances(self) -> None:
        """Insert the disturbances between the software and the devices."""
        for disturbance in self.schedule.disturbances:
            kind = DISTURBANCE_KINDS[disturbance.kind]
            is_possible = isinstance(self._camera, PointCamera) or kind.works_with_images
            expected = "one that a camera with images can have"
            require(is_possible, "disturbance", disturbance.kind, expected)
        self.arm = DisturbedArm(self._arm, self.schedule)
        look = self.settings.appearance
        view = DisturbedView(self._camera, look, self.schedule, self._move_camera)
        self.camera = FrameDelivery(view, self.clock.now, self.schedule)
        self._clock.stalls = ProcessDelays(self.schedule)

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

    def teach(self, frames: int = TEACHING_FRAMES) -> Target:
        """Teach the target of the scene: the tool is moved there by hand and back to the start.

        Parameters
        ----------
        frames : int
            Number of frames whose mean becomes the target, 300 by default.

        Returns
        -------
        Target
            Markers in raw px and joints.

        Raises
        ------
        TeachingFailed
            If no frame shows both markers for 2 s, or if the frames do not agree.
        """
        self.move_to_target()
        target = super().teach(frames)
        taught_p2 = self.truth.markers(self.clock.now())[1]
        self._taught[target] = TaughtPose(taught_p2, frames, self._estimate_pixel_noise())
        self.go_home()
        return target

    def go_home(self) -> None:
        """Bring the tool back to the start of the scene by hand."""
        self.place(self.scene.start, self.body.imperfections.start_in_gap)
        self.plant.reset()

    def measure_true_error(self, target: Target) -> float:
        """Return the true distance (mm) of marker 2 from where `teach` taught the target.

        It is NaN for any other target.
        """
        pose = self._taught.get(target)
        if pose is None:
            return float("nan")
        error: Floats = self.truth.markers(self.clock.now())[1] - pose.p2
        return float(np.linalg.norm(error))

    def compute_bound(self, target: Target, frames: int) -> float:
        """Return the Cramér-Rao bound of the pose error (mm), for the noise that teaching showed.

        It is NaN for a target that `teach` has not taught here.
        """
        pose = self._taught.get(target)
        if pose is None or not np.isfinite(pose.noise_px) or frames < 1:
            return float("nan")
        return bound(self.scene, pose.noise_px, frames, pose.frames).rms

    def _estimate_pixel_noise(self) -> float:
        """Return the standard deviation (px) of a marker coordinate in the newest frame.

        It is that of the camera without images, or what the tracker reports; NaN if unknown.
        """
        if isinstance(self._camera, PointCamera):
            return self.settings.point_noise
        markers = self.plant.markers
        if markers is None:
            return float("nan")
        variances = markers.covariance[:, [0, 1], [0, 1]]
        return float(np.sqrt(np.mean(variances)))

    def record_tick(self, recorder: AnyRecorder, tick: Tick) -> None:
        """Write a tick and the true state into the record."""
        self.truth.record_tick(recorder, tick)

    def describe(self) -> dict[str, Any]:
        """Return what the record stores of the laboratory: seed, disturbances and settings."""
        return {
            **super().describe(),
            "seed": self.seed,
            "disturbances": [str(disturbance) for disturbance in self.schedule.disturbances],
            "rig": asdict(self.settings),
        }

    def begin(self) -> None:
        """Start the disturbances: their times count from now."""
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
        self.place(self.scene.target, self.body.imperfections.target_in_gap)

    @property
    def true_target(self) -> Floats:
        """True joints (3,) of the tool at the target, which differ from the motors' by backlash."""
        errors = self.body.imperfections
        return self.scene.target + errors.target_in_gap * errors.half_gap

    def place(self, q: Floats, in_gap: Floats = NO_GAP) -> None:
        """Bring the tool to joints by hand and wait until all frames show it there.

        Parameters
        ----------
        q : Floats, shape (3,)
            Joints (rad, rad, mm) at the motors.
        in_gap : Floats, shape (3,)
            Place of the tool in the gaps of the backlash, -1 to 1; their middle by default.
        """
        self._arm.place(q, in_gap)
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
        if self._video_renderer is None or self._video_renderer.optics is not self.scene.optics:
            self._video_renderer = self._make_renderer()
        poses = self.body.points(self._arm.joints_at(time))[None]
        return self._video_renderer.render(poses, number)

    def set_point_noise(self, noise: Floats) -> None:
        """Set the noise of the following frames of the camera without images.

        The simulated run then has the same noise as the compiled simulation of a study.

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
            expected = "the one without pictures: Rig(pictures=False)"
            raise BadInput("camera", type(camera).__name__, expected)
        camera.latest()  # makes the frame that has already arrived, with its own noise
        camera.noise = make_recorded_noise(noise, camera.timing.newest(self.clock.now())[0])

    def relocate_camera(self) -> None:
        """Move the camera to another side of the tool and roll it, from the next frame on.

        Raises
        ------
        NoScene
            If no other pose of the camera shows both markers.
        """
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
        """Replace the scene from the next frame on."""
        self.scene = scene
        self.truth.camera_model = self._camera.optics = scene.optics
        if isinstance(self._camera, PictureCamera):
            self._camera.renderer = self._make_renderer()
