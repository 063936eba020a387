"""Jog: buttons that are held down."""

from nicegui import ui

from rcmservo.page.web.sheet.parts import plain


def jog_card() -> None:
    """A button either way for each joint."""
    with ui.card().tight().classes("w-full rcm-card"):
        ui.label("Jog a joint: hold a button down, from a pause").classes("text-sm")
        with ui.row().classes("items-center rcm-tight"):
            for joint in range(3):
                _joint(joint)


def _joint(joint: int) -> None:
    """The buttons that move a joint either way."""
    ui.label(f"{joint + 1}:")
    for sign, way, shown in ((-1, "minus", "−"), (1, "plus", "+")):
        plain(
            f'<button type="button" class="jog" data-joint="{joint}" data-sign="{sign}" '
            f'aria-label="Jog joint {joint + 1} {way}">{shown}</button>'
        )
