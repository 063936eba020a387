"""`rcmservo serve`: the operator's page in the browser, before a simulated arm and its camera, or a
laboratory's.

serve ─┬─► page process     what the person sees and wants
       ├─► stop process     STOP, straight back to here
       ├─► bench            the simulated arm and its camera, where there are no others
       └─► servo process    one session after the other
"""

import contextlib
import itertools
import json
import time
import webbrowser
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from rcmservo.cli.folders import new_folder
from rcmservo.cli.lab.live_on_hardware import require_devices
from rcmservo.cli.lab.page_backend import (
    RECORDED_IMAGES_PER_S,
    SESSION_DURATION_S,
    Behind,
    enable_announcement,
    open_recorder,
)
from rcmservo.cli.lab_options import LabOptions
from rcmservo.cli.progress.preparing import compiling
from rcmservo.cli.terminal import console, status_line
from rcmservo.constraints import between
from rcmservo.errors import RcmServoError, needing
from rcmservo.live.child_process import ChildProcess
from rcmservo.live.frame_ring import RingCamera
from rcmservo.live.servo_process import Session
from rcmservo.live.stop_signals import stopped_by_signals
from rcmservo.recording.reader import RECORD

if TYPE_CHECKING:
    from rcmservo.page.channels import Desk

PORT_ARGUMENT = between(0, 65534, "a whole number"), tyro.conf.arg(metavar="PORT")

DISTURBANCE_LOG = "trouble.jsonl"
"""In the folder of the records: what went wrong on request, and when."""


@dataclass(frozen=True, kw_only=True)
class ServeOptions(LabOptions):
    """The operator's page in the browser: see, teach, go, stop. The arm and its camera are
    simulated, unless the rig file names an arm. It serves until Ctrl-C.

    Parameters
    ----------
    port : int or None
        Port of the page, and the next one of STOP: by default the first free pair from 8080 on. 0
        takes any pair.
    browser : bool
        Open the page in the browser that this computer has.
    poses : Path
        Folder with the poses that are taught on the page, in the files that --target takes.
    host : str
        Address of this computer to listen on, 0.0.0.0 for all; others than 127.0.0.1 need
        --token-file.
    token_file : Path or None
        File with the token that browsers must give; made if absent.
    """

    port: Annotated[int | None, *PORT_ARGUMENT] = None
    browser: bool = True
    poses: Path = Path("runs/poses")
    host: str = "127.0.0.1"
    token_file: Path | None = None


def serve(options: ServeOptions) -> int:
    """Serve until Ctrl-C; the exit code is 0."""
    with needing("serve", "page"):
        import_module("rcmservo.page.web.page_process")  # imports NiceGUI before anything compiles
        from rcmservo.page.web.token_file import token_for
    token = token_for(options.host, options.token_file)
    if options.has_devices():
        require_devices(options.lab, options.rig, options.digest)
        from rcmservo.cli.lab.page_rig import open_hardware

        name, devices = "serve-hardware", open_hardware(options)
    else:
        with needing("serve", "sim"):
            import_module("rcmservo.sim.processes.lab_processes")
        name, devices = f"serve-seed{options.seed}", _simulated_lab(options)
    servo = options.servo
    with new_folder(options.out, name) as folder:
        with status_line(console(False)) as line, compiling(line):
            servo.warm_up()
        with contextlib.suppress(KeyboardInterrupt), devices as behind:
            _run_sessions(options, behind, folder, token)
    return 0


