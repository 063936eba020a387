"""Bad input: one sentence that names the invalid value, exit code 2, and no files left behind."""

import pickle
import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from conftest import ROOT
from rcmservo.cli.cli import main
from rcmservo.errors import BadInput, NotInstalled, RcmServoError, Stopped, UnusableFile
from rcmservo.sim.scenes import sampling

INVALID_RIGS = {
    "negative spacing": ('[tool]\nkind = "rigid"\nspacing = -3.0', "spacing", "-3"),
    "no scale": ('[tool]\nkind = "scaled"', "tool.scale", "None"),
    "unknown tool": ('[tool]\nkind = "bent"', "tool.kind", "bent"),
    "scale below one": ('[tool]\nkind = "scaled"\nscale = 0.5', "scale", "0.5"),
    "zero focal length": ("[scene]\nfocal = [0.0, 900.0]", "focal", "0.0"),
    "limits upside down": (
        '[mechanism]\nkind = "spherical"\nlower = [1.0, 0.0, 50.0]\nupper = [0.5, 1.0, 90.0]',
        "upper",
        "0.5",
    ),
    "tool beyond the RCM": (
        '[mechanism]\nkind = "pitch-yaw"\ninsertion_zero = -100.0',
        "lower",
        "40",
    ),
    "unknown section": ("[tols]\nx = 1", "rig.toml: section tols", "1"),
    "unknown key of the robot": (
        '[tool]\nkind = "rigid"\nspacin = 3',
        "rig.toml: tool.spacin",
        "did you mean spacing",
    ),
    "unknown key of the simulation": (
        "[camera]\nwidht = 640",
        "rig.toml: camera.widht",
        "did you mean width",
    ),
    "NaN": ("[drive]\nlag = nan", "drive.lag", "nan"),
    "infinity": ("[camera]\ndelay = inf", "camera.delay", "inf"),
    "a word for a number": ('[camera]\nwidth = "wide"', "camera.width", "wide"),
    "true for a number": ("[camera]\ndelay = true", "camera.delay", "True"),
    "too few numbers": ("[gate]\nspeed = [1.0, 1.0]", "gate.speed", "1.0"),
    "zero speed": ("[gate]\nspeed = [1.0, 0.0, 1.0]", "gate.speed", "0.0"),
    "unknown colour": ('[markers]\ncolour_1 = "mauve"', "colour_1", "mauve"),
    "markers of equal appearance": (
        '[markers]\ncolour_1 = "red"\ncolour_2 = "red"\nradius_1 = 3.0\nradius_2 = 3.0',
        "radius_2",
        "3.0",
    ),
    "exposure longer than a frame": ("[camera]\nexposure = 0.1", "exposure", "0.1"),
    "repeated key": ("[camera]\nwidth = 640\nwidth = 641", "TOML", ""),
    "not TOML": ("\x00\x01 = [", "TOML", ""),
    "markers never in view": (
        "[scene]\nstart = [0.2, 0.0, 60.0]\ntarget = [1.4, 3.1, 219.0]\ndistance = [120.0, 121.0]",
        "scene",
        "",
    ),
}
INVALID_COMMAND_LINES = {
    "misspelt option": (["run", "--sede", "1"], "--seed"),
    "no number": (["run", "--seed", "abc"], "abc"),
    "negative seed": (["run", "--seed", "-1"], "-1"),
    "no duration": (["run", "--duration", "0"], "--duration"),
    "NaN duration": (["run", "--duration", "nan"], "nan"),
    "negative gain": (["run", "--controller.gain", "-1"], "controller.gain"),
    "NaN gain": (["run", "--controller.gain", "nan"], "controller.gain"),
    "infinite radius": (["run", "--exploration.radius", "inf"], "exploration.radius"),
    "unknown estimator": (["run", "--estimator", "magic"], "magic"),
    "unknown command": (["fly"], "fly"),
    "no command": ([], "run, live, serve, replay"),
    "no folder to replay": (["replay"], "Folder"),
    "a rig that is not there": (["run", "--rig", "nowhere.toml"], "nowhere.toml"),
}

