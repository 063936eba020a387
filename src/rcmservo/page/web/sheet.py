"""The page as it is laid out: the picture, how the servo stands, and the buttons. What moves on it
is drawn in the browser, by static/page.js."""

import json
from pathlib import Path

from nicegui import app, ui

from rcmservo.page.web.doors import Doors

STATIC = Path(__file__).parent / "static"
BUTTONS = {
    "Enable": ("enable", "power_settings_new", "switch the drive on, paused, where the tool is"),
    "Pause": ("pause", "pause", "stand still, with the drive on"),
    "Resume": ("resume", "play_arrow", "go on to the target"),
    "Clear": ("clear", "restart_alt", "leave a stop or a fault, with the drive off"),
}
"""What each button sends, its icon, and what it does in words."""


def lay_out(title: str, doors: Doors, stop_port: int) -> None:
    """Have NiceGUI make the page."""
    app.add_static_files("/rcmservo", STATIC)
    told = json.dumps({"secret": doors.secret, "stopPort": stop_port})

    @ui.page("/")
    def page() -> None:  # pyright: ignore[reportUnusedFunction]
        ui.add_head_html('<link rel="stylesheet" href="/rcmservo/page.css">')
        ui.add_body_html(f"<script>window.RCMSERVO = {told};</script>")
        ui.add_body_html('<script src="/rcmservo/page.js" defer></script>')
        with ui.header().classes("items-center justify-between"):
            ui.label(title).classes("text-lg")
            with ui.row().classes("items-center"):
                ui.html('<span id="control" role="status"></span>', sanitize=False)
                _button("Take control", "ask", "how_to_reg", "move the arm from this browser")
                _button("Hand over", "give", "swap_horiz", "to the browser that asks")
        with ui.row().classes("w-full no-wrap rcm-main"):
            ui.html(
                '<canvas id="picture" role="img" aria-label="Camera picture"></canvas>',
                sanitize=False,
            ).classes("rcm-picture")
            with ui.column().classes("rcm-side"):
                _side()


def _side() -> None:
    words = (
        '<div id="state" role="status" aria-live="polite"><div id="phase"></div>'
        '<div id="why"></div><div id="way"></div><div id="errors"></div></div>'
    )
    ui.html(words, sanitize=False).classes("w-full")
    stop = '<button id="stop" type="button" aria-label="STOP">STOP</button>'
    ui.html(stop, sanitize=False).classes("w-full")
    ui.html('<div id="unheard" role="alert"></div>', sanitize=False)
    ui.label(
        "A software stop, also on the space bar: it switches the drive off. The emergency stop of "
        "the arm is another one, and comes first."
    ).classes("text-xs")
    with ui.row().classes("rcm-tight"):
        for name, (do, icon, words) in BUTTONS.items():
            _button(name, do, icon, words)
    with ui.card().tight().classes("w-full rcm-card"):
        ui.label("Poses: name the present one and teach it").classes("text-sm")
        with ui.row().classes("items-center rcm-tight"):
            ui.html(
                '<input id="name" aria-label="Name of the pose" maxlength="40" placeholder="name">',
                sanitize=False,
            )
            _button("Teach", "teach", "add_location", "keep what the camera sees now")
        ui.html('<div id="poses"></div>', sanitize=False)
    with ui.card().tight().classes("w-full rcm-card"):
        ui.label("Jog a joint: hold a button down, from a pause").classes("text-sm")
        with ui.row().classes("items-center rcm-tight"):
            for joint in range(3):
                _jog(joint)
    ui.html('<div id="notes" role="log" aria-label="Notes"></div>', sanitize=False)


def _jog(joint: int) -> None:
    """The buttons that move a joint either way."""
    ui.label(f"{joint + 1}:")
    for sign, way, shown in ((-1, "minus", "−"), (1, "plus", "+")):
        ui.html(
            f'<button type="button" class="jog" data-joint="{joint}" data-sign="{sign}" '
            f'aria-label="Jog joint {joint + 1} {way}">{shown}</button>',
            sanitize=False,
        )


def _button(name: str, do: str, icon: str, words: str) -> None:
    button = ui.button(name, icon=icon).props("dense")
    button.props(f'aria-label="{name}" data-do="{do}"')
    button.on("click", js_handler=f"() => window.rcm.want('{do}')")
    button.tooltip(words)
