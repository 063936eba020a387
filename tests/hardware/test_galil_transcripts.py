"""Replies of the emulated controller, compared with replies in public sources.

Sources:
CR   Galil's command reference, as quoted in rmcdowell-acertaralabs/galil_setup_tool_enhanced,
     command_validator.py (edition for the DMC-4103; entries marked there as the DMC-4000's too)
TMT  tmtsoftware/galil-prototype, galil-io/README.md and GalilIoTest.scala
EP   motorapp/Galil, GalilController.cpp and GalilConnector.cpp (EPICS)
BL   ESRF BLISS, galil.py and its test on hardware
VI   viamrobotics/rdk, components/motor/dmc4000/dmc4000_test.go
M17  Galil DMC-1700 user manual, page 83
SO   simonsobs/socs 0.6.4, agents/galil_axis/drivers.py
"""

import pytest

from hardware.emulated_host import EmulatedHost
from rcmservo.hardware.galil.error_codes import ErrorCode

EXCHANGES = [
    # framing and prompts
    ("TMT", [(b"a=1;b=2\r\n", b"::")]),
    ("TMT", [(b"a=1;b=2;c=3\r\n", b":::")]),
    ("TMT", [(b"a=1;BADCMD\r\n", b":?")]),
    ("TMT", [(b"\r\n", b":")]),
    (
        "EP: one prompt per semicolon, and one",
        [(b"SH;MG 1;XX;MG 2\r", b": 1.0000\r\n:? 2.0000\r\n:")],
    ),
    ("BL: a semicolon alone ends a command", [(b"MG 1+3;", b" 4.0000\r\n:")]),
    ("M17", [(b"bg\r", b"?"), (b"TC1\r", b"1 Unrecognized command\r\n:")]),
    ("BL", [(b"BLA;", b"?")]),
    (
        "TMT: TC clears the error",
        [(b"BADCMD\r", b"?"), (b"TC0\r", b"1\r\n:"), (b"TC1\r", b"0\r\n:")],
    ),
    ("CR TC: _TC does not clear it", [(b"QQ\r", b"?"), (b"MG _TC;TC\r", b" 1.0000\r\n:1\r\n:")]),
    # numbers
    ("CR: left to right", [(b"MG 1+2*3\r", b" 9.0000\r\n:"), (b"MG 1+(2*3)\r", b" 7.0000\r\n:")]),
    ("CR @ABS", [(b"MG @ABS[-2147483647]\r", b" 2147483647.0000\r\n:")]),
    ("CR MG", [(b"MG 1234.5678\r", b" 1234.5678\r\n:")]),
    ("CR MG", [(b'MG "Good Morning"\r', b"Good Morning\r\n:")]),
    (
        "CR MG",
        [(b'total=1234.53;MG "The answer is...",total{F4.2}\r', b":The answer is... 1234.53\r\n:")],
    ),
    (
        "CR MG",
        [
            (
                b"DM arr[3];arr[1]=1;arr[2]=2;MG arr[0],arr[1],arr[2]\r",
                b"::: 0.0000 1.0000 2.0000\r\n:",
            )
        ],
    ),
    ("CR LZ", [(b"var1=10;var1=?\r", b": 10.0000\r\n:")]),
    ("CR DM", [(b"DM?\r", b"16000\r\n:")]),
    ("TMT: an unknown array", [(b"MG ae[0]\r", b"?"), (b"TC\r", b"57\r\n:")]),
    ("EP: an unknown variable", [(b"MG homedA\r", b"?")]),
    # reports
    (
        "CR TP",
        [
            (b"DP 200,-10,0,-110\r", b":"),
            (b"TP\r", b" 200, -10, 0, -110\r\n:"),
            (b"TPA\r", b" 200\r\n:"),
            (b"TPB\r", b" -10\r\n:"),
        ],
    ),
    ("CR QZ", [(b"QZ\r", b" 4, 52, 26, 36\r\n:")]),
    ("CR WH", [(b"WH\r", b"IHA\r\n:")]),
    ("BL", [(b"MG_BGA\r", b" 0.0000\r\n:")]),
    ("CR OE", [(b"OEA=1;MG _OEA\r", b": 1.0000\r\n:")]),
    ("CR SH: _MO", [(b"MOA;MG _MOA\r", b": 1.0000\r\n:"), (b"SHA;MG _MOA\r", b": 0.0000\r\n:")]),
    ("EP, CR XQ: no thread runs", [(b"MG _XQ0\r", b" -1.0000\r\n:")]),
    # settings
    ("BL on hardware", [(b"ACA=73422\r", b":"), (b"ACA=?\r", b" 72704\r\n:")]),
    ("CR ER", [(b"ER 200,1000,400,600\r", b":"), (b"ER ?,?,?,?\r", b" 200, 1000, 400, 600\r\n:")]),
    ("CR JG: the absolute value", [(b"JGA=-5000;MG _JGA,_SPA\r", b": 5000.0000 5000.0000\r\n:")]),
    ("CR AC: out of range", [(b"AC 1023\r", b"?"), (b"TC1\r", b"6 Number out of range\r\n:")]),
    (
        "VI",
        [
            (b"MTA=2\r\n", b":"),
            (b"ACA=1066666\r\n", b":"),
            (b"SPA=10666\r\n", b":"),
            (b"PAA=-40960\r\n", b":"),
            (b"DPA=39680\r\n", b":"),
            (b"RPA\r\n", b" 39680\r\n:"),
        ],
    ),
    ("SO: decimals", [(b"PRA=6000.0\r", b":"), (b"MG _PRA\r", b" 6000.0000\r\n:")]),
    # motion
    (
        "CR SC",
        [
            (b"JG10000\r", b":"),
            (b"BGA\r", b":"),
            (b"SCA\r", b" 0\r\n:"),
            (b"STA\r", b":"),
            (b"SCA\r", b" 4\r\n:"),
        ],
    ),
    ("CR JG: a jog at 0 moves", [(b"JGA=0;BGA;MG _BGA\r", b":: 1.0000\r\n:")]),
    ("CR TC 20", [(b"MOA;BGA\r", b":?"), (b"TC1\r", b"20 Begin not valid with motor off\r\n:")]),
    (
        "CR BG",
        [(b"JGA=500;BGA;BGA\r", b"::?"), (b"TC1\r", b"21 Begin not valid while running\r\n:")],
    ),
    ("CR MO", [(b"JGA=500;BGA;MOA\r", b"::?"), (b"TC\r", b"7\r\n:")]),
    ("CR TC 13", [(b"PRA=50000;BGA;JGA=5\r", b"::?"), (b"TC\r", b"13\r\n:")]),
    (
        "CR FL",
        [
            (b"FLA=-1;JGA=500;BGA\r", b"::?"),
            (b"TC1\r", b"22 Begin not possible due to Limit Switch\r\n:"),
        ],
    ),
    # programs
    (
        "EP programDownload",
        [(b"DL\r#A\rMG 1\rEN\r\\", b"::"), (b"UL\r", b"#A\r\nMG 1\r\nEN\r\n\x1a:")],
    ),
    ("TMT", [(b"DL\r\n", b""), (b"#A\r\n", b""), (b"\\\r\n", b"::")]),
    ("TMT: a refused line", [(b"DL\r", b""), (b"x" * 81 + b"\r", b"?"), (b"TC\r", b"60\r\n:")]),
    (
        "CR JP: not from a terminal",
        [(b"JP #A\r", b"?"), (b"TC1\r", b"2 Command only valid from program\r\n:")],
    ),
    (
        "TMT: a busy thread",
        [
            (b"DL\r#A\rJP #A\r\\", b"::"),
            (b"XQ #A,1\r", b":"),
            (b"XQ #A,1\r", b"?"),
            (b"TC\r", b"19\r\n:"),
        ],
    ),
    ("CR DL", [(b"DL\r#A\rJP #A\r\\", b"::"), (b"XQ #A;DL\r", b":?"), (b"TC\r", b"17\r\n:")]),
]


