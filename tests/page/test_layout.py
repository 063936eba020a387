"""Construction of the page: NiceGUI's layout and Vue components with templates, nothing else."""

import re
from types import SimpleNamespace
from typing import Any

from fastapi import FastAPI
from nicegui import ui
from starlette.testclient import TestClient

from conftest import ROOT, make_laboratory
from rcmservo.page.plots.mechanism_shape import MechanismShape
from rcmservo.page.web.access import PageCredentials
from rcmservo.page.web.layout import lay_out
from rcmservo.sim.processes.live_disturbances import list_live_disturbances

PAGE = ROOT / "src/rcmservo/page"
STATIC = PAGE / "web/static"
BY_HAND = re.compile(r"createElement|innerHTML|insertAdjacent|replaceChildren|new Option")
LOADS = re.compile(r"</?script\b[^>]*>|<link\b[^>]*>")
"""Tags that load the modules and the style sheet of the page."""


def test_python_has_no_html_and_javascript_creates_no_elements() -> None:
    html = re.compile(r"</?[a-z]+[ >]|ui\.html")
    python = [
        path.name for path in PAGE.rglob("*.py") if html.search(LOADS.sub("", path.read_text()))
    ]
    browser = [path.name for path in STATIC.rglob("*.js") if BY_HAND.search(path.read_text())]
    assert python == browser == []


def test_programs_that_drive_the_page_use_names_that_it_has() -> None:
    """A browser waits for ever for a condition with a misspelt name of the page's object `rcm`."""
    scripts = "".join(path.read_text() for path in STATIC.glob("*.js"))
    known = {*re.findall(r"\brcm\.(\w+)", scripts), *re.findall(r"(\w+): ", scripts)}
    programs = [*(ROOT / "benchmarks").glob("*.py"), *(ROOT / "docs").glob("*.py")]
    programs += [ROOT / "tests/page/test_page.py", ROOT / "tests/live/test_page_rig.py"]
    texts = {path.name: path.read_text() for path in programs}
    used = {
        (name, attribute)
        for name, text in texts.items()
        if "rcm.board" in text
        for attribute in re.findall(r"\brcm\.(\w+)", text)
    }
    assert len(used) > 5
    assert {(name, attribute) for name, attribute in used if attribute not in known} == set()


def test_each_component_is_placed_on_the_page_and_served() -> None:
    shape = MechanismShape.from_servo(make_laboratory().servo())
    site: Any = SimpleNamespace(
        title="a page",
        access=PageCredentials(1, "s"),
        stop_port=2,
        shape=shape,
        disturbances=list_live_disturbances(),
    )
    app = FastAPI()
    lay_out(site)
    ui.run_with(app)
    client: Any = TestClient(app)
    with client as browser:
        html: str = browser.get("/").text
        placed = re.findall(r'import {.*} from "(.*/(\w+)\.js)";', html)
        urls = {name: url for url, name in placed}
        parts = {path.stem: path.read_text() for path in STATIC.glob("widgets/*.js")}
        assert set(parts) <= set(urls)
        assert all(browser.get(urls[name]).text == text for name, text in parts.items())
