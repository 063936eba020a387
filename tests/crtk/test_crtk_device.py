"""Emulated CRTK arm as any client sees it, on a simulated clock."""

import numpy as np
import pytest
from simulated_transport import START, TICK, CrtkLab

from rcmservo.hardware.crtk import messages
from rcmservo.hardware.crtk.device import JOINT_NAMES

MS = 1_000_000
GOAL = (0.15, -0.1, 0.11, 0.0, 0.2, 0.0)


def enabled() -> CrtkLab:
    lab = CrtkLab()
    send_command(lab, "enable")
    return lab


def send_command(lab: CrtkLab, command: str, age: int = 0) -> None:
    lab.device.receive_command(messages.StringStamped(lab.real() - age, command), "console")


def send_position(lab: CrtkLab, writer: str = "one", ticks: int = 1, **fields: object) -> None:
    """Send positions every 10 ms, by default without stamp and names."""
    topic, endpoint = messages.SERVO_JP.under("PSM1"), lab.network.endpoint(writer)
    for _ in range(ticks):
        endpoint.publish(topic, messages.JointState(**({"stamp": 0, "position": GOAL} | fields)))  # type: ignore[arg-type]
        lab.advance(TICK)


def measured_position(lab: CrtkLab) -> tuple[float, ...]:
    return [message for topic, message in lab.network.sent if topic == "PSM1/measured_js"][
        -1
    ].position


def test_the_arm_starts_disabled_and_homed_and_moves_to_a_commanded_position() -> None:
    lab = CrtkLab()
    assert lab.device.state == "DISABLED" and lab.device.homed
    send_command(lab, "enable")
    send_position(lab, ticks=100)
    assert measured_position(lab) == pytest.approx(GOAL, abs=1e-4)
    assert not lab.network.texts("PSM1/warning")


@pytest.mark.parametrize("names", [JOINT_NAMES, tuple("012345"), (*JOINT_NAMES[::-1],)])
def test_joints_are_assigned_by_name(names: tuple[str, ...]) -> None:
    lab = enabled()
    position = GOAL[::-1] if names[0] == JOINT_NAMES[-1] else GOAL
    send_position(lab, ticks=100, name=names, position=position)
    assert measured_position(lab) == pytest.approx(GOAL, abs=1e-4)


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"position": (0.15, -0.1, 0.21, 0.0, 0.0, 0.0)}, "beyond its limit"),
        ({"position": (0.15, -0.1, 0.11, 0.0, 2.0, 0.0)}, "beyond its limit"),
        ({"position": GOAL[:3]}, "expected six joints"),
        ({"position": (*GOAL[:5], float("nan"))}, "expected six joints"),
        ({"name": ("a", *JOINT_NAMES[1:])}, "expected six joints"),
        ({"name": (JOINT_NAMES[1], *JOINT_NAMES[1:])}, "expected six joints"),
        ({"stamp": 1}, "s old"),
    ],
)
def test_an_invalid_position_is_refused_as_a_whole_and_the_arm_stays(
    fields: dict[str, object], text: str
) -> None:
    lab = enabled()
    send_position(lab, ticks=10, **fields)
    assert measured_position(lab)[:3] == pytest.approx(START * [1.0, 1.0, 1e-3])
    assert text in lab.network.texts("PSM1/warning")[0]


@pytest.mark.parametrize("command", ["", "unhome", "pause", "disable", "fault"])
def test_the_arm_moves_only_while_it_is_enabled_and_homed(command: str) -> None:
    lab = CrtkLab()
    if command:
        send_command(lab, "enable")
        send_command(lab, command)
    send_position(lab, ticks=10)
    assert measured_position(lab)[:3] == pytest.approx(START * [1.0, 1.0, 1e-3])
    assert "rejected servo_jp: the arm is" in lab.network.texts("PSM1/warning")[0]


def test_the_arm_of_a_silent_writer_stops_within_80_ms() -> None:
    lab = enabled()
    send_position(lab, ticks=10)
    lab.advance(72 * MS)
    stopped = lab.joints.q
    lab.advance(200 * MS)
    assert lab.joints.q.tolist() == stopped.tolist() and lab.device.state == "ENABLED"
    assert "no further position command arrived" in lab.network.texts("PSM1/warning")[0]


def test_one_writer_controls_the_arm_until_it_is_disabled() -> None:
    """A pause or a silent writer does not end the control."""
    lab = enabled()
    send_position(lab, "one", ticks=5)
    lab.advance(200 * MS)
    send_command(lab, "pause")
    send_command(lab, "resume")
    stopped = measured_position(lab)
    send_position(lab, "two", ticks=5, position=(0.0,) * 2 + GOAL[2:])
    assert measured_position(lab) == pytest.approx(stopped)
    assert "another client controls this arm" in lab.network.texts("PSM1/warning")[-1]
    send_command(lab, "disable")
    send_command(lab, "enable")
    send_position(lab, "two", ticks=5)
    assert measured_position(lab) != pytest.approx(stopped)


def test_an_old_latched_enable_is_refused_and_so_is_one_without_stamp_soon_after_the_start() -> (
    None
):
    lab = CrtkLab()
    send_command(lab, "enable", age=2000 * MS)
    lab.device.receive_command(messages.StringStamped(0, "enable"), "latched")
    assert lab.device.state == "DISABLED" and len(lab.network.texts("PSM1/warning")) == 2
    lab.advance(2100 * MS)
    lab.device.receive_command(messages.StringStamped(0, "enable"), "public client")
    assert lab.device.state == "ENABLED"


@pytest.mark.parametrize(
    ("command", "state"), [("disable", "DISABLED"), ("pause", "PAUSED"), ("fault", "FAULT")]
)
@pytest.mark.parametrize("age", [3600_000 * MS, -3600_000 * MS, None])
def test_stopping_commands_are_accepted_at_any_age(
    command: str, state: str, age: int | None
) -> None:
    lab = enabled()
    stamp = 0 if age is None else lab.real() - age
    lab.device.receive_command(messages.StringStamped(stamp, command), "console")
    assert lab.device.state == state


@pytest.mark.parametrize("command", ["resume", "home", "clear_fault"])
def test_old_commands_that_may_lead_to_motion_are_refused(command: str) -> None:
    lab = enabled()
    send_command(
        lab, "pause" if command == "resume" else "fault" if command == "clear_fault" else "unhome"
    )
    before = lab.device.state, lab.device.homed
    send_command(lab, command, age=2000 * MS)
    assert (lab.device.state, lab.device.homed) == before


def test_enable_in_fault_is_refused_until_the_fault_is_cleared() -> None:
    lab = enabled()
    send_command(lab, "fault")
    send_command(lab, "enable")
    assert lab.device.state == "FAULT"
    assert lab.network.texts("PSM1/warning") == ["rejected enable: the arm is FAULT"]
    send_command(lab, "clear_fault")
    assert lab.device.state == "DISABLED"


def test_stamps_of_the_operating_states_rise() -> None:
    lab = enabled()
    for command in ("pause", "resume", "disable", "enable"):
        send_command(lab, command)
    stamps = [
        message.stamp for topic, message in lab.network.sent if topic == "PSM1/operating_state"
    ]
    assert len(stamps) == 6 and (np.diff(stamps) > 0).all()
