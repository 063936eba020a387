"""The law on coordinates and apparent sizes: it comes to the target, with one marker lost too,
replays, and is refused where sizes are not told.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcmservo as rs
from conftest import random_from
from rcmservo.cli.cli import main
from rcmservo.cli.simulated_run.target import setup_of
from rcmservo.config import target_file
from rcmservo.config.rig_file import Lab
from rcmservo.estimation.affine import AffineEstimator
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats, Observation
from rcmservo.loop.plant import Plant
from rcmservo.recording import reader
from rcmservo.recording.replay import replay_record
from rcmservo.recording.writer import Recorder
from rcmservo.servo.user_estimator import Guard
from rcmservo.sim import Disturbance, Rig, RigSettings
from rcmservo.tracking import PointMarkers

SIZE = rs.SaturatedController(features="size")
RADII = np.array([3.0, 4.0])
NOISE = 0.1
"""px of centres and sizes."""


class SizedPlant(Plant):
    """A plant whose camera tells points, and sizes beside: focal length, radius, depth."""

    def __init__(self, rig: Rig) -> None:
        super().__init__(rig.arm, rig.camera, PointMarkers(), rig.clock)
        self.rig, self.random, self.told = rig, random_from(rig.seed), (-1, np.full(2, np.nan))

    def read(self) -> Observation:
        seen = super().read()
        if seen.frame != self.told[0]:
            depth = self.rig.scene.optics.depth(self.rig.body.points(seen.q_exposure)[:2])
            sizes = self.rig.scene.optics.focal * RADII / depth + NOISE * self.random.normal(size=2)
            self.told = seen.frame, np.where(np.isfinite(seen.points[:, 0]), sizes, np.nan)
        return replace(seen, sizes=self.told[1])


@dataclass
class SizedLab:
    """A rig that tells sizes, and the target that it was shown."""

    wrong: tuple[str, ...] = ()
    ticks: list[rs.Tick] = field(default_factory=list[rs.Tick])

    def __post_init__(self) -> None:
        disturbances = [Disturbance.parse(one) for one in self.wrong]
        settings = RigSettings(point_noise=NOISE)
        self.rig = Rig(1, settings, pictures=False, disturbances=disturbances)
        self.plant = SizedPlant(self.rig)
        self.rig.move_to_target()
        self.target = rs.teach(self.plant, frames=30)
        self.rig.move_to_start()
        self.rig.begin()

    def servo(self, **choices: Any) -> rs.Servo:
        settings = {"estimator": AFFINE, "controller": SIZE} | choices
        return rs.Servo(self.rig.settings.mechanism, self.rig.settings.tool, **settings)

    def error(self) -> float:
        """Mm that marker 2 is from where it was shown."""
        q, q_d = self.rig.arm.q_true, self.rig.scene.target
        return float(np.linalg.norm(self.rig.body.points(q)[1] - self.rig.body.points(q_d)[1]))


def sizes_at(rig: Rig, q: Floats) -> Floats:
    return rig.scene.optics.focal * RADII / rig.scene.optics.depth(rig.body.points(q)[:2])


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_it_comes_to_the_target_with_one_marker_lost_on_the_way_too(lost: int) -> None:
    lab = SizedLab((f"occlusion:at=2,marker={lost}",) if lost else ())
    began = lab.error()
    ticks = list(rs.run(lab.plant, lab.servo(), lab.target, 7.0))
    without = [lost and np.isnan(tick.seen.points[lost - 1]).all() for tick in ticks]
    assert began > 5.0 and lab.error() < 1.0
    assert bool(lost) == any(without) == all(without[300:])
    assert ticks[-1].state.phase is rs.Phase.SERVO
    rows = ticks[-1].state.learnt.estimate.law_jacobian[:6].any(axis=1)
    asked = np.tile(np.arange(1, 3) != lost, (3, 1)).T  # u, v and R of each marker
    np.testing.assert_array_equal(rows, [*asked[:, :2].ravel(), *asked[:, 2]])


@pytest.mark.parametrize("lost", [1, 2])
def test_on_the_papers_features_too_it_comes_there_with_one_marker_lost(lost: int) -> None:
    lab = SizedLab((f"occlusion:at=1,marker={lost}",))
    law = rs.SaturatedController(features="srd")
    ticks = list(rs.run(lab.plant, lab.servo(controller=law), lab.target, 7.0))
    assert ticks[-1].state.phase is rs.Phase.SERVO
    assert lab.error() < 1.0


AFFINE = AffineEstimator()


class Own(rs.Estimator):
    """A user's, which is called through a guard and leaves the imaged RCM to eq. (16)."""

    def init(self) -> Any:
        return AFFINE.init()

    def update(self, memory: Any, tool: Tool, sample: rs.Sample) -> Any:
        return AFFINE.update(memory, tool, sample)

    def jacobian(self, memory: Any, tool: Tool, sample: rs.Sample) -> Floats:
        return AFFINE.jacobian(memory, tool, sample)

    def motion(self, memory: Any, tool: Tool, sample: rs.Sample) -> Floats:
        return AFFINE.motion(memory, tool, sample)

    def size_motion(self, memory: Any, tool: Tool, sample: rs.Sample) -> Floats:
        return AFFINE.size_motion(memory, tool, sample)


