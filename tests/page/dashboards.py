"""Dashboard that stores no poses on disk."""

from pathlib import Path
from typing import Any

from rcmservo.cli.simulated_run.target import setup_of
from rcmservo.config.rig_file import Lab
from rcmservo.page.channels import Desk
from rcmservo.page.poses import PoseFolder, PoseStore
from rcmservo.page.view_model import Dashboard
from rcmservo.sim import Rig


def make_dashboard(channels: Desk, **fields: Any) -> Dashboard:
    """Return the dashboard of a page with these channels."""
    setup = setup_of(Rig(1, pictures=False), Lab())
    return Dashboard(channels, PoseStore(PoseFolder(Path("/nowhere/at/all"), setup)), **fields)
