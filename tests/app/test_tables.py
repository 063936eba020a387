"""What the tables of results must not leave out."""

from typing import Any

from rich.console import Console

from rcmservo.app.tables import show_live

FALLEN: dict[str, Any] = {
    "settled": False,
    "cause": "the servo process was killed (SIGKILL)",
    "pose_error_mm": 3.0,
    "folder": "runs/a",
}


def printed(**more: Any) -> str:
    console = Console(width=200)
    with console.capture() as got:
        show_live(console, FALLEN | more)
    return got.get()


def test_a_live_run_tells_what_could_not_be_recorded() -> None:
    assert (
        "not recorded" in (text := printed(not_recorded="No space left on device"))
        and "No space left" in text
    )
    assert "not recorded" not in printed(not_recorded="") + printed()