@pytest.mark.parametrize(("source", "exchanges"), EXCHANGES)
def test_replies_match_the_source(source: str, exchanges: list[tuple[bytes, bytes]]) -> None:
    host = EmulatedHost()
    for sent, answer in exchanges:
        assert host(sent) == answer, (source, sent)


def test_the_sixth_character_of_the_model_is_the_number_of_axes() -> None:
    """EP: model[3:5] is the family, model[5] the number of axes; BL: "DMC4010 Rev 1.3c-SER"."""
    for axes in (2, 4):
        reply = EmulatedHost(axes)(b"\x12\x16\r")
        assert reply.startswith(f"DMC40{axes}0 Rev".encode())
        assert reply.endswith(b"\r\n:")


def test_a_line_is_cut_after_80_characters() -> None:
    """TMT: "The Galil DMC parser silently truncates lines >80 chars"."""
    host = EmulatedHost()
    fits = b"a=1;" * 19 + b"b=23"
    assert host(fits + b"456\r") == b":" * 20
    assert host.number("b") == 23.0


def test_a_stop_without_axes_also_ends_the_program() -> None:
    """CR ST: "program execution will stop in addition to motion"."""
    host = EmulatedHost()
    host(b"DL\r#A\rWT 2\rJP #A\r\\")
    host(b"XQ #A\r")
    assert host(b"ST A;MG _NO\r") == b": 1.0000\r\n:"
    assert host(b"ST;MG _NO\r") == b": 0.0000\r\n:"


