"""The page as a whole: STOP in the header, the picture, tabs below it, and beside it what a person
does."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from nicegui import app, ui

from rcmservo.page.web.sheet.curves_tab import curves_tab
from rcmservo.page.web.sheet.jog_card import jog_card
from rcmservo.page.web.sheet.parts import button, plain
from rcmservo.page.web.sheet.poses_card import poses_card
from rcmservo.page.web.sheet.runs_tab import runs_tab
from rcmservo.page.web.sheet.scene_tab import scene_tab
from rcmservo.page.web.sheet.settings_tab import settings_tab
from rcmservo.page.web.sheet.status import notes, status, stop
from rcmservo.page.web.sheet.tour_card import tour_card
from rcmservo.page.web.sheet.trouble_tab import trouble_tab
from rcmservo.page.web.site import Site

STATIC = Path(__file__).parents[1] / "static"


class Tab(NamedTuple):
    """What can be looked at below the picture."""

    name: str
    """On it."""
    icon: str
    """Beside that."""
    fill: Callable[[Site], None]
    """Puts in what it shows."""


def tabs(site: Site) -> list[Tab]:
    """Those of a site."""
    simulated = [Tab("Simulated trouble", "bolt", trouble_tab)] if site.troubles else []
    return [
        Tab("Curves", "show_chart", curves_tab),
        Tab("3-D", "view_in_ar", scene_tab),
        Tab("Settings", "tune", settings_tab),
        Tab("Runs", "history", runs_tab),
        *simulated,
    ]


def lay_out(site: Site) -> None:
    """Have NiceGUI make the page."""
    app.add_static_files("/rcmservo", STATIC, max_cache_age=0)
    told = json.dumps(
        {"secret": site.doors.secret, "stopPort": site.stop_port, "troubles": site.troubles}
    )

    @ui.page("/")
    def page() -> None:  # pyright: ignore[reportUnusedFunction]
        for sheet in sorted(STATIC.glob("*.css")):
            ui.add_head_html(f'<link rel="stylesheet" href="/rcmservo/{sheet.name}">')
        ui.add_body_html(f"<script>window.RCMSERVO = {told};</script>")
        ui.add_body_html('<script type="module" src="/rcmservo/main.js"></script>')
        _header(site)
        with ui.row().classes("w-full no-wrap rcm-main"):
            with ui.column().classes("rcm-left"):
                plain('<canvas id="picture" role="img" aria-label="Camera picture"></canvas>')
                _tabs(site)
            with ui.column().classes("rcm-side"):
                status()
                poses_card()
                tour_card()
                jog_card()
                notes()


def _header(site: Site) -> None:
    with ui.header().classes("items-center justify-between rcm-header"):
        ui.label(site.title).classes("text-lg")
        with ui.row().classes("items-center"):
            plain('<span id="control" role="status"></span>')
            button("Take control", "ask", "how_to_reg", "move the arm from this browser")
            button("Hand over", "give", "swap_horiz", "to the browser that asks")
            stop()


def _tabs(site: Site) -> None:
    made = tabs(site)
    if not made:
        return
    with ui.tabs().props("dense align=left no-caps") as heads:
        for tab in made:
            ui.tab(tab.name, icon=tab.icon)
    with ui.tab_panels(heads, value=made[0].name, keep_alive=True).classes("w-full rcm-panels"):
        for tab in made:
            with ui.tab_panel(tab.name):
                tab.fill(site)
