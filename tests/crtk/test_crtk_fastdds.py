"""Another vendor's DDS drives the simulated arm: a small client on eProsima Fast DDS, from Debian,
with message types that its own generator makes of their definitions."""

import contextlib
import json
import shutil
import subprocess
from pathlib import Path

import pytest
from crtk_measures import NAME, RunningDevice

from peers import peer

PACKAGES = "libfastrtps-dev fastddsgen g++ default-jre-headless"
TOOLS = "fastddsgen", "g++", "java"
HERE = Path(__file__).parent / "fastdds"
DOMAIN = 95

pytestmark = [
    pytest.mark.slow,
    pytest.mark.alone,
    peer(
        "Fast DDS",
        all(map(shutil.which, TOOLS)) and Path("/usr/include/fastdds").is_dir(),
        f"apt-get install {PACKAGES}",
    ),
]


def built(folder: Path) -> Path:
    """The client's program."""
    shutil.copytree(HERE, folder, dirs_exist_ok=True)
    done(folder, "fastddsgen", "-replace", "crtk.idl")
    sources = ["client.cpp", "crtk.cxx", "crtkPubSubTypes.cxx"]
    done(folder, "g++", "-O1", "-o", "client", *sources, "-lfastrtps", "-lfastcdr", "-lpthread")
    return folder / "client"


def done(folder: Path, *command: str) -> None:
    made = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=300.0, check=False
    )
    assert made.returncode == 0, made.stdout + made.stderr


def test_it_enables_sends_a_thousand_positions_and_reads_the_joints(tmp_path: Path) -> None:
    client = built(tmp_path)
    with contextlib.closing(RunningDevice(2, DOMAIN)) as device:
        ran = subprocess.run(
            [client, str(DOMAIN)], capture_output=True, text=True, timeout=60.0, check=False
        )
        told = json.loads(ran.stdout)
        assert "failed" not in told
        assert told["sent"] == device.transport.heard[f"{NAME}/servo_jp"] == 1000
        assert told["warnings"] == 0 and told["names"] == 6 and told["off"]
        assert told["there"] == pytest.approx(told["wanted"], abs=1e-3)
        assert told["measured"] > 300
        assert device.device.state == "DISABLED"