def test_with_the_motor_off_the_error_grows_and_SH_holds_the_present_position() -> None:
    """CR SH: MOA, TEA -12435, TPA 12435, SHA, TEA 0, TPA 12435."""
    host = EmulatedHost()
    host(b"MOA\r")
    host.motors.counts[0] = 12435.0
    host.after(0.01)
    assert host(b"TEA;TPA\r") == b" -12435\r\n: 12435\r\n:"
    assert host(b"SHA;TEA;TPA\r") == b": 0\r\n: 12435\r\n:"


def test_a_message_of_a_program_has_its_high_bits_set_and_goes_to_the_host_of_CF() -> None:
    """CR CW and CF; EP: complete at the byte 0x8A."""
    host = EmulatedHost()
    host(b'DL\r#A\rMG "hot",7\rEN\r\\')
    host(b"CF I;CW 1;XQ #A\r")
    received = host.after(0.01)
    assert all(byte & 0x80 for byte in received)
    assert bytes(byte & 0x7F for byte in received) == b"hot 7.0000\r\n"


def test_an_error_ends_all_threads_of_a_program_without_an_error_handler() -> None:
    """CR #CMDERR."""
    for handler, threads in ((b"", 0.0), (b"#CMDERR\rerrs=errs+1\rEN1\r", 4.0)):
        host = EmulatedHost()
        host(b"errs=0\r")
        host(b"DL\r#BAD\rWT 4\rMG nothing\rEN\r#GOOD\rWT 2\rJP #GOOD\r" + handler + b"\\")
        host(b"XQ #BAD,1;XQ #GOOD,2\r")
        host.after(0.05)
        assert host.number("_NO") == threads
        assert host.number("errs") == (1.0 if handler else 0.0)
        assert host.number("_XQ1") == -1.0


def test_an_expression_is_evaluated_up_to_its_syntax_error() -> None:
    """The emulator therefore reports the first error from the left, each time."""
    host, unknown, syntax = EmulatedHost(), ErrorCode.VARIABLE_ERROR, ErrorCode.OPERAND_ERROR
    for _ in range(2):
        assert host(b"MG unknown+1)\rTC0\r") == f"?{unknown.value}\r\n:".encode()
        assert host(b"MG 1+1)\rTC0\r") == f"?{syntax.value}\r\n:".encode()
