"""Past runs: the list, and the one that is opened; both are filled by ../static/runs.js."""

from rcmservo.page.web.sheet.parts import plain
from rcmservo.page.web.site import Site


def runs_tab(site: Site) -> None:
    """Room for the list and for a run."""
    plain('<div id="runs"></div>', "w-full")
