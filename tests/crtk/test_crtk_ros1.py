"""ROS 1 from Debian's packages, with a real master: our client and device, and ROS's own tools.

A process is one node for as long as it lives, so that all that speaks ROS 1 runs in processes of
its own.
"""

import json
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from conftest import ROOT
from peers import peer

PACKAGES = (
    "ros-core python3-rospy python3-std-msgs python3-sensor-msgs python3-geometry-msgs "
    "python3-rostopic"
)
AT_ONCE, STILL_AFTER = -20.0, 100.0
"""ms after its client was killed."""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.alone,
    peer(
        "ROS 1",
        all(map(shutil.which, ("roscore", "rostopic"))),
        f"apt-get install {PACKAGES}",
    ),
]

STORY = """
import json
from crtk_measures import RunningDevice, killed, streamed
device = RunningDevice(1, 0)
told = streamed(1, 0, device, 3.0)
print(json.dumps([told, killed(1, 0, device, 0.13)]))
device.close()
"""

LATCHED = """
import time
from rcmservo.hardware.crtk.messages import OPERATING_STATE, STATE_COMMAND, StringStamped
from rcmservo.hardware.crtk.ros1 import Ros1
from dataclasses import replace
ros = Ros1()
command = replace(STATE_COMMAND.under("PSM1"), latched=True)
ros.publish(command, StringStamped(AGE and time.time_ns() - AGE, "enable"))
print("latched", flush=True)
time.sleep(60.0)
"""

DEVICE = """
import json, sys
from crtk_measures import RunningDevice
device = RunningDevice(1, 0)
print("there", flush=True)
sys.stdin.readline()
print(json.dumps([device.transport.heard, device.device.state]), flush=True)
device.close()
"""

CLIENT = """
import json, sys, time
from crtk_measures import client_arm
from rcmservo.interfaces import Command
import numpy as np
arm = client_arm(1, 0)
arm.enable()
arm.apply(Command(0, time.monotonic_ns(), time.monotonic_ns() + 60 * 10**9, np.zeros(3), True))
print("there", flush=True)
sys.stdin.readline()
print(json.dumps(arm.why_off), flush=True)
arm.close()
"""

POSE = "geometry_msgs/PoseStamped"


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """The environment in which a master is found."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    folder = tmp_path_factory.mktemp("ros")
    environment = os.environ | {
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}",
        "ROS_HOSTNAME": "127.0.0.1",
        "ROS_LOG_DIR": str(folder),
        "ROS_HOME": str(folder),
        "PYTHONPATH": os.pathsep.join([str(ROOT / "benchmarks"), str(ROOT / "src")]),
    }
    log = (folder / "roscore.txt").open("w")
    master = subprocess.Popen(
        ["roscore", "-p", str(port)], env=plain(environment), stdout=log, stderr=log
    )
    try:
        end = time.monotonic() + 60.0
        while time.monotonic() < end and not listening(port):
            master.poll()
        yield environment
    finally:
        master.terminate()
        master.wait(30.0)
        log.close()


def plain(environment: dict[str, str]) -> dict[str, str]:
    """The environment of Debian's own programs."""
    return {key: value for key, value in environment.items() if key != "PYTHONPATH"}


def listening(port: int) -> bool:
    with socket.socket() as one:
        one.settimeout(0.2)
        return one.connect_ex(("127.0.0.1", port)) == 0


@contextmanager
def running(code: str, ros: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """A process that has said its first line."""
    with subprocess.Popen(
        [sys.executable, "-c", code],
        env=ros,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as one:
        try:
            assert one.stdout is not None and one.stdout.readline()
            yield one
        finally:
            one.kill()


def told_by(device: subprocess.Popen[str]) -> Any:
    """What it has heard how often, and how it is."""
    told, _ = device.communicate("\n", timeout=30.0)
    return json.loads(told)


def tool(ros: dict[str, str], *command: str) -> str:
    """What a tool of ROS's own says."""
    ran = subprocess.run(
        command, env=plain(ros), capture_output=True, text=True, timeout=60.0, check=False
    )
    assert ran.returncode == 0, ran.stderr
    return ran.stdout


def test_every_command_arrives_and_a_killed_client_stops_it(ros: dict[str, str]) -> None:
    ran = subprocess.run(
        [sys.executable, "-c", STORY],
        env=ros,
        capture_output=True,
        text=True,
        timeout=120.0,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    told, still = json.loads(ran.stdout.splitlines()[-1])
    assert told["on"] and told["commands"] > 200
    assert told["sent"] + told["withheld"] + told["refused"] == told["commands"]
    assert told["heard"] == told["sent"] > 200
    assert AT_ONCE < still <= STILL_AFTER


@pytest.mark.parametrize("age", [5_000_000_000, 0])
def test_an_old_latched_enable_moves_nothing(ros: dict[str, str], age: int) -> None:
    """Neither with its old stamp, nor without one."""
    with running(f"AGE = {age}\n{LATCHED}", ros), running(DEVICE, ros) as device:
        tool(ros, "rostopic", "echo", "-n", "30", "/PSM1/measured_js/header/seq")
        assert told_by(device) == [{"PSM1/state_command": 1}, "DISABLED"]


def test_ros_own_tools_read_and_write_the_same_messages(ros: dict[str, str]) -> None:
    with running(DEVICE, ros) as device:
        told = tool(ros, "rostopic", "echo", "-n", "1", "/PSM1/measured_js")
        assert "name: \n  - yaw\n  - pitch\n  - insertion\n  - roll\n" in told
        kinds = {
            "measured_js": "sensor_msgs/JointState",
            "operating_state": "crtk_msgs/OperatingState",
            "warning": "crtk_msgs/StringStamped",
        }
        for topic, kind in kinds.items():
            assert tool(ros, "rostopic", "type", f"/PSM1/{topic}").strip() == kind
        said = "{position: [0, 0, 0.1, 0, 0, 0]}"
        tool(ros, "rostopic", "pub", "-1", "/PSM1/servo_jp", "sensor_msgs/JointState", said)
        assert told_by(device) == [{"PSM1/servo_jp": 1}, "DISABLED"]


def test_a_tool_of_ros_own_that_moves_it_is_heard(ros: dict[str, str]) -> None:
    with running(DEVICE, ros), running(CLIENT, ros) as client:
        assert tool(ros, "rostopic", "type", "/PSM1/servo_cp").strip() == POSE
        said = "{pose: {position: {x: 0.1}, orientation: {w: 1.0}}}"
        tool(ros, "rostopic", "pub", "-1", "/PSM1/servo_cp", POSE, said)
        assert "somebody else sends PSM1 where to go" in told_by(client)


def test_where_there_is_no_master_it_says_so(tmp_path: Path) -> None:
    code = "from rcmservo.app.cli import main; main(['emulate', 'crtk', '--ros', '1'])"
    environment = os.environ | {
        "ROS_MASTER_URI": "http://127.0.0.1:1",
        "ROS_LOG_DIR": str(tmp_path),
    }
    ran = subprocess.run(
        [sys.executable, "-c", code],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120.0,
        check=False,
    )
    assert "no ROS 1 master answers at http://127.0.0.1:1: start roscore" in ran.stderr
    assert ran.stderr.count("\n") == 1
