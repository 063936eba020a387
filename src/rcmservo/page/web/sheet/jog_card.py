"""Jog: buttons that are held down, for each joint and for each direction of marker 1."""

from nicegui import ui

from rcmservo.page.web.sheet.parts import plain


def jog_card() -> None:
    """How fast, and the buttons either way."""
    with ui.card().tight().classes("w-full rcm-card"):
        with ui.row().classes("items-center rcm-tight"):
            ui.label("Jog: hold a button down, from a pause").classes("text-sm")
            plain(
                '<select id="jog-share" aria-label="Jog speed"><option value="0.25">slow</option>'
                '<option value="0.5">half</option><option value="1">full</option></select>'
            )
        _row("Joint", "rates", [(number, f"joint {number}") for number in "123"])
        _row("Marker 1", "velocity", [(axis, f"marker 1 along {axis}") for axis in "xyz"])


def _row(what: str, of: str, ways: list[tuple[str, str]]) -> None:
    with ui.row().classes("items-center rcm-tight"):
        ui.label(what)
        for place, (shown, called) in enumerate(ways):
            ui.label(f"{shown}:")
            for sign, way, drawn in ((-1, "minus", "−"), (1, "plus", "+")):
                plain(
                    f'<button type="button" class="jog" data-of="{of}" data-place="{place}" '
                    f'data-sign="{sign}" aria-label="Jog {called} {way}" '
                    f'title="Jog {called} {way}">{drawn}</button>'
                )
