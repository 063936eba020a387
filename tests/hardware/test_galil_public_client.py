"""An unchanged public client drives the emulated controller.

The client is that of the Simons Observatory, socs 0.6.4, which uses raw TCP.
"""

import contextlib
import importlib
import sys
import time
from typing import Any

import pytest
from galil_measures import Emulated

from conftest import ROOT
from peers import mark_peer

PEERS = ROOT / ".peers"

pytestmark = [
    pytest.mark.slow,
    mark_peer("socs (Galil client)", (PEERS / "socs").is_dir(), "make peers"),
]


@pytest.fixture(scope="module")
def client() -> Any:
    """Return the client's module."""
    sys.path.append(str(PEERS))
    return importlib.import_module("socs.agents.galil_axis.drivers")


def test_the_client_has_the_version_whose_source_was_read(client: Any) -> None:
    assert importlib.metadata.version("socs") == "0.6.4"


def test_the_client_moves_queries_stops_and_reads_errors(
    client: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    with contextlib.closing(Emulated()) as emulated:
        axis = client.GalilAxis("127.0.0.1", emulated.port)
        assert set(axis.get_data(["A", "B"])) == {"A", "B"}
        axis.set_motor_state("A", "enable")
        assert axis.get_motor_state("A")[0] == 0
        axis.set_speed("A", 20000)
        axis.set_acceleration("A", 102400)
        axis.set_deceleration("A", 102400)
        axis.set_relative_position("A", 1.5, counts_per_unit=4000)
        assert axis.begin_motion("A") == (True, "Axis A is in motion.")
        time_out = time.monotonic() + 30.0
        while float(axis.is_running("A")) and time.monotonic() < time_out:
            pass
        assert axis.get_data(["A"])["A"]["position"] == pytest.approx(6000.0, abs=3.0)
        axis.set_motor_state("B", "enable")
        axis.set_jog_speed("B", -500)
        assert axis.begin_motion("B")[0]
        axis.stop_motion("B")
        while float(axis.is_running("B")) and time.monotonic() < time_out:
            pass
        assert axis.get_data(["B"])["B"]["position"] < 0.0
        axis.set_motor_state("A", "disable")
        assert axis.get_motor_state("A")[0] == 1
        assert axis.begin_motion("A")[0] is False
        assert axis.galil_command("QQ", expect_response=True) == "?"
        assert "1 Unrecognized command" in capsys.readouterr().out
