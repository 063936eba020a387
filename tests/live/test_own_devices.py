"""Live runs without the simulator: user-defined arm, camera and operator."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import rcmservo as rs
from conftest import ROOT, make_environment
from rcmservo.recording.reader import read_record
from rcmservo.recording.replay import replay_record

TEST_TIMEOUT_S = 300.0
"""Time-out of a test in s."""

SCRIPT = """
import own_devices  # hides the simulator, in this process and in those that it starts
from multiprocessing import get_context
from pathlib import Path

if __name__ == "__main__":
    from rcmservo.live.supervisor import run_live

    done = get_context("spawn").RawValue("b", 0)

    def stop_when_done(report):
        if done.value:
            raise KeyboardInterrupt

    try:
        run_live(own_devices.session(Path({path!r}), 120.0, done), progress=stop_when_done)
    except KeyboardInterrupt:
        print("stopped by the test")
"""


def run_script(script: Path, text: str, enter: str = "") -> str:
    """Return the output of a script in a separate process."""
    script.write_text(text)
    done = subprocess.run(
        [sys.executable, script],
        env=make_environment(),
        input=enter,
        capture_output=True,
        text=True,
        check=False,
        timeout=TEST_TIMEOUT_S,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_a_live_run_uses_user_devices_without_the_simulator(
    tmp_path: Path,
) -> None:
    path = tmp_path / "run.mcap"
    assert (
        run_script(tmp_path / "script.py", SCRIPT.format(path=str(path))) == "stopped by the test\n"
    )
    record = read_record(path)
    assert record.complete
    assert "SERVO" in record.phase
    assert all(stage.target.taught_at > 0 for stage in record.stages)
    assert record.words["request"].count("RESUME") >= 2
    assert [stage.mid_run for stage in record.stages] == [False, True, True]
    assert [stage.servo["controller"]["gain"] for stage in record.stages] == [2.0, 1.0, 1.0]
    assert record.stages[2].target.points.tobytes() != record.stages[1].target.points.tobytes()
    assert replay_record(record).same


STOPPED = """
import own_devices
from multiprocessing import Pipe, Value
from pathlib import Path
from rcmservo.live.servo_process import run_session

enabled = []
own_devices.OwnArm.enable = lambda arm: enabled.append(arm)
supervisor, servo = Pipe()
supervisor.send("end")
run_session(own_devices.session(Path({path!r}), 8.0, Value("b", 0)), Value("q", 0), servo)
print(len(enabled), supervisor.recv())
"""


def test_a_stop_during_preparation_never_enables_the_drive(tmp_path: Path) -> None:
    text = STOPPED.format(path=str(tmp_path / "run.mcap"))
    assert run_script(tmp_path / "script.py", text) == "0 stopped before the drive was on\n"


MY_LAB = """
import numpy as np
from own_devices import OwnArm, OwnCamera

SEEN = bytearray(32)


def MyArm():
    return OwnArm(SEEN)


def MyCamera():
    return OwnCamera(SEEN)
"""


@pytest.mark.slow
def test_the_example_of_the_page_on_own_devices_runs(tmp_path: Path) -> None:
    """A busy computer may stop the run, which then names the cause.

    The run lasts 1.5 s at most, and teaching 1 s.
    """
    page = (ROOT / "docs/own_devices.md").read_text().partition("## A run in wall time")[2]
    block = re.search(r"```python\n(.*?)```", page, re.S)
    assert block is not None
    (tmp_path / "my_lab.py").write_text(MY_LAB)
    record = f'record="{tmp_path / "lab"}"'
    code = block[1].replace('record="runs/lab"', f"{record}, duration=1.5")
    code = code.replace("rig.teach()", "rig.teach(30)")
    assert record in code and "teach(30)" in code
    said = run_script(tmp_path / "script.py", code, enter="\nenable\n")
    assert "press Enter" in said and "Type enable to switch the drive on" in said
    assert re.search(r"(arrived, error 0\.\d+ mm by the joints|not arrived: )", said), said
    assert read_record(tmp_path / "lab").complete


def test_the_page_on_own_devices_names_every_method_of_the_protocols() -> None:
    page = (ROOT / "docs/own_devices.md").read_text()
    for device in (rs.Arm, rs.Camera, rs.Tracker):
        for method in (name for name in vars(device) if not name.startswith("_")):
            assert f"`{device.__name__}.{method}(" in page
            assert len(vars(device)[method].__doc__) > 40
