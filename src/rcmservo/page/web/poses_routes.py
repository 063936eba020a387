"""The pictures of poses, and a pose that is deleted.

GET /pose?name=N   what was seen as the pose was taught
"""

from fastapi import Depends, FastAPI, HTTPException, Response

from rcmservo.page.poses import Poses
from rcmservo.page.web.doors import Doors


def add_poses(app: FastAPI, doors: Doors, poses: Poses) -> None:
    """Serve them to whoever knows the page's secret."""

    @app.get("/pose", dependencies=[Depends(doors.asked)])
    async def pose(name: str = "") -> Response:  # pyright: ignore[reportUnusedFunction]
        jpeg = poses.picture(name)
        if not jpeg:
            raise HTTPException(404)
        return Response(jpeg, media_type="image/jpeg", headers={"Cache-Control": "no-store"})
