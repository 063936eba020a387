"""The pictures of poses, and a pose that is deleted.

GET /pose?name=N   what was seen as the pose was taught
"""

import secrets

from fastapi import FastAPI, HTTPException, Response

from rcmservo.page.poses import Poses
from rcmservo.page.web.site import Site

FORBIDDEN, MISSING = 403, 404


def add_poses(app: FastAPI, site: Site, poses: Poses) -> None:
    """Serve them to whoever knows the page's secret."""

    @app.get("/pose")
    async def pose(name: str = "", secret: str = "") -> Response:  # pyright: ignore[reportUnusedFunction]
        if not secrets.compare_digest(secret.encode(), site.doors.secret.encode()):
            raise HTTPException(FORBIDDEN)
        jpeg = poses.picture(name)
        if not jpeg:
            raise HTTPException(MISSING)
        return Response(jpeg, media_type="image/jpeg", headers={"Cache-Control": "no-store"})
