"""A client on another vendor's DDS drives the emulated arm.

The client uses eProsima Fast DDS from Debian, whose generator makes the message types from their
definitions.
"""

import contextlib
import json
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from crtk_measures import NAME, RunningDevice

from peers import mark_peer

PACKAGES = "libfastrtps-dev fastddsgen g++ default-jre-headless"
TOOLS = "fastddsgen", "g++", "java"
HERE = Path(__file__).parent / "fastdds"
SOURCES = "client.cpp", "crtk.cxx", "crtkPubSubTypes.cxx"
DOMAIN = 95

pytestmark = [
    pytest.mark.slow,
    pytest.mark.alone,
    mark_peer(
        "Fast DDS",
        all(map(shutil.which, TOOLS)) and Path("/usr/include/fastdds").is_dir(),
        f"apt-get install {PACKAGES}",
    ),
]


def build(folder: Path) -> Path:
    """Build the client, its sources at the same time, and return its path."""
    shutil.copytree(HERE, folder, dirs_exist_ok=True)
    run(folder, "fastddsgen", "-replace", "crtk.idl")
    with ThreadPoolExecutor() as pool:
        compiled = [pool.submit(run, folder, "g++", "-O0", "-c", source) for source in SOURCES]
    for one in compiled:
        one.result()
    objects = [f"{Path(source).stem}.o" for source in SOURCES]
    run(folder, "g++", "-o", "client", *objects, "-lfastrtps", "-lfastcdr", "-lpthread")
    return folder / "client"


def run(folder: Path, *command: str) -> None:
    result = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=300.0, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr


def test_the_client_enables_the_arm_sends_1000_positions_and_reads_the_joints(
    tmp_path: Path,
) -> None:
    client = build(tmp_path)
    with contextlib.closing(RunningDevice(2, DOMAIN)) as device:
        ran = subprocess.run(
            [client, str(DOMAIN)], capture_output=True, text=True, timeout=60.0, check=False
        )
        report = json.loads(ran.stdout)
        assert "failed" not in report
        assert report["sent"] == device.transport.heard[f"{NAME}/servo_jp"] == 1000
        assert report["warnings"] == 0 and report["names"] == 6 and report["off"]
        assert report["there"] == pytest.approx(report["wanted"], abs=1e-3)
        assert report["measured"] > 300
        assert device.device.state == "DISABLED"
