"""The live wing knows no simulator: it runs whatever arm and camera it is handed, and a person
beside them.
"""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import rcmservo as rs
from conftest import ROOT, with_tests
from rcmservo.recording.reader import read_record
from rcmservo.recording.replay import replay_record

pytestmark = pytest.mark.alone

DEADLINE = 300.0
"""s after which a test gives up waiting."""

SCRIPT = """
import own_devices  # hides the simulator, in this process and in those that it starts
from multiprocessing import get_context
from pathlib import Path

if __name__ == "__main__":
    from rcmservo.live.supervisor import run_live

    done = get_context("spawn").RawValue("b", 0)

    def heard(report):
        if done.value:
            raise KeyboardInterrupt

    try:
        run_live(own_devices.session(Path({path!r}), 120.0, done), progress=heard)
    except KeyboardInterrupt:
        print("as somebody who has seen enough")
"""


def ran(script: Path, text: str, enter: str = "") -> str:
    """What a script says in a process of its own."""
    script.write_text(text)
    done = subprocess.run(
        [sys.executable, script],
        env=with_tests(),
        input=enter,
        capture_output=True,
        text=True,
        check=False,
        timeout=DEADLINE,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_the_live_wing_runs_an_arm_and_a_camera_of_ones_own_where_there_is_no_simulator(
    tmp_path: Path,
) -> None:
    path = tmp_path / "run.mcap"
    assert (
        ran(tmp_path / "script.py", SCRIPT.format(path=str(path)))
        == "as somebody who has seen enough\n"
    )
    record = read_record(path)
    assert record.complete
    assert "SERVO" in record.phase
    assert all(stage.target.shown > 0 for stage in record.stages)
    assert record.words["request"].count("RESUME") >= 2
    assert [stage.mid_run for stage in record.stages] == [False, True, True]
    assert [stage.servo["controller"]["gain"] for stage in record.stages] == [2.0, 1.0, 1.0]
    assert record.stages[2].target.points.tobytes() != record.stages[1].target.points.tobytes()
    assert replay_record(record).same


STOPPED = """
import own_devices
from multiprocessing import Pipe, Value
from pathlib import Path
from rcmservo.live.servo_process import serve

enabled = []
own_devices.OwnArm.enable = lambda arm: enabled.append(arm)
supervisor, servo = Pipe()
supervisor.send("end")
serve(own_devices.session(Path({path!r}), 8.0, Value("b", 0)), Value("q", 0), servo)
print(len(enabled), supervisor.recv())
"""


def test_who_stops_it_while_it_prepares_never_sees_the_drive_on(tmp_path: Path) -> None:
    text = STOPPED.format(path=str(tmp_path / "run.mcap"))
    assert ran(tmp_path / "script.py", text) == "0 stopped before the drive was on\n"


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
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/own_devices.md").read_text(), re.S)
    (tmp_path / "my_lab.py").write_text(MY_LAB)
    said = ran(tmp_path / "script.py", block, enter="\n")
    assert "press Enter" in said
    assert re.search(r"acquiring|servoing|holding|waiting|paused", said), said


def test_the_page_on_own_devices_names_every_method_of_the_protocols() -> None:
    page = (ROOT / "docs/own_devices.md").read_text()
    for device in (rs.Arm, rs.Camera, rs.Tracker):
        for method in (name for name in vars(device) if not name.startswith("_")):
            assert f"`{device.__name__}.{method}(" in page
            assert len(vars(device)[method].__doc__) > 40
