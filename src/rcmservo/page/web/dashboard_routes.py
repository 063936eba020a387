"""Routes of the page's data, for requests with the secret.

/curves?after=N   samples of the curves after the sample with index N
/pose?name=N      picture at the teaching of a pose, JPEG
/settings         form of each part of the servo, with selected and active settings
"""

from typing import Any

from fastapi import APIRouter, Depends, HTTPException, Response

from rcmservo.page.json_text import encode_json
from rcmservo.page.plots.curves import SAMPLE_FIELDS
from rcmservo.page.settings import SelectedSettings
from rcmservo.page.view_model import Dashboard
from rcmservo.page.web.access import PageCredentials
from rcmservo.page.web.setting_fields import build_forms


def dashboard_routes(
    access: PageCredentials, board: Dashboard, selection: SelectedSettings
) -> APIRouter:
    """Return the routes that read the dashboard and the selected servo."""
    router = APIRouter(dependencies=[Depends(access.require_secret)])

    async def get_curves(after: int = 0) -> Response:
        samples = board.curves.after(after)
        content = encode_json(
            {"count": board.curves.count, "names": SAMPLE_FIELDS, "samples": samples}
        )
        return Response(content, media_type="application/json")

    async def get_pose_picture(name: str = "") -> Response:
        jpeg = board.poses.picture(name)
        if not jpeg:
            raise HTTPException(404)
        return Response(jpeg, media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    async def get_settings() -> list[dict[str, Any]]:
        return build_forms(selection.servo, board.active_servo)

    for path, answer in (
        ("/curves", get_curves),
        ("/pose", get_pose_picture),
        ("/settings", get_settings),
    ):
        router.add_api_route(path, answer, response_model=None)
    return router
