"""How the servo stands, in words and colour, and the buttons that lead on."""

from nicegui import ui

from rcmservo.page.web.sheet.parts import button, plain

BUTTONS = {
    "Enable": ("enable", "power_settings_new", "switch the drive on, paused, where the tool is"),
    "Pause": ("pause", "pause", "stand still, with the drive on"),
    "Resume": ("resume", "play_arrow", "go on to the target"),
    "Show again": ("show", "my_location", "take what the camera sees now as the target"),
    "Clear": ("clear", "restart_alt", "leave a stop or a fault, with the drive off"),
}
"""What each button sends, its icon, and what it does in words."""

ASKING = (
    '<form id="asking" hidden><label for="answer" id="question"></label> '
    '<input id="answer" type="text" maxlength="100" autocomplete="off"> '
    '<button type="submit" data-do="answer" aria-label="Answer">Answer</button></form>'
)
"""What the person is asked before the drive can go on; static/asking.js fills it."""


def status() -> None:
    """Phase, cause and way out, and the buttons."""
    plain(
        '<div id="state" role="status" aria-live="polite"><div id="phase"></div>'
        '<div id="why"></div><div id="way"></div><div id="errors"></div></div>',
        "w-full",
    )
    plain('<div id="standing"></div>')
    plain('<div id="unheard" role="alert"></div>')
    plain('<div id="intent"></div>', "w-full")
    plain(ASKING, "w-full")
    with ui.row().classes("rcm-tight"):
        for name, (do, icon, words) in BUTTONS.items():
            button(name, do, icon, words)


def stop() -> None:
    """STOP, which is always in sight."""
    plain(
        '<button id="stop" type="button" aria-label="STOP" '
        'title="A software stop, also on the space bar: it switches the drive off. The emergency '
        'stop of the arm is another one, and comes first.">STOP<small>software stop · space bar'
        "</small></button>"
    )


def notes() -> None:
    """What was said lately."""
    plain('<div id="notes" role="log" aria-label="Notes"></div>')
