"""How the emulated axes move: by the words of Galil's command reference."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware.talk import Talk
from rcmservo.hardware.galil.emulator.axis import StopCode


def jogging(speed: int, acceleration: int = 102400) -> Talk:
    """Axis A jogs at its speed."""
    talk = Talk()
    talk(b"SH A;AC %d;DC %d;JG %d;BG A\r" % (acceleration, acceleration, speed))
    talk.after(abs(speed) / acceleration + 0.05)
    return talk


def test_a_jog_gains_its_speed_evenly_and_keeps_it() -> None:
    talk = Talk()
    talk(b"AC 51200;JG 25600;BG A\r")
    talk.after(0.25)
    assert talk.controller.state.axes[0].speed == pytest.approx(12800.0, rel=0.01)
    assert talk.number("_TPA") == pytest.approx(0.5 * 51200 * 0.25**2, rel=0.02)
    talk.after(0.5)
    assert talk.controller.state.axes[0].speed == 25600.0


@given(first=st.integers(-20000, 20000), then=st.integers(-20000, 20000))
def test_a_new_speed_counts_at_once_and_is_reached_without_a_jump(first: int, then: int) -> None:
    talk = jogging(first // 2 * 2)
    talk(b"JG %d\r" % (then // 2 * 2))
    axis = talk.controller.state.axes[0]
    speeds = [axis.speed]
    for _ in range(500):
        talk.after(1 / 1024)
        speeds.append(axis.speed)
    steps = [abs(b - a) for a, b in pairwise(speeds)]
    assert max(steps) <= 102400 / 1024 + 1e-9
    assert axis.speed == then // 2 * 2


def test_a_stop_decelerates_and_motion_is_over_only_then() -> None:
    talk = jogging(20480)
    assert talk(b"ST A;SC A;MG _BGA\r") == b": 4\r\n: 1.0000\r\n:"
    talk.after(0.1)
    assert talk(b"MO A\r") == b"?"
    talk.after(0.15)
    assert talk(b"MG _BGA;MO A\r") == b" 0.0000\r\n::"


def test_an_abort_stands_still_at_once_and_ends_the_program_unless_it_is_told_not_to() -> None:
    for text, left in ((b"AB 1\r", 1.0), (b"AB\r", 0.0)):
        talk = jogging(20480)
        talk(b"DL\r#A\rWT 2\rJP #A\r\\")
        talk(b"XQ #A\r")
        where = talk.number("_RPA")
        talk(text)
        talk.after(0.02)
        assert abs(talk.number("_RPA") - where) <= 1.0
        assert talk(b"SC A\r") == b" 7\r\n:"
        assert talk.number("_NO") == left


@pytest.mark.parametrize(("way", "code"), [(1, StopCode.FORWARD), (-1, StopCode.REVERSE)])
def test_a_soft_limit_stops_an_axis_that_passed_it_and_lets_it_back_alone(
    way: int, code: int
) -> None:
    talk = Talk()
    limit = b"FL" if way > 0 else b"BL"
    talk(b"AC 102400;SD 204800;%s %d;JG %d;BG A\r" % (limit, way * 5000, way * 10240))
    talk.after(1.5)
    over = way * talk.number("_TPA") - 5000
    assert 0 < over <= 10240**2 / (2 * 204800) * 1.1 + 20
    assert talk.number("_SCA") == code
    assert talk(b"JG %d;BG A\r" % (way * 500)) == b":?"
    assert talk(b"TC\r") == b"22\r\n:"
    assert talk(b"JG %d;BG A\r" % (-way * 500)) == b"::"


def test_a_limit_switch_stops_its_axis_and_is_told_raw_by_TS_and_allowed_by_LF() -> None:
    """CR CN, TS, _LF: low is tripped by default; _LF is 0 where motion is prohibited."""
    talk = jogging(2048)
    free = int(talk(b"TS A\r").split(b"\r")[0])
    talk.motors.tripped = [(True, False)] + [(False, False)] * 3
    talk.after(0.05)
    tripped = int(talk(b"TS A\r").split(b"\r")[0])
    assert free & 0b1000 and not tripped & 0b1000 and tripped & 0b0100
    assert talk.number("_LFA") == 0.0 and talk.number("_LRA") == 1.0
    assert talk(b"SC A;MG _BGA\r") == b" 2\r\n: 0.0000\r\n:"
    talk(b"CN 1\r")
    assert int(talk(b"TS A\r").split(b"\r")[0]) & 0b1000
    assert talk.number("_LFA") == 0.0


def test_an_axis_that_does_not_follow_goes_off_where_that_is_asked_for() -> None:
    for asked, off in ((b"0", 0.0), (b"1", 1.0)):
        talk = jogging(2048)
        talk(b"ER 300;OE " + asked + b"\r")
        talk.controller.stuck = 0
        talk.after(0.3)
        assert talk.number("_MOA") == off
        assert (talk.number("_SCA") == StopCode.OFF_ON_ERROR) == bool(off)


@given(way=st.integers(-40000, 40000), speed=st.integers(1000, 60000))
def test_a_relative_move_ends_exactly_where_it_was_to(way: int, speed: int) -> None:
    talk = Talk()
    talk(b"AC 256000;DC 256000;SP %d;PR %d;BG A\r" % (speed, way))
    talk.after(abs(way) / (speed - 1) + speed / 256000 + 0.2)
    assert talk(b"MG _BGA;SC A\r") == b" 0.0000\r\n: 1\r\n:"
    assert talk.number("_RPA") == way


def test_an_absolute_move_ends_where_it_was_to_and_another_begin_does_not_move() -> None:
    talk = Talk()
    talk(b"DP 1000;PA 500;SP 5000;BG A\r")
    talk.after(1.0)
    assert talk.number("_RPA") == 500.0
    talk(b"BG A\r")
    talk.after(0.1)
    assert talk.number("_RPA") == 500.0


def test_a_program_waits_for_the_end_of_a_motion() -> None:
    talk = Talk()
    talk(b"DL\r#A\rPR 2000\rBG A\rAM A\rthere=1\rEN\r\\")
    talk(b"there=0;SP 10000;XQ #A\r")
    talk.after(0.1)
    assert talk.number("there") == 0.0
    talk.after(0.4)
    assert talk.number("there") == 1.0


def test_a_host_that_waits_for_the_end_of_a_motion_gets_its_prompt_then() -> None:
    talk = Talk()
    assert talk(b"PR 2000;SP 10000;BG A;AM A;RP A\r") == b":::"
    assert talk.after(0.1) == b""
    assert talk.after(0.4) == b": 2000\r\n:"


def test_a_reset_forgets_variables_program_and_place_and_whoever_was_connected() -> None:
    talk = Talk()
    talk(b"mine=7;DP 500;JG 1000;BG A\r")
    talk.controller.reset()
    assert not talk.controller.lines
    talk.handle = talk.controller.connect()
    assert talk(b"MG mine\r") == b"?"
    assert talk(b"TP A;MG _BGA\r") == b" 0\r\n: 0.0000\r\n:"


def test_eight_hosts_are_served_and_a_ninth_is_not() -> None:
    talk = Talk()
    handles = [talk.controller.connect() for _ in range(7)]
    assert sorted([0, *[h for h in handles if h is not None]]) == list(range(8))
    assert talk.controller.connect() is None
    talk.controller.disconnect(3)
    assert talk.controller.connect() == 3
