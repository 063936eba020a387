"""What a student may have go wrong with a simulated laboratory."""

from nicegui import ui

from rcmservo.page.web.sheet.parts import plain
from rcmservo.page.web.site import Site


def trouble_tab(_: Site) -> None:
    """A menu, what the kind needs, and the buttons that begin and end it."""
    ui.label("Something goes wrong with the simulated arm or camera. The state beside tells it.")
    plain(
        '<div id="trouble"><label>What <select id="trouble-kind" aria-label="Kind of trouble">'
        '</select></label><span id="trouble-parameters"></span>'
        '<button type="button" id="trouble-begin" aria-label="Begin trouble">Begin</button>'
        '<button type="button" id="trouble-end" aria-label="End all trouble">End all</button>'
        '<p id="trouble-does"></p></div>'
    )
