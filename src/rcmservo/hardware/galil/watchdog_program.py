"""Watchdog program in the controller's memory: it stops the axes when its host falls silent.

The program is written in the controller's own language (source: Galil's command reference). Its
variables are ``hb`` (heartbeat: the count that the host last sent), ``seen`` (the
count at the last check), ``at`` (the time of the last new count), ``up`` (1 while the host updates
the speeds), ``va`` to ``vh`` (the speeds that the host sent for the axes) and ``why`` (the cause of
the stop). Every line from the host that commands motion ends by increasing ``hb``. The program
checks every 2 ms:

    ``hb`` has risen              the host is alive: restart the timeout
    the timeout has elapsed       the host is silent: stop (why = 1)
    ``hb`` has fallen             an earlier session sends commands: stop (why = 2)
    a speed differs from the one  another host jogs: stop (why = 3). The check pauses while ``up``
    sent with ``hb``              is 1, because the controller executes a line in several steps.
    an axis is at rest            a limit or another host has stopped it: stop the others (why = 4)

The program first waits for the motors, which the host switches on after the program has started.
Then the program itself begins the jog, so nothing holds or moves an axis without supervision. The
program contains no SH: the controller may execute the lines of a refused download as commands, and
it refuses BG while the motors are off.

To stop, the axes decelerate (DC) and the motors go off. Later commands of the host move nothing
until an operator has it start the program and enable the motors. An error in the program also
triggers the stop.
"""

THREAD_COUNT, WATCHDOG_THREAD = 8, 1
"""Threads of the controller, and the watchdog's thread. Thread 0 handles errors."""

CHECK_PERIOD_MS = 2

SAMPLES_PER_MS = 1.024
"""Increase of the controller's TIME per ms: a sample takes 976 us at TM 1000."""

FOREIGN_SPEED, AXIS_AT_REST = 3, 4
STOP_CAUSES = {
    1: "the controller received no command from the servo in time and stopped the arm",
    2: "an earlier session sent commands to the controller, which stopped the arm",
    FOREIGN_SPEED: "another host sent speeds to the controller, which stopped the arm",
    AXIS_AT_REST: "an axis came to rest by itself, and the controller stopped the others",
}
"""Causes of a stop, by the value of the program's variable ``why``."""


def program_lines(axes: str, timeout_ms: int) -> list[str]:
    """Return the program's lines for axes such as "ABC"."""
    a_speed_differs = "|".join(f"(@ABS[v{axis.lower()}]<>_JG{axis})" for axis in axes)
    an_axis_rests = "|".join(f"(_BG{axis}=0)" for axis in axes)
    motors_off = "+".join(f"_MO{axis}" for axis in axes)
    check_timeout = f"IF ((TIME-at>{round(timeout_ms * SAMPLES_PER_MS)})|(TIME<at));why=1;ENDIF"
    return [
        "#RCMWD",
        "seen=hb;at=TIME;why=0",
        "#RCMON",
        f"WT {CHECK_PERIOD_MS}",
        check_timeout,
        "IF (hb<seen);why=2;ENDIF",
        "JP #RCMSTOP,(why>0)",
        f"JP #RCMON,({motors_off}>0)",
        f"BG {axes}",
        "#RCMLOOK",
        f"WT {CHECK_PERIOD_MS}",
        "IF (hb>seen)",
        "seen=hb;at=TIME",
        "ENDIF",
        check_timeout,
        "IF (hb<seen);why=2;ENDIF",
        f"IF (({a_speed_differs})&(up=0));why={FOREIGN_SPEED};ENDIF",
        f"IF ({an_axis_rests});why={AXIS_AT_REST};ENDIF",
        "JP #RCMLOOK,(why=0)",
        "#RCMSTOP",
        f"ST {axes}",
        f"AM {axes}",
        f"MO {axes}",
        f"JP #RCMSTOP,({motors_off}<{len(axes)})",
        "EN",
        "#CMDERR",
        f"XQ #RCMSTOP,{WATCHDOG_THREAD}",
        "EN",
    ]
