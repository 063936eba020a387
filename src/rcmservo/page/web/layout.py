"""Layout of the page: STOP in the header, the picture, tabs below it, and cards on the right."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import app, ui

from rcmservo.page.control_ownership import MAX_NAME_CHARACTERS
from rcmservo.page.messages import MAX_ANSWER_CHARACTERS
from rcmservo.page.pose_sequence import MAX_DWELL_S, MAX_ROUNDS, MAX_WAYPOINTS
from rcmservo.page.web.site import Site

STATIC = Path(__file__).parent / "static"

ACTION_BUTTONS = {
    "Enable": ("enable", "power_settings_new", "switch the drive on, paused at the present pose"),
    "Pause": ("pause", "pause", "stand still, with the drive on"),
    "Resume": ("resume", "play_arrow", "continue to the target"),
    "Teach again": ("teach_again", "my_location", "teach the present observation as the target"),
    "Clear": ("clear", "restart_alt", "leave a stop or a fault, with the drive off"),
}
"""Action, icon and tooltip of each button."""


def _component(path: Path) -> type[ui.element]:
    """Return the NiceGUI element of a Vue component."""

    class Part(ui.element, component=path):
        def __init__(self, **props: Any) -> None:
            super().__init__()
            self._props.update(props)

    return Part


COMPONENTS = {path.stem: _component(path) for path in sorted(STATIC.glob("parts/*.js"))}
"""Elements of the components in ``static/parts``, by their names."""


def place_component(component: str, /, **props: Any) -> ui.element:
    """Place a component with its props on the page."""
    return COMPONENTS[component](**props)


def lay_out(site: Site) -> None:
    """Register the page of a site with NiceGUI."""
    app.add_static_files("/rcmservo", STATIC, max_cache_age=0)

    @ui.page("/")
    def page() -> None:  # pyright: ignore[reportUnusedFunction]
        ui.add_head_html('<link rel="stylesheet" href="/rcmservo/page.css">')
        _set_global("RCMSERVO", {"secret": site.access.secret, "stopPort": site.stop_port})
        ui.add_body_html('<script type="module" src="/rcmservo/main.js"></script>')
        with ui.header().classes("items-center justify-between rcm-header"):
            ui.label(site.title).classes("text-lg")
            place_component("control_bar")
        with ui.row().classes("w-full no-wrap rcm-main"):
            with ui.column().classes("rcm-left"):
                canvas = ui.element("canvas")
                canvas.props('id=picture role=img aria-label="Camera picture"')
                _tabs(site)
            with ui.column().classes("rcm-side"):
                _cards()


def _set_global(name: str, value: object) -> None:
    """Set a global variable of the page's JavaScript modules."""
    ui.add_body_html(f"<script>window.{name} = {json.dumps(value)};</script>")


def _cards() -> None:
    place_component("status_card", maxLength=MAX_ANSWER_CHARACTERS)
    with ui.row().classes("rcm-tight"):
        for name, (action, icon, tooltip) in ACTION_BUTTONS.items():
            place_component("action_button", name=name, action=action, icon=icon, tooltip=tooltip)
    with _card():
        ui.label("Poses: name and teach the present pose").classes("text-sm")
        place_component("poses_card", maxLength=MAX_NAME_CHARACTERS)
    with _card():
        place_component(
            "sequence_card",
            maxWaypoints=MAX_WAYPOINTS,
            maxDwell=MAX_DWELL_S,
            maxRounds=MAX_ROUNDS,
        )
    with _card():
        place_component("jog_card")
    place_component("notes")


def _card() -> ui.card:
    return ui.card().tight().classes("w-full rcm-card")


def _tabs(site: Site) -> None:
    """Create the tabs below the picture; each gets its content when it is opened first."""
    with ui.tabs().props("dense align=left no-caps") as heads:
        curves = ui.tab("Curves", icon="show_chart")
        space = ui.tab("3-D", icon="view_in_ar")
        settings = ui.tab("Settings", icon="tune")
        runs = ui.tab("Runs", icon="history")
        disturbances = ui.tab("Simulated disturbances", icon="bolt") if site.disturbances else None
    with ui.tab_panels(heads, value=curves, keep_alive=True).classes("w-full rcm-panels"):
        with ui.tab_panel(curves):
            _curves()
        with ui.tab_panel(space):
            _mechanism(site)
        with ui.tab_panel(settings):
            place_component("settings_tab")
        with ui.tab_panel(runs):
            place_component("runs_tab")
        if disturbances is not None:
            with ui.tab_panel(disturbances):
                ui.label(
                    "Disturb the simulated arm or camera. The state on the right shows the effect."
                )
                place_component("disturbances_tab", kinds=site.disturbances)


def _curves() -> None:
    """Create the chart that static/curves.js draws on."""
    chart = ui.echart({"series": []}).classes("w-full rcm-curves").style("height: 46rem")
    chart.props('role="img" aria-label="Curves of the last 30 seconds"')
    _set_global("RCMSERVO.curves", chart.id)


def _mechanism(site: Site) -> None:
    """Create the scene that static/scene.js draws in; the mouse rotates it."""
    camera = ui.scene.perspective_camera(near=1.0, far=5000.0)
    scene = ui.scene(grid=False, camera=camera, background_color="#f4f4f4", fps=15, click_events=[])
    scene.classes("w-full").style("height: 26rem")
    scene.props('role="img" aria-label="The mechanism in space"')
    surface = site.shape.limits()
    extent = float(np.linalg.norm(surface, axis=-1).max())
    direction = 1.0 if surface[..., 2].mean() > 0.0 else -1.0  # side on which the tool is
    scene.move_camera(
        1.1 * extent,
        -1.3 * extent,
        (0.4 + 0.6 * direction) * extent,
        0.0,
        0.0,
        0.4 * direction * extent,
        duration=0.0,
    )
    _set_global("RCMSERVO.scene", {"id": scene.id, "limits": surface.round(1).tolist()})
    ui.label(
        "Positions in mm from the RCM, from the measured joints: tool blue, target black; axes x, "
        "y, z of the arm's base red, green, blue; surface of marker 1 at full insertion grey. "
        "Rotate the scene with the mouse."
    ).classes("text-xs")
