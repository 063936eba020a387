"""Past runs in the browser: list, content, pictures, figures and downloads, and nothing else."""

import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI
from starlette.testclient import TestClient

import rcmservo as rs
from conftest import ROOT
from rcmservo.live.servo_process import FrameSampler
from rcmservo.page.web.access import PageCredentials
from rcmservo.page.web.runs_routes import create_runs_routes
from rcmservo.recording import reader
from rcmservo.recording.writer import Recorder
from rcmservo.tracking import ColourMarkers

OLD = ROOT / "tests/data/v0.1.0/record.mcap"
SECRET_QUERY = {"secret": "s"}
HOUR = 3600


class Browser:
    """Browser that knows the secret."""

    def __init__(self, root: Path) -> None:
        app = FastAPI()
        app.include_router(create_runs_routes(PageCredentials(1, "s"), root))
        self.client: Any = TestClient(app)

    def get(self, path: str) -> Any:
        return self.client.get(path, params=SECRET_QUERY)

    def list_runs(self) -> dict[str, dict[str, Any]]:
        return {run["folder"]: run for run in self.get("/runs").json()}

    def name(self, folder: str) -> str:
        return self.list_runs()[folder]["name"]


def record_with_pictures(path: Path) -> int:
    """Record a short run with 20 pictures a second, without its end; return their number."""
    path.parent.mkdir(parents=True)
    rig = rs.sim.Rig(1, replace(rs.sim.Rig(1, pictures=False).settings, width=160, height=120))
    plant = rs.Plant(rig.arm, rig.camera, ColourMarkers(), rig.clock)
    servo = rs.Servo(mechanism=rs.SphericalRcm(), tool=rs.RigidTool(spacing=30.0))
    target = rs.Target(reader.read_record(OLD).stages[0].target.points / 4.0, plant.read().q)
    recorder, film, count = Recorder(path, {"simulation": True, "seed": 1}), FrameSampler(20.0), 0
    recorder.begin(servo, target)
    for tick in rs.servo_ticks(plant, servo, target, duration=0.5):
        recorder.write(tick)
        picture = film.sample(tick, plant.frame)
        if picture is not None:
            recorder.write_frame(picture)
            count += 1
    recorder.give_up("the process was killed")
    return count


@pytest.fixture
def root(tmp_path: Path) -> Path:
    for folder in ("old", "serve/session-1", "cut"):
        (tmp_path / "runs" / folder).mkdir(parents=True)
        shutil.copy(OLD, tmp_path / "runs" / folder)
    cut = tmp_path / "runs/cut/record.mcap"
    cut.write_bytes(cut.read_bytes()[:-40_000])
    foreign = tmp_path / "runs/foreign/record.mcap"
    foreign.parent.mkdir()
    foreign.write_text("not a record")
    outside = tmp_path / "outside"
    outside.mkdir()
    shutil.copy(OLD, outside)
    (tmp_path / "runs/link").symlink_to(outside)
    for age, path in enumerate((cut, foreign, tmp_path / "runs/old/record.mcap")):
        then = path.stat().st_mtime - HOUR * (age + 1)
        os.utime(path, (then, then))
    return tmp_path / "runs"


def test_runs_are_listed_newest_first_and_damage_is_reported(root: Path) -> None:
    browser = Browser(root)
    runs = browser.list_runs()
    assert list(runs) == ["serve/session-1", "cut", "foreign", "old"]
    assert runs["old"]["seconds"] == 2.99 and "seed 3" in runs["old"]["description"]
    assert runs["old"]["ending"] == "acquiring"
    assert 0.0 < runs["cut"]["seconds"] < 2.99 and "without its end" in runs["cut"]["ending"]
    assert runs["foreign"]["seconds"] is None and "not a record" in runs["foreign"]["description"]
    os.utime(root / "cut/record.mcap")
    assert browser.list_runs()["cut"]["is_recording"]
    assert not any(run["is_recording"] for run in runs.values())


def test_a_run_opens_with_its_time_line(root: Path) -> None:
    browser = Browser(root)
    for folder in ("old", "cut"):
        content = browser.get(f"/runs/{browser.name(folder)}").json()
        assert ("damaged or cut off" in content["missing"]) == (folder == "cut")
        assert [one["t"] for one in content["moments"]][:3] == [0.0, 0.1, 0.2]
        assert content["spans"][0][2] == "waiting for the markers"
    path = f"/runs/{browser.name('old')}"
    assert browser.get(f"{path}/figures/..%2Frecord.mcap").status_code == 404
    assert browser.get(f"{path}/record.mcap").content == OLD.read_bytes()
    refused = browser.get(f"/runs/{browser.name('foreign')}")
    assert refused.status_code == 422 and str(root) not in refused.text


@pytest.mark.slow
def test_the_figures_of_a_run_are_served_as_svg_and_png(root: Path) -> None:
    browser = Browser(root)
    path = f"/runs/{browser.name('old')}"
    for name in browser.get(path).json()["figures"]:
        svg, png = (browser.get(f"{path}/figures/{name}.{kind}") for kind in ("svg", "png"))
        assert svg.text.startswith("<?xml") and "<path" in svg.text and "<image" not in svg.text
        assert png.content.startswith(b"\x89PNG")
        assert svg.headers["content-disposition"] == f'inline; filename="runs-old-{name}.svg"'


def test_a_killed_run_has_all_its_pictures(tmp_path: Path) -> None:
    path = tmp_path / "killed/record.mcap"
    count = record_with_pictures(path)
    recorded = [jpeg for _, jpeg in reader.iterate_jpegs(path)]
    assert len(recorded) == count == 10
    browser = Browser(tmp_path)
    name = browser.name("killed")
    moments = browser.get(f"/runs/{name}").json()["moments"]
    numbers = [one["picture"] for one in moments]
    assert numbers == list(range(count))
    for k in numbers:
        answer = browser.get(f"/runs/{name}/pictures/{k}")
        assert answer.content == recorded[k] and answer.headers["content-type"] == "image/jpeg"
    for k in (-1, count):
        assert browser.get(f"/runs/{name}/pictures/{k}").status_code == 404


@pytest.mark.parametrize(
    "name",
    ["..", "../outside", "%2e%2e%2foutside", "old", "old%2Frecord.mcap", "%2Fetc%2Fpasswd", "link"],
)
def test_only_names_of_the_list_are_served(root: Path, name: str) -> None:
    browser = Browser(root)
    assert browser.list_runs()
    for path in (f"/runs/{name}", f"/runs/{name}/record.mcap", f"/runs/{name}/pictures/0"):
        assert browser.get(path).status_code == 404


def test_a_request_without_the_secret_is_refused(root: Path) -> None:
    browser = Browser(root)
    name = browser.name("old")
    for path in (
        "",
        f"/{name}",
        f"/{name}/record.mcap",
        f"/{name}/pictures/0",
        f"/{name}/figures/a",
    ):
        for secret in ({}, {"secret": ""}, {"secret": "t"}):
            assert browser.client.get(f"/runs{path}", params=secret).status_code == 403
