"""The mechanism in space, to be turned with the mouse. static/scene.js draws it."""

import json

import numpy as np
from nicegui import ui

from rcmservo.page.web.site import Site


def scene_tab(site: Site) -> None:
    """Room for it, and what the joints' limits enclose."""
    camera = ui.scene.perspective_camera(near=1.0, far=5000.0)
    scene = ui.scene(grid=False, camera=camera, background_color="#f4f4f4", fps=15, click_events=[])
    scene.classes("w-full").style("height: 26rem")
    scene.props('role="img" aria-label="The mechanism in space"')
    surface = site.shape.limits()
    far = float(np.linalg.norm(surface, axis=-1).max())
    way = 1.0 if surface[..., 2].mean() > 0.0 else -1.0  # to where the tool goes
    scene.move_camera(
        1.1 * far, -1.3 * far, (0.4 + 0.6 * way) * far, 0.0, 0.0, 0.4 * way * far, duration=0.0
    )
    limits = surface.round(1).tolist()
    told = f"window.RCMSERVO.scene = {json.dumps({'id': scene.id, 'limits': limits})}"
    ui.add_body_html(f"<script>{told};</script>")
    ui.label(
        "mm from the RCM, as the joints tell it: tool blue, target black, red, green and blue axes "
        "x, y, z of the arm's base; grey where marker 1 is at full insertion. Turn it with the "
        "mouse."
    ).classes("text-xs")