ONE_METHOD = '[method.a]\nestimator = "dlt"\n'
GAIN_SEARCH = '[search]\n"controller.gain" = [2.0, 15.0]\n'
INVALID_STUDIES = {
    "unknown method": (["study", "--method", "magic"], "method must be one of projection", "magic"),
    "code that is not there": (["study", "--method", "nolab:RLS"], "--method", "nolab"),
    "two names for one option": (["study", "--method", "dlt", "flow"], "FILE", "several names"),
    "a method twice": (["study", "--method", "dlt", "--method", "dlt"], "given once"),
    "unknown scenes": (["study", "--scenes", "magic"], "scenes must be one of paper", "magic"),
    "no such scenes": (["study", "--scenes", "none.toml"], "none.toml: cannot be read"),
    "unknown engine": (["study", "--engine", "warp"], "engine must be one of auto", "warp"),
    "no compiled one": (["study", "--method", "flow", "--engine", "compiled"], "auto, mujoco or"),
    "no scenes at all": (["study", "--count", "0"], "count must be a whole number from 1"),
    "too many": (["study", "--count", "100000000", "--repetitions", "9"], "runs in all must be"),
    "no whole number": (["study", "--count", "many"], "--count must be a whole number", "many"),
    "negative first seed": (["study", "--seed", "-1"], "seed must be a whole number", "-1"),
    "no duration": (["study", "--duration", "nan"], "duration must be a time above 1", "nan"),
    "negative noise": (["study", "--noise", "-0.1"], "noise must be", "-0.1"),
    "noise of pictures": (["study", "--engine", "pictures", "--noise", "1"], "that of the tracker"),
    "latency within it": (["study", "--latency", "0.001"], "at least half of the exposure"),
    "unknown disturbance": (["study", "--disturb", "occlusio"], "did you mean occlusion"),
    "no workers": (["study", "--workers", "0"], "--workers must be a whole number from 1", "0"),
    "no scheduler": (
        ["study", "--cluster", "nowhere"],
        "--cluster must be the address of a dask",
        "8786",
    ),
    "open scheduler": (
        ["study", "--cluster", "tcp://192.0.2.7:8786"],
        "can run code on its workers",
    ),
    "no file": (["study", "none.toml"], "none.toml: cannot be read"),
    "a folder": (["study", "."], "is not a file"),
    "too large": (["study", "large.toml"], "larger than 1000000 bytes, too large for a study"),
    "no TOML": (["study", "noise.toml"], "noise.toml: is not valid TOML"),
    "unknown key": (["study", "unknown.toml"], "unknown.toml: study.cont", "did you mean count?"),
    "a row of nothing": (["study", "--replay", "1"], "--out must be the folder of the study"),
    "a row of no study": (["study", "--out", "mine", "--replay", "1"], "mine: holds no study"),
    "a film of nothing": (["study", "--video"], "--video must be given with --replay"),
    "in use": (["study", "--out", "mine"], "mine: is not empty, and holds no study"),
    "a file to write into": (["study", "--out", "one.toml"], "one.toml: cannot be written to"),
    "below a file": (["study", "--out", "one.toml/x"], "cannot be written to"),
    "nothing to search by": (["tune"], "FILE must be given"),
    "no file to search by": (["tune", "none.toml"], "none.toml: cannot be read"),
    "nothing to search": (["tune", "one.toml"], "one.toml: search must be at least one setting"),
    "two to search": (
        ["tune", "two.toml"],
        "two.toml: method must be exactly one",
        "2",
    ),
    "unknown setting": (["tune", "gian.toml"], "did you mean controller.gain?"),
    "unknown goal": (["tune", "goal.toml"], "tune.goal must be one of time, error", "speed"),
    "unknown key of a search": (["tune", "key.toml"], "tune.trails", "did you mean trials?"),
    "a search in use": (["tune", "good.toml", "--out", "mine"], "mine: is not empty"),
    "a search without workers": (["tune", "good.toml", "--workers", "0"], "--workers must be"),
    "a search in the open": (
        ["tune", "good.toml", "--cluster", "tcp://192.0.2.7:1"],
        "can run code",
    ),
}
FILES = {
    "large.toml": "#" * 1_000_001,
    "noise.toml": "\x00 = [",
    "unknown.toml": "cont = 3",
    "one.toml": ONE_METHOD,
    "two.toml": 'methods = ["a", "flow"]\n' + ONE_METHOD + GAIN_SEARCH,
    "gian.toml": ONE_METHOD + GAIN_SEARCH.replace("gain", "gian"),
    "goal.toml": ONE_METHOD + GAIN_SEARCH + '[tune]\ngoal = "speed"',
    "key.toml": ONE_METHOD + GAIN_SEARCH + "[tune]\ntrails = 3",
    "good.toml": ONE_METHOD + GAIN_SEARCH,
    "mine/mine.txt": "mine",
}


def assert_refused(arguments: list[str], capsys: pytest.CaptureFixture[str], *names: str) -> None:
    """Check that the command ends with 2 and one sentence on stderr that contains `names`."""
    assert main(arguments) == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert error[-1].startswith("rcmservo: ")
    assert "Traceback" not in "".join(error)
    for name in names:
        assert name in error[-1]


@pytest.mark.parametrize("case", INVALID_COMMAND_LINES)
def test_an_invalid_command_line_is_refused(case: str, capsys: pytest.CaptureFixture[str]) -> None:
    arguments, name = INVALID_COMMAND_LINES[case]
    assert_refused(arguments, capsys, name)


