"""The mechanism in space, to be turned with the mouse. static/scene.js draws it."""

import json

from nicegui import ui

from rcmservo.page.web.site import Site


def scene_tab(site: Site) -> None:
    """Room for it, and what the joints' limits enclose."""
    camera = ui.scene.perspective_camera(near=1.0, far=5000.0)
    scene = ui.scene(grid=False, camera=camera, background_color="#f4f4f4", fps=15, click_events=[])
    scene.classes("w-full").style("height: 26rem")
    scene.props('role="img" aria-label="The mechanism in space"')
    limits = site.shape.limits().round(1).tolist()
    told = f"window.RCMSERVO.scene = {json.dumps({'id': scene.id, 'limits': limits})}"
    ui.add_body_html(f"<script>{told};</script>")
    ui.label(
        "mm from the RCM, as the joints tell it: tool blue, target black, red, green and blue axes "
        "x, y, z of the arm's base; grey where marker 1 is at full insertion. Turn it with the "
        "mouse."
    ).classes("text-xs")
