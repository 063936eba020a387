"""Layout of the page: STOP in the header, the picture, tabs below it, and cards on the right.

A new widget needs a file in ``static/widgets`` and a call of `place_component` here.
"""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import app, ui

from rcmservo.page.control_ownership import MAX_NAME_CHARACTERS
from rcmservo.page.messages import MAX_ANSWER_CHARACTERS
from rcmservo.page.pose_sequence import MAX_DWELL_S, MAX_ROUNDS, MAX_WAYPOINTS
from rcmservo.page.web.site import Site

STATIC = Path(__file__).parent / "static"

SCRIPTS = "stop.js", "drawings/picture.js", "drawings/curves.js", "drawings/mechanism_scene.js"
"""JavaScript modules that the page loads; NiceGUI loads the widgets."""

ACTION_BUTTONS = {
    "Enable": ("enable", "power_settings_new", "switch the drive on, paused at the present pose"),
    "Pause": ("pause", "pause", "stand still, with the drive on"),
    "Resume": ("resume", "play_arrow", "continue to the target"),
    "Teach again": ("teach_again", "my_location", "teach the present observation as the target"),
    "Clear": ("clear", "restart_alt", "leave a stop or a fault, with the drive off"),
}
"""Action, icon and tooltip of each button."""


def _create_element_class(path: Path) -> type[ui.element]:
    """Return the class of NiceGUI elements that display a Vue component."""

    class Widget(ui.element, component=path):
        def __init__(self, **props: Any) -> None:
            super().__init__()
            self._props.update(props)

    return Widget


COMPONENTS = {path.stem: _create_element_class(path) for path in STATIC.glob("widgets/*.js")}
"""Element classes of the components in ``static/widgets``, by the names of their files."""


def place_component(component: str, /, **props: Any) -> ui.element:
    """Place a component with its props at the present place of the layout."""
    return COMPONENTS[component](**props)


def lay_out(site: Site) -> None:
    """Register the page of a site with NiceGUI."""
    app.add_static_files("/rcmservo", STATIC, max_cache_age=0)

    @ui.page("/")
    def page() -> None:  # pyright: ignore[reportUnusedFunction]
        ui.add_head_html('<link rel="stylesheet" href="/rcmservo/page.css">')
        _set_global("RCMSERVO", {"secret": site.access.secret, "stopPort": site.stop_port})
        for script in SCRIPTS:
            ui.add_body_html(f'<script type="module" src="/rcmservo/{script}"></script>')
        with ui.header().classes("items-center justify-between rcm-header"):
            ui.label(site.title).classes("text-lg")
            place_component("control_bar")
        with ui.row().classes("w-full no-wrap rcm-main"):
            with ui.column().classes("rcm-left"):
                canvas = ui.element("canvas")
                canvas.props('id=picture role=img aria-label="Camera picture"')
                _place_tabs(site)
            with ui.column().classes("rcm-side"):
                _place_cards()


def _set_global(name: str, value: object) -> None:
    """Set a global variable of the page's JavaScript modules."""
    ui.add_body_html(f"<script>window.{name} = {json.dumps(value)};</script>")


def _place_cards() -> None:
    place_component("status_card", maxLength=MAX_ANSWER_CHARACTERS)
    with ui.row().classes("rcm-tight"):
        for name, (action, icon, tooltip) in ACTION_BUTTONS.items():
            place_component("action_button", name=name, action=action, icon=icon, tooltip=tooltip)
    limits = {"maxWaypoints": MAX_WAYPOINTS, "maxDwell": MAX_DWELL_S, "maxRounds": MAX_ROUNDS}
    cards = {
        "poses_card": {"maxLength": MAX_NAME_CHARACTERS},
        "sequence_card": limits,
        "jog_card": {},
    }
    for component, props in cards.items():
        with ui.card().tight().classes("w-full rcm-card"):
            place_component(component, **props)
    place_component("notes")


def _place_tabs(site: Site) -> None:
    """Place the tabs below the picture. A browser builds a tab's content when the tab is opened."""
    tabs: dict[str, tuple[str, Callable[[], object]]] = {
        "Curves": ("show_chart", _place_curves_chart),
        "3-D": ("view_in_ar", partial(_place_mechanism_scene, site)),
        "Settings": ("tune", partial(place_component, "settings_tab")),
        "Runs": ("history", partial(place_component, "runs_tab")),
    }
    if site.disturbances:
        place_menu = partial(place_component, "disturbances_tab", kinds=site.disturbances)
        tabs["Simulated disturbances"] = "bolt", place_menu
    with ui.tabs().props("dense align=left no-caps") as heads:
        for title, (icon, _) in tabs.items():
            ui.tab(title, icon=icon)
    with ui.tab_panels(heads, value="Curves", keep_alive=True).classes("w-full rcm-panels"):
        for title, (_, place_content) in tabs.items():
            with ui.tab_panel(title):
                place_content()


def _place_curves_chart() -> None:
    """Place the chart that ``static/drawings/curves.js`` draws on."""
    chart = ui.echart({"series": []}).classes("w-full rcm-curves").style("height: 46rem")
    chart.props('role="img" aria-label="Curves of the last 30 seconds"')
    _set_global("RCMSERVO.curves", chart.id)


def _place_mechanism_scene(site: Site) -> None:
    """Place the scene that ``static/drawings/mechanism_scene.js`` draws in."""
    camera = ui.scene.perspective_camera(near=1.0, far=5000.0)
    scene = ui.scene(grid=False, camera=camera, background_color="#f4f4f4", fps=15, click_events=[])
    scene.classes("w-full").style("height: 26rem")
    scene.props('role="img" aria-label="The mechanism in space"')
    surface = site.shape.compute_workspace_surface()
    extent = float(np.linalg.norm(surface, axis=-1).max())  # largest distance (mm) from the RCM
    direction = 1.0 if surface[..., 2].mean() > 0.0 else -1.0  # side on which the tool is
    x, y, z = 1.1 * extent, -1.3 * extent, (0.4 + 0.6 * direction) * extent
    scene.move_camera(x, y, z, 0.0, 0.0, 0.4 * direction * extent, duration=0.0)
    _set_global("RCMSERVO.scene", {"id": scene.id, "limits": surface.round(1).tolist()})
    ui.label(
        "Positions in mm from the RCM, from the measured joints: tool blue, target black; axes x, "
        "y, z of the arm's base red, green, blue; surface of marker 1 at full insertion grey. "
        "Rotate the scene with the mouse."
    ).classes("text-xs")
