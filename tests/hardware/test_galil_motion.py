"""Motion of the emulated axes, as Galil's command reference describes it."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware.emulated_host import EmulatedHost
from rcmservo.hardware.galil.emulator.axis import StopCode


def start_jog(speed: int, acceleration: int = 102400) -> EmulatedHost:
    """Return a host whose axis A jogs at a speed."""
    host = EmulatedHost()
    host(b"SH A;AC %d;DC %d;JG %d;BG A\r" % (acceleration, acceleration, speed))
    host.after(abs(speed) / acceleration + 0.05)
    return host


def test_a_jog_accelerates_evenly_to_a_constant_speed() -> None:
    host = EmulatedHost()
    host(b"AC 51200;JG 25600;BG A\r")
    host.after(0.25)
    assert host.controller.state.axes[0].speed == pytest.approx(12800.0, rel=0.01)
    assert host.number("_TPA") == pytest.approx(0.5 * 51200 * 0.25**2, rel=0.02)
    host.after(0.5)
    assert host.controller.state.axes[0].speed == 25600.0


@given(first_speed=st.integers(-20000, 20000), next_speed=st.integers(-20000, 20000))
def test_a_new_speed_takes_effect_at_once_and_is_reached_without_a_jump(
    first_speed: int, next_speed: int
) -> None:
    host = start_jog(first_speed // 2 * 2)
    host(b"JG %d\r" % (next_speed // 2 * 2))
    axis = host.controller.state.axes[0]
    speeds = [axis.speed]
    for _ in range(500):
        host.after(1 / 1024)
        speeds.append(axis.speed)
    steps = [abs(b - a) for a, b in pairwise(speeds)]
    assert max(steps) <= 102400 / 1024 + 1e-9
    assert axis.speed == next_speed // 2 * 2


def test_a_stop_decelerates_and_the_motion_ends_only_at_rest() -> None:
    host = start_jog(20480)
    assert host(b"ST A;SC A;MG _BGA\r") == b": 4\r\n: 1.0000\r\n:"
    host.after(0.1)
    assert host(b"MO A\r") == b"?"
    host.after(0.15)
    assert host(b"MG _BGA;MO A\r") == b" 0.0000\r\n::"


def test_an_abort_stops_at_once_and_ends_the_program_except_for_AB_1() -> None:
    for text, threads in ((b"AB 1\r", 1.0), (b"AB\r", 0.0)):
        host = start_jog(20480)
        host(b"DL\r#A\rWT 2\rJP #A\r\\")
        host(b"XQ #A\r")
        stopped = host.number("_RPA")
        host(text)
        host.after(0.02)
        assert abs(host.number("_RPA") - stopped) <= 1.0
        assert host(b"SC A\r") == b" 7\r\n:"
        assert host.number("_NO") == threads


@pytest.mark.parametrize(("direction", "code"), [(1, StopCode.FORWARD), (-1, StopCode.REVERSE)])
def test_a_soft_limit_stops_an_axis_and_then_permits_only_motion_back(
    direction: int, code: int
) -> None:
    host = EmulatedHost()
    limit = b"FL" if direction > 0 else b"BL"
    host(b"AC 102400;SD 204800;%s %d;JG %d;BG A\r" % (limit, direction * 5000, direction * 10240))
    host.after(1.5)
    overrun = direction * host.number("_TPA") - 5000
    assert 0 < overrun <= 10240**2 / (2 * 204800) * 1.1 + 20
    assert host.number("_SCA") == code
    assert host(b"JG %d;BG A\r" % (direction * 500)) == b":?"
    assert host(b"TC\r") == b"22\r\n:"
    assert host(b"JG %d;BG A\r" % (-direction * 500)) == b"::"


def test_a_limit_switch_stops_its_axis_and_TS_reports_its_level_and_LF_the_permission() -> None:
    """CR CN, TS, _LF: a tripped switch is low by default; _LF is 0 if motion is prohibited."""
    host = start_jog(2048)
    free = int(host(b"TS A\r").split(b"\r")[0])
    host.motors.tripped = [(True, False)] + [(False, False)] * 3
    host.after(0.05)
    tripped = int(host(b"TS A\r").split(b"\r")[0])
    assert free & 0b1000 and not tripped & 0b1000 and tripped & 0b0100
    assert host.number("_LFA") == 0.0 and host.number("_LRA") == 1.0
    assert host(b"SC A;MG _BGA\r") == b" 2\r\n: 0.0000\r\n:"
    host(b"CN 1\r")
    assert int(host(b"TS A\r").split(b"\r")[0]) & 0b1000
    assert host.number("_LFA") == 0.0


def test_a_following_error_switches_the_motor_off_only_with_OE() -> None:
    for setting, off in ((b"0", 0.0), (b"1", 1.0)):
        host = start_jog(2048)
        host(b"ER 300;OE " + setting + b"\r")
        host.controller.stuck = 0
        host.after(0.3)
        assert host.number("_MOA") == off
        assert (host.number("_SCA") == StopCode.OFF_ON_ERROR) == bool(off)


@given(distance=st.integers(-40000, 40000), speed=st.integers(1000, 60000))
def test_a_relative_move_ends_exactly_at_its_target(distance: int, speed: int) -> None:
    host = EmulatedHost()
    host(b"AC 256000;DC 256000;SP %d;PR %d;BG A\r" % (speed, distance))
    host.after(abs(distance) / (speed - 1) + speed / 256000 + 0.2)
    assert host(b"MG _BGA;SC A\r") == b" 0.0000\r\n: 1\r\n:"
    assert host.number("_RPA") == distance


def test_an_absolute_move_ends_at_its_target_and_a_second_begin_does_not_move() -> None:
    host = EmulatedHost()
    host(b"DP 1000;PA 500;SP 5000;BG A\r")
    host.after(1.0)
    assert host.number("_RPA") == 500.0
    host(b"BG A\r")
    host.after(0.1)
    assert host.number("_RPA") == 500.0


def test_a_program_can_wait_for_the_end_of_a_motion() -> None:
    host = EmulatedHost()
    host(b"DL\r#A\rPR 2000\rBG A\rAM A\rthere=1\rEN\r\\")
    host(b"there=0;SP 10000;XQ #A\r")
    host.after(0.1)
    assert host.number("there") == 0.0
    host.after(0.4)
    assert host.number("there") == 1.0


def test_a_host_that_waits_for_the_end_of_a_motion_gets_its_prompt_at_the_end() -> None:
    host = EmulatedHost()
    assert host(b"PR 2000;SP 10000;BG A;AM A;RP A\r") == b":::"
    assert host.after(0.1) == b""
    assert host.after(0.4) == b": 2000\r\n:"


def test_a_reset_clears_variables_program_position_and_connections() -> None:
    host = EmulatedHost()
    host(b"mine=7;DP 500;JG 1000;BG A\r")
    host.controller.reset()
    assert not host.controller.connections
    host.handle = host.controller.connect()
    assert host(b"MG mine\r") == b"?"
    assert host(b"TP A;MG _BGA\r") == b" 0\r\n: 0.0000\r\n:"


def test_eight_hosts_can_connect_and_a_ninth_cannot() -> None:
    host = EmulatedHost()
    handles = [host.controller.connect() for _ in range(7)]
    assert sorted([0, *[h for h in handles if h is not None]]) == list(range(8))
    assert host.controller.connect() is None
    host.controller.disconnect(3)
    assert host.controller.connect() == 3
