"""HTTP routes of the page's data, for requests with the page's secret.

/curves?after=N   samples of the curves after the sample with index N
/pose?name=N      picture at the teaching of a pose, JPEG
/settings         form of each part of the servo, with selected and active settings
"""

from typing import Any

from fastapi import APIRouter, Depends, HTTPException, Response

from rcmservo.page.plots.curves import SAMPLE_FIELDS
from rcmservo.page.selected_settings import SelectedSettings
from rcmservo.page.view_model import Dashboard, encode_json
from rcmservo.page.web.access import PageCredentials
from rcmservo.page.web.setting_fields import build_forms


def create_dashboard_routes(
    access: PageCredentials, board: Dashboard, selection: SelectedSettings
) -> APIRouter:
    """Return the routes that read the dashboard and the selected servo."""
    router = APIRouter(dependencies=[Depends(access.require_secret)])

    async def get_curves(after: int = 0) -> Response:
        samples = board.curves.after(after)
        table = {"count": board.curves.count, "names": SAMPLE_FIELDS, "samples": samples}
        return Response(encode_json(table), media_type="application/json")

    async def get_pose_picture(name: str = "") -> Response:
        jpeg = board.poses.read_picture(name)
        if not jpeg:
            raise HTTPException(404)
        return Response(jpeg, media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    async def get_settings() -> list[dict[str, Any]]:
        return build_forms(selection.servo, board.active_servo)

    router.add_api_route("/curves", get_curves, response_model=None)
    router.add_api_route("/pose", get_pose_picture, response_model=None)
    router.add_api_route("/settings", get_settings, response_model=None)
    return router