@pytest.mark.parametrize("case", INVALID_STUDIES)
def test_an_invalid_study_is_refused_and_leaves_no_files(
    case: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """There is no new folder under runs/ either."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / "mine").mkdir()
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    arguments, *names = INVALID_STUDIES[case]
    assert_refused(arguments, capsys, *names)
    remaining = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")}
    assert remaining == {*FILES, "mine"}


@pytest.mark.parametrize("case", INVALID_RIGS)
def test_an_invalid_rig_file_is_refused_and_nothing_is_written(
    case: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sampling, "MAX_DRAWS", 100)
    text, *names = INVALID_RIGS[case]
    rig, out = tmp_path / "rig.toml", tmp_path / "out"
    rig.write_text(text)
    assert_refused(["run", "--rig", str(rig), "--out", str(out)], capsys, *names)
    assert sorted(tmp_path.iterdir()) == [rig]


def test_output_that_cannot_be_written_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("mine")
    assert_refused(["run", "--out", str(tmp_path / "file")], capsys, "file")
    assert_refused(["run", "--out", str(tmp_path / "file" / "below")], capsys, "below")
    assert_refused(["run", "--out", str(tmp_path)], capsys, "not empty")
    assert (tmp_path / "file").read_text() == "mine"


def test_a_refused_run_leaves_no_folder_at_any_depth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--target", str(tmp_path / "none.json"), "--out", str(tmp_path / "x1" / "y" / "z")]
    assert_refused(["run", *words], capsys, "none.json")
    assert not list(tmp_path.iterdir())


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Recording of three frames without a marker, with valid poses."""
    folder = tmp_path / "recording"
    (folder / "frames").mkdir(parents=True)
    picture = np.full((120, 160, 3), 90, dtype=np.uint8)
    for i in range(3):
        cv2.imwrite(str(folder / "frames" / f"{i:02d}.jpg"), picture)
    rows = [f"{i:02d},0.5,0.{i},0.1" for i in range(3)]
    (folder / "poses.csv").write_text("\n".join(["frame,theta_rad,phi_rad,rho_m", *rows]) + "\n")
    return folder


def replace_in_poses(folder: Path, old: str, new: str) -> None:
    table = folder / "poses.csv"
    assert old in table.read_text()
    table.write_text(table.read_text().replace(old, new))


def test_frames_without_markers_are_refused(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = recording.parent / "out"
    assert_refused(
        ["replay", str(recording), "--out", str(out)], capsys, "no frame shows both markers"
    )
    assert not out.exists()


@pytest.mark.parametrize("text", ["nan", "inf", "", "north"])
def test_a_pose_that_is_not_a_number_is_refused(
    text: str, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    replace_in_poses(recording, "01,0.5,", f"01,{text},")
    assert_refused(["replay", str(recording)], capsys, "frame 01", "theta_rad", text)


def test_a_missing_row_is_refused(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    replace_in_poses(recording, "01,0.5,0.1,0.1\n", "")
    assert_refused(["replay", str(recording)], capsys, "no row for frame 01")


def test_a_row_without_its_frame_is_refused(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (recording / "frames" / "02.jpg").unlink()
    assert_refused(["replay", str(recording)], capsys, "02")


def test_a_short_row_is_refused(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    replace_in_poses(recording, "02,0.5,0.2,0.1", "02,0.5")
    assert_refused(["replay", str(recording)], capsys, "phi_rad")


def test_poses_of_another_mechanism_are_refused(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert_refused(
        ["replay", str(recording), "--rig", str(ROOT / "examples/davinci.toml")],
        capsys,
        "yaw_rad",
        "pitch-yaw",
    )


def test_two_rows_for_one_frame_are_refused(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    replace_in_poses(recording, "02,", "01,")
    assert_refused(["replay", str(recording)], capsys, "poses.csv")


def test_a_folder_without_frames_is_refused(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.rmtree(recording / "frames")
    assert_refused(["replay", str(recording)], capsys, "holds no images")
    for name in ("nowhere", "nofile.mcap"):
        assert_refused(["replay", str(recording / name)], capsys, f"{name}: does not exist")


def test_a_recording_without_poses_is_refused(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (recording / "poses.csv").unlink()
    assert_refused(["replay", str(recording)], capsys, "poses.csv")


@pytest.mark.parametrize("fraction", [0.0, 0.3, 0.9, 0.999])
def test_a_truncated_jpeg_is_refused(
    fraction: float, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frame = recording / "frames" / "01.jpg"
    data = frame.read_bytes()
    frame.write_bytes(data[: int(fraction * len(data))])
    assert_refused(["replay", str(recording)], capsys, "01.jpg")


@pytest.mark.parametrize(
    "error",
    [
        BadInput("seed", -1, "a whole number"),
        UnusableFile("rig.toml", "is empty"),
        NotInstalled("study", "dask", "study"),
        Stopped("by Ctrl-C"),
    ],
)
def test_an_error_reaches_another_process_as_it_is(error: RcmServoError) -> None:
    """A pool whose worker raises an error that cannot be read waits for ever."""
    received = pickle.loads(pickle.dumps(error))
    assert type(received) is type(error)
    assert (str(received), vars(received)) == (str(error), vars(error))
