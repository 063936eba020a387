"""Settings: a form for each box that may change, which static/settings.js fills."""

from rcmservo.page.web.sheet.parts import plain
from rcmservo.page.web.site import Site


def settings_tab(site: Site) -> None:
    """Where the forms go."""
    plain('<div id="settings"></div>', "w-full")
