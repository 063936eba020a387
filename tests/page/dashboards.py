"""Dashboard that stores no poses on disk."""

from pathlib import Path
from typing import Any

from rcmservo.cli.simulated_run.target import describe_simulated_setup
from rcmservo.config.rig_file import RigDescription
from rcmservo.page.channels import PageChannels
from rcmservo.page.poses import PoseFolder, PoseStore
from rcmservo.page.view_model import Dashboard
from rcmservo.sim import Rig


def make_dashboard(channels: PageChannels, **fields: Any) -> Dashboard:
    """Return the dashboard of a page with these channels."""
    setup = describe_simulated_setup(Rig(1, pictures=False), RigDescription())
    return Dashboard(channels, PoseStore(PoseFolder(Path("/nowhere/at/all"), setup)), **fields)
