"""Control law on coordinates and apparent sizes, which the tracker and the target must contain."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcmservo as rs
from conftest import make_random
from rcmservo.cli.cli import main
from rcmservo.cli.simulated_run.target import describe_simulated_setup
from rcmservo.config import target_file
from rcmservo.config.rig_file import RigDescription
from rcmservo.estimation.affine import AffineEstimator
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats, Observation
from rcmservo.loop.plant import Plant
from rcmservo.recording import reader
from rcmservo.recording.replay import replay_record
from rcmservo.recording.writer import Recorder
from rcmservo.servo.user_estimator import EstimatorGuard
from rcmservo.sim import Disturbance, Rig, RigSettings
from rcmservo.tracking import PointMarkers

SIZE = rs.SaturatedController(features="size")
RADII = np.array([3.0, 4.0])
NOISE_PX = 0.1
"""Standard deviation in px of the noise of centres and sizes."""


class SizedPlant(Plant):
    """Plant whose camera also measures sizes, from focal length, radius and depth."""

    def __init__(self, rig: Rig) -> None:
        super().__init__(rig.arm, rig.camera, PointMarkers(), rig.clock)
        self.rig, self.random, self.last = rig, make_random(rig.seed), (-1, np.full(2, np.nan))

    def read(self) -> Observation:
        observation = super().read()
        if observation.frame != self.last[0]:
            depth = self.rig.scene.optics.depth(self.rig.body.points(observation.q_exposure)[:2])
            noise = NOISE_PX * self.random.normal(size=2)
            sizes = self.rig.scene.optics.focal * RADII / depth + noise
            detected = np.isfinite(observation.points[:, 0])
            self.last = observation.frame, np.where(detected, sizes, np.nan)
        return replace(observation, sizes=self.last[1])


@dataclass
class SizedLab:
    """Rig with a plant that measures sizes, and a taught target."""

    disturbances: tuple[str, ...] = ()
    ticks: list[rs.Tick] = field(default_factory=list[rs.Tick])

    def __post_init__(self) -> None:
        disturbances = [Disturbance.parse(disturbance) for disturbance in self.disturbances]
        settings = RigSettings(point_noise=NOISE_PX)
        self.rig = Rig(1, settings, pictures=False, disturbances=disturbances)
        self.plant = SizedPlant(self.rig)
        self.rig.move_to_target()
        self.target = rs.teach(self.plant, frames=30)
        self.rig.go_home()
        self.rig.begin()

    def servo(self, **choices: Any) -> rs.Servo:
        settings = {"estimator": AFFINE, "controller": SIZE} | choices
        return rs.Servo(self.rig.settings.mechanism, self.rig.settings.tool, **settings)

    def error(self) -> float:
        """Return the distance (mm) of marker 2 from its taught position."""
        q, q_d = self.rig.arm.q_true, self.rig.scene.target
        return float(np.linalg.norm(self.rig.body.points(q)[1] - self.rig.body.points(q_d)[1]))


def sizes_at(rig: Rig, q: Floats) -> Floats:
    return rig.scene.optics.focal * RADII / rig.scene.optics.depth(rig.body.points(q)[:2])


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_it_reaches_the_target_also_if_a_marker_is_lost_in_motion(lost: int) -> None:
    lab = SizedLab((f"occlusion:at=2,marker={lost}",) if lost else ())
    began = lab.error()
    ticks = list(rs.servo_ticks(lab.plant, lab.servo(), lab.target, 7.0))
    without = [lost and np.isnan(tick.observation.points[lost - 1]).all() for tick in ticks]
    assert began > 5.0 and lab.error() < 1.0
    assert bool(lost) == any(without) == all(without[300:])
    assert ticks[-1].state.phase is rs.Phase.SERVO
    rows = ticks[-1].state.estimation.estimate.controlled_jacobian[:6].any(axis=1)
    expected = np.tile(np.arange(1, 3) != lost, (3, 1)).T  # u, v and R of each marker
    np.testing.assert_array_equal(rows, [*expected[:, :2].ravel(), *expected[:, 2]])


@pytest.mark.parametrize("lost", [1, 2])
def test_it_reaches_the_target_on_srd_if_a_marker_is_lost(lost: int) -> None:
    lab = SizedLab((f"occlusion:at=1,marker={lost}",))
    law = rs.SaturatedController(features="srd")
    ticks = list(rs.servo_ticks(lab.plant, lab.servo(controller=law), lab.target, 5.0))
    assert ticks[-1].state.phase is rs.Phase.SERVO
    assert lab.error() < 1.0


AFFINE = AffineEstimator()


class UserEstimator(rs.Estimator):
    """User-defined estimator: called through a guard, with the imaged RCM of eq. (16)."""

    def init(self) -> Any:
        return AFFINE.init()

    def update(self, memory: Any, tool: Tool, sample: rs.Sample) -> Any:
        return AFFINE.update(memory, tool, sample)

    def jacobian(self, memory: Any, tool: Tool, sample: rs.Sample) -> Floats:
        return AFFINE.jacobian(memory, tool, sample)

    def markers_jacobian(self, memory: Any, tool: Tool, sample: rs.Sample) -> Floats:
        return AFFINE.markers_jacobian(memory, tool, sample)

    def sizes_jacobian(self, memory: Any, tool: Tool, sample: rs.Sample) -> Floats:
        return AFFINE.sizes_jacobian(memory, tool, sample)


def test_a_user_defined_estimator_of_the_motion_of_sizes_reaches_the_target() -> None:
    lab = SizedLab()
    servo = lab.servo(estimator=UserEstimator())
    ticks = list(rs.servo_ticks(lab.plant, servo, lab.target, 5.0))
    assert isinstance(servo.guarded_estimator, EstimatorGuard)
    assert lab.error() < 1.0 and ticks[-1].state.phase is rs.Phase.SERVO


def test_a_target_contains_the_mean_of_the_sizes_during_teaching() -> None:
    lab = SizedLab()
    expected = sizes_at(lab.rig, lab.rig.scene.target)
    np.testing.assert_allclose(lab.target.sizes, expected, atol=4.0 * NOISE_PX / np.sqrt(30))


def test_its_record_contains_the_target_and_replays_only_with_its_sizes(
    tmp_path: Path,
) -> None:
    lab = SizedLab(("occlusion:at=2.5,for=0.3,marker=1",))
    with Recorder(tmp_path / reader.RECORD, {}) as recorder:
        recorder.begin(lab.servo(), lab.target)
        for tick in rs.servo_ticks(lab.plant, lab.servo(), lab.target, 3.5):
            recorder.write(tick)
    record = reader.read_record(tmp_path)
    assert record.stages[0].target.sizes.tobytes() == lab.target.sizes.tobytes()
    assert replay_record(record).same
    points_servo = lab.servo(controller=rs.SaturatedController(features="points"))
    assert not replay_record(record, points_servo).same
    without_sizes = replace(record.stages[0], target=replace(lab.target, sizes=np.full(2, np.nan)))
    with pytest.raises(rs.BadInput, match=SENTENCE):
        replay_record(replace(record, stages=[without_sizes]))


SENTENCE = (
    "target must be taught with the markers' sizes, on which controller.features = 'size' acts"
)


def test_a_target_without_sizes_is_refused_before_the_drive_is_enabled() -> None:
    lab = SizedLab()
    without_sizes = replace(lab.target, sizes=np.array([9.0, np.nan]))
    with pytest.raises(rs.BadInput, match=SENTENCE):
        list(rs.servo_ticks(lab.plant, lab.servo(), without_sizes, 1.0))
    assert not lab.plant.read().enabled


@pytest.mark.parametrize("by_target", [True, False])
def test_a_target_without_sizes_is_refused_during_a_run_and_the_arm_rests(by_target: bool) -> None:
    lab = SizedLab()
    without_sizes = replace(lab.target, sizes=np.full(2, np.nan))
    points = lab.servo(controller=rs.SaturatedController(features="points"))
    request, first = (without_sizes, lab.servo()) if by_target else (lab.servo(), points)
    target = lab.target if by_target else without_sizes
    run = rs.servo_ticks(lab.plant, first, target, 1.0, operator=lambda tick: request)
    with pytest.raises(rs.BadInput, match=SENTENCE):
        list(run)
    assert not lab.plant.read().enabled


@pytest.mark.parametrize("name", ["DltEstimator", "ProjectionEstimator", "FlowEstimator"])
def test_an_estimator_without_the_motion_of_sizes_is_refused(name: str) -> None:
    with pytest.raises(rs.BadInput, match=r"controller\.features must be .*such as"):
        rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0), getattr(rs, name)(), SIZE)


@pytest.mark.parametrize(
    ("estimator", "sentence"),
    [("affine", "target must be taught with the markers' sizes"), ("dlt", "such as affine")],
)
def test_the_command_line_refuses_both_with_one_sentence(
    estimator: str, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, rig = tmp_path / "target.json", Rig(3, pictures=False)
    target = rs.Target(np.array([[300.0, 200.0], [320.0, 260.0]]), rig.scene.target)
    target_file.save_target(path, target, describe_simulated_setup(rig, RigDescription()))
    law = ["--estimator", estimator, "--controller.features", "size"]
    run = ["run", "--seed", "3", *law, "--target", str(path), "--out", str(tmp_path / "out")]
    assert main(run) == 2
    message = capsys.readouterr().err
    assert sentence in " ".join(message.split()) and "Traceback" not in message
    assert not (tmp_path / "out").exists()
