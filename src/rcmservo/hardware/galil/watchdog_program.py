"""The program that stops the axes when its host falls silent, in the controller's own memory.

A host's every line that moves ends by counting `hb` up. The program looks each 2 ms:

    hb has risen               the host lives, for its patience more
    that has passed without    it is silent: stop (why 1)
    hb has fallen              a host from before speaks: stop (why 2)
    a speed is not the one     somebody else jogs: stop (why 3); not looked at while `up` is 1,
    that came with it          as a line is not executed all at once
    an axis has come to rest   a limit or somebody has stopped it: stop the others (why 4)

Before that it waits for the motors, which the host switches on once the program runs, and begins
the jog: nothing holds or moves that it does not watch over. It does not switch them on itself: of a
download that is refused the lines are taken for commands, and BG is refused while they are off.

Stopping is by the axes' own deceleration (DC), then the motors go off; what a host sends then moves
nothing, until a person has it start the program and enable them. An error in the program begins its
stop too.
"""

THREADS, THREAD = 8, 1
"""So many the controller has, and in this it runs; thread 0 is where errors are looked after."""

PERIOD = 2
"""ms between its looks."""

SAMPLES = 1.024
"""Of the controller's TIME in a ms: TM 1000 is 976 us."""

FOREIGN, RESTING = 3, 4
WHYS = {
    1: "the controller heard nothing from the servo and stopped the arm",
    2: "an earlier session spoke to the controller, which stopped the arm",
    FOREIGN: "somebody else sent speeds to the controller, which stopped the arm",
    RESTING: "an axis came to rest by itself, and the controller stopped the others",
}
"""What the variable `why` says."""


def lines(axes: str, patience: int) -> list[str]:
    """The program for axes such as "ABC", that waits so many ms."""
    wrong = "|".join(f"(@ABS[v{axis.lower()}]<>_JG{axis})" for axis in axes)
    resting = "|".join(f"(_BG{axis}=0)" for axis in axes)
    off = "+".join(f"_MO{axis}" for axis in axes)
    silent = f"IF ((TIME-at>{round(patience * SAMPLES)})|(TIME<at));why=1;ENDIF"
    return [
        "#RCMWD",
        "seen=hb;at=TIME;why=0",
        "#RCMON",
        f"WT {PERIOD}",
        silent,
        "IF (hb<seen);why=2;ENDIF",
        "JP #RCMSTOP,(why>0)",
        f"JP #RCMON,({off}>0)",
        f"BG {axes}",
        "#RCMLOOK",
        f"WT {PERIOD}",
        "IF (hb>seen)",
        "seen=hb;at=TIME",
        "ENDIF",
        silent,
        "IF (hb<seen);why=2;ENDIF",
        f"IF (({wrong})&(up=0));why={FOREIGN};ENDIF",
        f"IF ({resting});why=4;ENDIF",
        "JP #RCMLOOK,(why=0)",
        "#RCMSTOP",
        f"ST {axes}",
        f"AM {axes}",
        f"MO {axes}",
        f"JP #RCMSTOP,({off}<{len(axes)})",
        "EN",
        "#CMDERR",
        f"XQ #RCMSTOP,{THREAD}",
        "EN",
    ]
