"""Driver, emulated arm and ROS's own tools over ROS 1 from Debian's packages, with a real master.

A process stays one node for its lifetime, so everything that uses ROS 1 runs in separate processes.
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
from peers import mark_peer

PACKAGES = (
    "ros-core python3-rospy python3-std-msgs python3-sensor-msgs python3-geometry-msgs "
    "python3-rostopic"
)
EARLIEST_STOP_MS, LATEST_STOP_MS = -20.0, 100.0
"""Time of the stop after the client was killed."""

pytestmark = [
    pytest.mark.slow,
    mark_peer(
        "ROS 1",
        all(map(shutil.which, ("roscore", "rostopic"))),
        f"apt-get install {PACKAGES}",
    ),
]

STREAM_AND_KILL = """
import json
from crtk_measures import RunningDevice, killed, streamed
device = RunningDevice(1, 0)
report = streamed(1, 0, device, 1.5)
print(json.dumps([report, killed(1, 0, device, 0.13)]))
device.close()
"""

LATCHED_ENABLE = """
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
print(json.dumps(arm.off_reason), flush=True)
arm.close()
"""

POSE = "geometry_msgs/PoseStamped"


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """Run a master and return the environment of its clients."""
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
        ["roscore", "-p", str(port)], env=without_pythonpath(environment), stdout=log, stderr=log
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


def without_pythonpath(environment: dict[str, str]) -> dict[str, str]:
    """Return the environment of Debian's own programs."""
    return {key: value for key, value in environment.items() if key != "PYTHONPATH"}


def listening(port: int) -> bool:
    with socket.socket() as one:
        one.settimeout(0.2)
        return one.connect_ex(("127.0.0.1", port)) == 0


@contextmanager
def running(code: str, ros: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """Run a process that has printed its first line."""
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


def report_of(process: subprocess.Popen[str]) -> Any:
    """End a process and return its report."""
    report, _ = process.communicate("\n", timeout=30.0)
    return json.loads(report)


def run_tool(ros: dict[str, str], *command: str) -> str:
    """Run a tool of ROS and return its output."""
    ran = subprocess.run(
        command,
        env=without_pythonpath(ros),
        capture_output=True,
        text=True,
        timeout=60.0,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    return ran.stdout


@pytest.mark.alone
def test_every_command_arrives_and_a_killed_client_stops_it(ros: dict[str, str]) -> None:
    ran = subprocess.run(
        [sys.executable, "-c", STREAM_AND_KILL],
        env=ros,
        capture_output=True,
        text=True,
        timeout=120.0,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    report, still = json.loads(ran.stdout.splitlines()[-1])
    assert report["on"] and report["commands"] > 100
    assert report["sent"] + report["withheld"] + report["refused"] == report["commands"]
    assert report["heard"] == report["sent"] > 100
    assert EARLIEST_STOP_MS < still <= LATEST_STOP_MS


@pytest.mark.parametrize("age", [5_000_000_000, 0])
def test_an_old_latched_enable_moves_nothing(ros: dict[str, str], age: int) -> None:
    """With an old stamp and without one."""
    with running(f"AGE = {age}\n{LATCHED_ENABLE}", ros), running(DEVICE, ros) as device:
        run_tool(ros, "rostopic", "echo", "-n", "30", "/PSM1/measured_js/header/seq")
        assert report_of(device) == [{"PSM1/state_command": 1}, "DISABLED"]


def test_tools_of_ros_read_and_write_the_same_messages(ros: dict[str, str]) -> None:
    with running(DEVICE, ros) as device:
        report = run_tool(ros, "rostopic", "echo", "-n", "1", "/PSM1/measured_js")
        assert "name: \n  - yaw\n  - pitch\n  - insertion\n  - roll\n" in report
        kinds = {
            "measured_js": "sensor_msgs/JointState",
            "operating_state": "crtk_msgs/OperatingState",
            "warning": "crtk_msgs/StringStamped",
        }
        for topic, kind in kinds.items():
            assert run_tool(ros, "rostopic", "type", f"/PSM1/{topic}").strip() == kind
        message = "{position: [0, 0, 0.1, 0, 0, 0]}"
        run_tool(ros, "rostopic", "pub", "-1", "/PSM1/servo_jp", "sensor_msgs/JointState", message)
        assert report_of(device) == [{"PSM1/servo_jp": 1}, "DISABLED"]


def test_a_motion_command_of_a_tool_of_ros_is_detected(ros: dict[str, str]) -> None:
    with running(DEVICE, ros), running(CLIENT, ros) as client:
        assert run_tool(ros, "rostopic", "type", "/PSM1/servo_cp").strip() == POSE
        message = "{pose: {position: {x: 0.1}, orientation: {w: 1.0}}}"
        run_tool(ros, "rostopic", "pub", "-1", "/PSM1/servo_cp", POSE, message)
        assert "another client sends motion commands to PSM1" in report_of(client)


def test_a_missing_master_is_reported(tmp_path: Path) -> None:
    code = "from rcmservo.cli.cli import main; main(['emulate', 'crtk', '--ros', '1'])"
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
