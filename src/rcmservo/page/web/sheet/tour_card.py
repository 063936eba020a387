"""A tour: the poses to visit in turn, for how long each, and how often."""

from nicegui import ui

from rcmservo.page.tour import LONGEST, ROUNDS
from rcmservo.page.web.sheet.parts import plain


def tour_card() -> None:
    """A list that static/tour.js fills, its buttons, and how far the tour is."""
    with ui.card().tight().classes("w-full rcm-card"):
        plain(
            '<details id="tour"><summary>Tour: visit poses in turn</summary>'
            '<ol id="tour-stops" aria-label="Poses of the tour"></ol><div class="tour-row">'
            '<select id="tour-pose" aria-label="Pose to visit"></select>'
            f'<label>for <input id="tour-dwell" type="number" min="0" max="{LONGEST:g}" step="any" '
            'value="5" aria-label="Dwell in seconds"> s</label>'
            '<button type="button" data-tour="add">Add</button></div><div class="tour-row">'
            f'<label>rounds <input id="tour-rounds" type="number" min="1" max="{ROUNDS}" step="1" '
            'value="1" aria-label="Rounds"></label>'
            '<button type="button" data-tour="start" aria-label="Start the tour">Start</button>'
            '<button type="button" data-tour="end" aria-label="End the tour">End</button></div>'
            "</details>",
            "w-full",
        )
        plain('<div id="tour-progress"></div>')