@contextlib.contextmanager
def _simulated_lab(options: ServeOptions) -> Generator[Behind]:
    """The simulated arm and its camera."""
    from rcmservo.cli.simulated_run.about import about
    from rcmservo.cli.simulated_run.target import setup_of
    from rcmservo.page.settings import Chosen
    from rcmservo.sim.processes.lab_processes import SimulatedLab
    from rcmservo.sim.processes.live_disturbances import DisturbanceChange, list_live_disturbances
    from rcmservo.sim.processes.live_disturbances import parse_live_disturbance as trouble_of
    from rcmservo.sim.processes.motion_log import TruePositionError
    from rcmservo.sim.rig import Rig

    chosen, lab = Chosen(options.servo), options.lab
    with SimulatedLab(options.seed, options.rig_settings) as bench:

        def session(desk: "Desk", folder: Path) -> Session:
            from rcmservo.page.enabling import await_enable
            from rcmservo.page.operator import PageOperator

            record, limited = folder / RECORD, chosen.limited
            words = about(options, SESSION_DURATION_S)
            return replace(
                bench.session(limited, lab.markers, SESSION_DURATION_S, record, words),
                recorder=partial(open_recorder, record, words),
                target=partial(await_enable, desk, limited, enable_announcement(limited)),
                operator=partial(PageOperator, desk, chosen, options.teaching_frames),
                pictures=RECORDED_IMAGES_PER_S,
            )

        def befall(what: str) -> str:
            trouble = DisturbanceChange(time.monotonic_ns(), trouble_of(what) if what else None)
            bench.disturb(trouble)
            return f"trouble: {trouble.starts} begins" if what else "trouble: all that acted ends"

        title = f"simulated arm, seed {options.seed}"
        setup = setup_of(Rig(options.seed, bench.settings, pictures=False), lab)
        camera, troubles = partial(RingCamera, bench.ring), tuple(list_live_disturbances())
        truth = TruePositionError(bench.settings, bench.log)
        yield Behind(
            title, camera, session, bench.switch_off, setup, chosen, befall, troubles, truth
        )


def _run_sessions(options: ServeOptions, behind: Behind, folder: Path, token: str) -> None:
    """Have the page served, and run sessions beside it."""
    from rcmservo.page.channels import Desk
    from rcmservo.page.sessions import Sessions

    desk, numbers = Desk(get_context("spawn")), itertools.count(1)

    def session() -> Session:
        return behind.session(desk, folder / f"session-{next(numbers)}")

    def troubled() -> None:
        for one in desk.trouble.heard():
            apply_disturbance(one.what, desk, behind.befall, folder / DISTURBANCE_LOG)

    serving = _page_processes(options, desk, behind, folder.parent, token)
    with serving as (address, needed), stopped_by_signals():
        asks = f", which asks for the token in {options.token_file}" if token else ""
        words = f"rcmservo page at {address}, {behind.title}{asks}; Ctrl-C ends it"
        console(False).print(words, soft_wrap=True)
        if options.browser:
            webbrowser.open(address)
        beside = {desk.trouble: troubled}
        Sessions(desk, session, behind.off, needed, behind.chosen.take, beside).keep()


@contextlib.contextmanager
def _page_processes(
    options: ServeOptions, desk: "Desk", behind: Behind, runs: Path, token: str
) -> Generator[tuple[str, dict[int, str]]]:
    """The page's processes: where the page is, and what each is by its sentinel. ``runs`` is the
    folder of the past runs that it shows.
    """
    from rcmservo.page.plots.mechanism_shape import Shape
    from rcmservo.page.poses import PoseFolder
    from rcmservo.page.web.access import Doors, bound_pair, drawn_secret, reached_at
    from rcmservo.page.web.page_process import serve_page
    from rcmservo.page.web.site import Site
    from rcmservo.page.web.stop_process import serve_stop

    context = get_context("spawn")
    with contextlib.ExitStack() as stack:
        here, stop = bound_pair(options.host, options.port)
        port, stop_port = here.getsockname()[1], stop.getsockname()[1]
        doors = Doors(port, drawn_secret(), token)
        title, poses = f"rcmservo: {behind.title}", PoseFolder(options.poses, behind.setup)
        shape = Shape.of(behind.chosen.servo)
        given = behind.chosen, poses, shape, runs, behind.troubles, behind.truth
        site = Site(title, behind.camera, doors, stop_port, *given)
        needed: dict[int, str] = {}
        for name, work, given in (
            ("the process that hears STOP", serve_stop, (desk.bell, doors, stop)),
            ("the page's process", serve_page, (desk, site, here)),
        ):
            child = ChildProcess(context, work, *given)
            stack.callback(child.end)
            child.receive()
            needed[child.process.sentinel] = name
        yield f"http://{reached_at(options.host)}:{port}", needed


def apply_disturbance(what: str, desk: "Desk", befall: Callable[[str], str], log: Path) -> None:
    """Let something go wrong; tell the person, and write it down with the time (ns) on the records'
    clock.
    """
    from rcmservo.page.messages import Note

    try:
        words = befall(what)
    except RcmServoError as error:
        desk.said.put(Note(str(error)))
        return
    desk.said.put(Note(words))
    try:
        with log.open("a") as file:
            file.write(json.dumps({"time": time.monotonic_ns(), "what": words}) + "\n")
    except OSError as error:
        desk.said.put(Note(f"{log.name} cannot be written: {error.strerror}"))