def test_a_users_own_estimator_that_tells_how_sizes_change_comes_there_too() -> None:
    lab = SizedLab()
    servo = lab.servo(estimator=Own())
    ticks = list(rs.run(lab.plant, servo, lab.target, 5.0))
    assert isinstance(servo.learner, Guard)
    assert lab.error() < 1.0 and ticks[-1].state.phase is rs.Phase.SERVO


def test_a_target_keeps_the_mean_of_the_sizes_that_were_shown() -> None:
    lab = SizedLab()
    wanted = sizes_at(lab.rig, lab.rig.scene.target)
    np.testing.assert_allclose(lab.target.sizes, wanted, atol=4.0 * NOISE / np.sqrt(30))


def test_its_record_tells_the_target_and_replays_but_not_to_a_target_without_sizes(
    tmp_path: Path,
) -> None:
    lab = SizedLab(("occlusion:at=2.5,for=0.3,marker=1",))
    with Recorder(tmp_path / reader.RECORD, {}) as recorder:
        recorder.begin(lab.servo(), lab.target)
        for tick in rs.run(lab.plant, lab.servo(), lab.target, 3.5):
            recorder.write(tick)
    then = reader.read_record(tmp_path)
    assert then.stages[0].target.sizes.tobytes() == lab.target.sizes.tobytes()
    assert replay_record(then).same
    less = lab.servo(controller=rs.SaturatedController(features="points"))
    assert not replay_record(then, less).same
    blind = replace(then.stages[0], target=replace(lab.target, sizes=np.full(2, np.nan)))
    with pytest.raises(rs.BadInput, match=SENTENCE):
        replay_record(replace(then, stages=[blind]))


SENTENCE = (
    "target must be taught with the markers' sizes, on which controller.features = 'size' acts"
)


def test_a_target_without_sizes_is_refused_before_the_drive_is_on() -> None:
    lab = SizedLab()
    blind = replace(lab.target, sizes=np.array([9.0, np.nan]))
    with pytest.raises(rs.BadInput, match=SENTENCE):
        list(rs.run(lab.plant, lab.servo(), blind, 1.0))
    assert not lab.plant.read().enabled


@pytest.mark.parametrize("by_target", [True, False])
def test_in_mid_run_it_is_refused_too_and_the_arm_is_brought_to_rest(by_target: bool) -> None:
    lab = SizedLab()
    blind = replace(lab.target, sizes=np.full(2, np.nan))
    points = lab.servo(controller=rs.SaturatedController(features="points"))
    want, first = (blind, lab.servo()) if by_target else (lab.servo(), points)
    aim = lab.target if by_target else blind
    run = rs.run(lab.plant, first, aim, 1.0, operator=lambda tick: want)
    with pytest.raises(rs.BadInput, match=SENTENCE):
        list(run)
    assert not lab.plant.read().enabled


@pytest.mark.parametrize("name", ["DltEstimator", "ProjectionEstimator", "FlowEstimator"])
def test_an_estimator_that_cannot_tell_how_sizes_change_is_refused_at_once(name: str) -> None:
    with pytest.raises(rs.BadInput, match=r"controller\.features must be .*such as"):
        rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0), getattr(rs, name)(), SIZE)


@pytest.mark.parametrize(
    ("estimator", "sentence"),
    [("affine", "target must be taught with the markers' sizes"), ("dlt", "such as affine")],
)
def test_the_command_line_refuses_both_in_one_sentence(
    estimator: str, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, rig = tmp_path / "target.json", Rig(3, pictures=False)
    shown = rs.Target(np.array([[300.0, 200.0], [320.0, 260.0]]), rig.scene.target)
    target_file.save(path, shown, setup_of(rig, Lab()))
    law = ["--estimator", estimator, "--controller.features", "size"]
    run = ["run", "--seed", "3", *law, "--target", str(path), "--out", str(tmp_path / "out")]
    assert main(run) == 2
    said = capsys.readouterr().err
    assert sentence in " ".join(said.split()) and "Traceback" not in said
    assert not (tmp_path / "out").exists()
