"""The simulated lab's arm as anybody's client meets it, on an injected clock."""

import numpy as np
import pytest
from simulated_wire import START, TICK, CrtkLab

from rcmservo.hardware.crtk import messages as m
from rcmservo.hardware.crtk.device import NAMES

MS = 1_000_000
THERE = (0.15, -0.1, 0.11, 0.0, 0.2, 0.0)


def enabled() -> CrtkLab:
    lab = CrtkLab()
    tell(lab, "enable")
    return lab


def tell(lab: CrtkLab, word: str, age: int = 0) -> None:
    lab.device.hear_command(m.StringStamped(lab.real() - age, word), "console")


def ask(lab: CrtkLab, writer: str = "one", ticks: int = 1, **parts: object) -> None:
    """Positions every 10 ms, as a writer sends them: by default without stamp and names."""
    topic, end = m.SERVO_JP.under("PSM1"), lab.wire.end(writer)
    for _ in range(ticks):
        end.publish(topic, m.JointState(**({"stamp": 0, "position": THERE} | parts)))  # type: ignore[arg-type]
        lab.let_pass(TICK)


def here(lab: CrtkLab) -> tuple[float, ...]:
    return [said for topic, said in lab.wire.said if topic == "PSM1/measured_js"][-1].position


def test_it_starts_disabled_and_homed_and_goes_where_it_is_asked_to_be() -> None:
    lab = CrtkLab()
    assert lab.device.state == "DISABLED" and lab.device.homed
    tell(lab, "enable")
    ask(lab, ticks=100)
    assert here(lab) == pytest.approx(THERE, abs=1e-4)
    assert not lab.wire.words("PSM1/warning")


@pytest.mark.parametrize("names", [NAMES, tuple("012345"), (*NAMES[::-1],)])
def test_joints_are_found_by_name(names: tuple[str, ...]) -> None:
    lab = enabled()
    position = THERE[::-1] if names[0] == NAMES[-1] else THERE
    ask(lab, ticks=100, name=names, position=position)
    assert here(lab) == pytest.approx(THERE, abs=1e-4)


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"position": (0.15, -0.1, 0.21, 0.0, 0.0, 0.0)}, "beyond its limit"),
        ({"position": (0.15, -0.1, 0.11, 0.0, 2.0, 0.0)}, "beyond its limit"),
        ({"position": THERE[:3]}, "six joints are wanted"),
        ({"position": (*THERE[:5], float("nan"))}, "six joints are wanted"),
        ({"name": ("a", *NAMES[1:])}, "six joints are wanted"),
        ({"name": (NAMES[1], *NAMES[1:])}, "six joints are wanted"),
        ({"stamp": 1}, "s old"),
    ],
)
def test_a_position_that_is_wrong_is_refused_whole_and_it_stays(
    parts: dict[str, object], words: str
) -> None:
    lab = enabled()
    ask(lab, ticks=10, **parts)
    assert here(lab)[:3] == pytest.approx(START * [1.0, 1.0, 1e-3])
    assert words in lab.wire.words("PSM1/warning")[0]


@pytest.mark.parametrize("word", ["", "unhome", "pause", "disable", "fault"])
def test_nothing_moves_unless_it_is_enabled_and_homed(word: str) -> None:
    lab = CrtkLab()
    if word:
        tell(lab, "enable")
        tell(lab, word)
    ask(lab, ticks=10)
    assert here(lab)[:3] == pytest.approx(START * [1.0, 1.0, 1e-3])
    assert "rejected servo_jp: the arm is" in lab.wire.words("PSM1/warning")[0]


def test_where_its_writer_falls_silent_it_stands_still_within_80_ms() -> None:
    lab = enabled()
    ask(lab, ticks=10)
    lab.let_pass(72 * MS)
    stood = lab.joints.q
    lab.let_pass(200 * MS)
    assert lab.joints.q.tolist() == stood.tolist() and lab.device.state == "ENABLED"
    assert "nothing more was heard" in lab.wire.words("PSM1/warning")[0]


def test_one_writer_has_it_until_it_is_disabled() -> None:
    """Pausing it or falling silent makes it nobody else's."""
    lab = enabled()
    ask(lab, "one", ticks=5)
    lab.let_pass(200 * MS)
    tell(lab, "pause")
    tell(lab, "resume")
    stood = here(lab)
    ask(lab, "two", ticks=5, position=(0.0,) * 2 + THERE[2:])
    assert here(lab) == pytest.approx(stood)
    assert "somebody else moves this arm" in lab.wire.words("PSM1/warning")[-1]
    tell(lab, "disable")
    tell(lab, "enable")
    ask(lab, "two", ticks=5)
    assert here(lab) != pytest.approx(stood)


def test_an_old_latched_enable_is_refused_and_so_is_one_without_stamp_soon_after_the_start() -> (
    None
):
    lab = CrtkLab()
    tell(lab, "enable", age=2000 * MS)
    lab.device.hear_command(m.StringStamped(0, "enable"), "latched")
    assert lab.device.state == "DISABLED" and len(lab.wire.words("PSM1/warning")) == 2
    lab.let_pass(2100 * MS)
    lab.device.hear_command(m.StringStamped(0, "enable"), "public client")
    assert lab.device.state == "ENABLED"


@pytest.mark.parametrize(
    ("word", "state"), [("disable", "DISABLED"), ("pause", "PAUSED"), ("fault", "FAULT")]
)
@pytest.mark.parametrize("age", [3600_000 * MS, -3600_000 * MS, None])
def test_what_calms_it_is_taken_however_old_it_is(word: str, state: str, age: int | None) -> None:
    lab = enabled()
    stamp = 0 if age is None else lab.real() - age
    lab.device.hear_command(m.StringStamped(stamp, word), "console")
    assert lab.device.state == state


@pytest.mark.parametrize("word", ["resume", "home", "clear_fault"])
def test_what_may_lead_to_motion_is_not_taken_when_it_is_old(word: str) -> None:
    lab = enabled()
    tell(lab, "pause" if word == "resume" else "fault" if word == "clear_fault" else "unhome")
    before = lab.device.state, lab.device.homed
    tell(lab, word, age=2000 * MS)
    assert (lab.device.state, lab.device.homed) == before


def test_enable_in_fault_is_refused_until_the_fault_is_cleared() -> None:
    lab = enabled()
    tell(lab, "fault")
    tell(lab, "enable")
    assert lab.device.state == "FAULT"
    assert lab.wire.words("PSM1/warning") == ["rejected enable: the arm is FAULT"]
    tell(lab, "clear_fault")
    assert lab.device.state == "DISABLED"


def test_stamps_of_its_states_rise() -> None:
    lab = enabled()
    for word in ("pause", "resume", "disable", "enable"):
        tell(lab, word)
    stamps = [said.stamp for topic, said in lab.wire.said if topic == "PSM1/operating_state"]
    assert len(stamps) == 6 and (np.diff(stamps) > 0).all()
