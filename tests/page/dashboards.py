"""A board that keeps its poses nowhere."""

from pathlib import Path
from typing import Any

from rcmservo.cli.simulated_run.target import setup_of
from rcmservo.config.rig_file import Lab
from rcmservo.page.channels import Desk
from rcmservo.page.poses import PoseFolder, PoseStore
from rcmservo.page.view_model import Dashboard
from rcmservo.sim import Rig


def make_dashboard(channels: Desk, **fields: Any) -> Dashboard:
    """What a desk's page shows."""
    setup = setup_of(Rig(1, pictures=False), Lab())
    return Dashboard(channels, PoseStore(PoseFolder(Path("/nowhere/at/all"), setup)), **fields)
