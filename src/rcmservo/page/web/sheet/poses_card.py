"""Poses: name the present one, go to one."""

from nicegui import ui

from rcmservo.page.web.sheet.parts import button, plain


def poses_card() -> None:
    """The name to teach by, and the poses that there are."""
    with ui.card().tight().classes("w-full rcm-card"):
        ui.label("Poses: name the present one and teach it").classes("text-sm")
        with ui.row().classes("items-center rcm-tight"):
            plain(
                '<input id="name" aria-label="Name of the pose" maxlength="40" placeholder="name">'
            )
            button("Teach", "teach", "add_location", "keep what the camera sees now")
        plain('<div id="poses"></div>')
