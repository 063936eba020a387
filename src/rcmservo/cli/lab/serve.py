"""`rcmservo serve`: the operator's page in the browser, for a simulated lab or a real one.

serve ─┬─► page process     displays the state and reads the operator's requests
       ├─► stop process     receives STOP and passes it straight to this process
       ├─► lab processes    simulated arm and camera, if there are no real ones
       └─► servo process    one session after another
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

from rcmservo.cli.lab.page_backend import (
    RECORDED_IMAGES_PER_S,
    SESSION_DURATION_S,
    PageBackend,
    describe_enabling,
    open_recorder,
)
from rcmservo.cli.progress.compilation import report_compilation
from rcmservo.cli.run_options import LabOptions
from rcmservo.cli.terminal import open_console, open_status_line
from rcmservo.config.new_folder import open_new_folder
from rcmservo.constraints import between
from rcmservo.errors import RcmServoError, require_extra
from rcmservo.hardware.device_kinds import prepare_tracker
from rcmservo.hardware.lab_rig import LabRig
from rcmservo.interfaces import Tracker
from rcmservo.live.child_process import ChildProcess
from rcmservo.live.frame_ring import RingCamera
from rcmservo.live.servo_process import Session
from rcmservo.live.stop_signals import stopped_by_signals
from rcmservo.recording.reader import RECORD

if TYPE_CHECKING:
    from rcmservo.page.channels import PageChannels

PORT_ARGUMENT = between(0, 65534, "a whole number"), tyro.conf.arg(metavar="PORT")

DISTURBANCE_LOG = "trouble.jsonl"
"""File in the output folder that lists the requested disturbances and their times."""


@dataclass(frozen=True, kw_only=True)
class ServeOptions(LabOptions):
    """Serve the operator's page in the browser: observe, teach, go to a pose, stop.

    The arm and its camera are simulated unless the rig file has an arm. The command runs until
    Ctrl-C.

    Parameters
    ----------
    port : int or None
        Port of the page; STOP uses the next port. By default the first free pair from 8080 on;
        0 takes any free pair.
    browser : bool
        Open the page in this computer's browser.
    poses : Path
        Folder for the poses that are taught on the page, in the format that --target reads.
    host : str
        Address of this computer to listen on, 0.0.0.0 for all; any other than 127.0.0.1
        requires --token-file.
    token_file : Path or None
        File with the token that browsers must send; created if absent.
    """

    port: Annotated[int | None, *PORT_ARGUMENT] = None
    browser: bool = True
    poses: Path = Path("runs/poses")
    host: str = "127.0.0.1"
    token_file: Path | None = None


def serve(options: ServeOptions) -> int:
    """Serve the page until Ctrl-C and return the exit code 0."""
    with require_extra("serve", "page"):
        # imports NiceGUI before the kernels are compiled
        import_module("rcmservo.page.web.page_process")
        from rcmservo.page.web.token_file import load_required_token
    token = load_required_token(options.host, options.token_file)
    if options.has_devices():
        from rcmservo.cli.lab.page_rig import open_hardware

        rig = LabRig(options.rig, options.lab, options.digest)
        name, devices = "serve-hardware", open_hardware(options, rig)
    else:
        with require_extra("serve", "sim"):
            import_module("rcmservo.sim.processes.lab_processes")
        tracker = prepare_tracker(options.lab)
        name, devices = f"serve-seed{options.seed}", _open_simulated_lab(options, tracker)
    servo = options.servo
    with open_new_folder(options.out, name) as folder:
        with open_status_line(open_console()) as line, report_compilation(line):
            servo.warm_up()
        with contextlib.suppress(KeyboardInterrupt), devices as backend:
            _run_sessions(options, backend, folder, token)
    return 0


@contextlib.contextmanager
def _open_simulated_lab(
    options: ServeOptions, tracker: Callable[[], Tracker]
) -> Generator[PageBackend]:
    """Yield a simulated arm and its camera as the backend of the page."""
    from rcmservo.cli.run_description import describe_simulated_run
    from rcmservo.cli.simulated_run.target import describe_simulated_setup
    from rcmservo.page.selected_settings import SelectedSettings
    from rcmservo.sim import Rig
    from rcmservo.sim.processes.lab_processes import SimulatedLab
    from rcmservo.sim.processes.live_disturbances import (
        DisturbanceChange,
        list_live_disturbances,
        parse_live_disturbance,
    )
    from rcmservo.sim.processes.motion_log import TruePositionError

    page_settings, rig_file = SelectedSettings(options.servo), options.lab
    with SimulatedLab(options.seed, options.rig_settings) as processes:

        def make_session(channels: "PageChannels", folder: Path) -> Session:
            from rcmservo.page.enabling import await_enable
            from rcmservo.page.operator import PageOperator

            record, servo = folder / RECORD, page_settings.limited
            description = describe_simulated_run(options, SESSION_DURATION_S)
            return replace(
                processes.session(servo, tracker, SESSION_DURATION_S, record, description),
                recorder=partial(open_recorder, record, description),
                target=partial(await_enable, channels, servo, describe_enabling(servo)),
                operator=partial(PageOperator, channels, page_settings, options.teaching_frames),
                images_per_s=RECORDED_IMAGES_PER_S,
            )

        def start_disturbance(disturbance: str) -> str:
            started = parse_live_disturbance(disturbance) if disturbance else None
            processes.disturb(DisturbanceChange(time.monotonic_ns(), started))
            return f"disturbance: {started} begins" if disturbance else "disturbance: all end"

        rig = Rig(options.seed, processes.settings, pictures=False)
        yield PageBackend(
            title=f"simulated arm, seed {options.seed}",
            camera=partial(RingCamera, processes.ring),
            session=make_session,
            switch_off=processes.switch_off,
            setup=describe_simulated_setup(rig, rig_file),
            servo_settings=page_settings,
            start_disturbance=start_disturbance,
            disturbances=tuple(list_live_disturbances()),
            truth=TruePositionError(processes.settings, options.seed, processes.log),
        )


def _run_sessions(options: ServeOptions, backend: PageBackend, folder: Path, token: str) -> None:
    """Serve the page, and run one session after another."""
    from rcmservo.page.channels import PageChannels
    from rcmservo.page.sessions import SessionLoop

    channels, numbers = PageChannels(get_context("spawn")), itertools.count(1)

    def session() -> Session:
        return backend.session(channels, folder / f"session-{next(numbers)}")

    def apply_disturbances() -> None:
        for request in channels.disturbances.receive_all():
            apply_disturbance(
                request.disturbance, channels, backend.start_disturbance, folder / DISTURBANCE_LOG
            )

    serving = _start_page_processes(options, channels, backend, folder.parent, token)
    with serving as (address, names), stopped_by_signals():
        access = f", which requires the token in {options.token_file}" if token else ""
        announcement = f"rcmservo page at {address}, {backend.title}{access}; Ctrl-C ends it"
        open_console().print(announcement, soft_wrap=True)
        if options.browser:
            webbrowser.open(address)
        handlers = {channels.disturbances: apply_disturbances}
        SessionLoop(
            channels, session, backend.switch_off, names, backend.servo_settings.apply, handlers
        ).run()


@contextlib.contextmanager
def _start_page_processes(
    options: ServeOptions, channels: "PageChannels", backend: PageBackend, runs: Path, token: str
) -> Generator[tuple[str, dict[int, str]]]:
    """Start the page's processes.

    Parameters
    ----------
    options : ServeOptions
        Options of the command.
    channels : PageChannels
        Channels between the processes.
    backend : PageBackend
        Arm and camera.
    runs : Path
        Folder of the past runs that the page lists.
    token : str
        Token that browsers must send; empty if none.

    Yields
    ------
    tuple
        Address of the page, and the names of the processes by their sentinels.
    """
    from rcmservo.page.plots.mechanism_shape import MechanismShape
    from rcmservo.page.poses import PoseFolder
    from rcmservo.page.web.access import (
        PageCredentials,
        bind_pair,
        draw_secret,
        find_reachable_address,
    )
    from rcmservo.page.web.page_process import serve_page
    from rcmservo.page.web.site import Site
    from rcmservo.page.web.stop_process import serve_stop

    context = get_context("spawn")
    with contextlib.ExitStack() as stack:
        page_socket, stop_socket = bind_pair(options.host, options.port)
        port, stop_port = page_socket.getsockname()[1], stop_socket.getsockname()[1]
        doors = PageCredentials(port, draw_secret(), token)
        title, poses = f"rcmservo: {backend.title}", PoseFolder(options.poses, backend.setup)
        shape = MechanismShape.from_servo(backend.servo_settings.servo)
        given = backend.servo_settings, poses, shape, runs, backend.disturbances, backend.truth
        site = Site(title, backend.camera, doors, stop_port, *given)
        children: dict[str, ChildProcess] = {}
        for name, work, given in (
            ("the stop process", serve_stop, (channels.stop_requests, doors, stop_socket)),
            ("the page process", serve_page, (channels, site, page_socket)),
        ):
            children[name] = ChildProcess(context, work, *given)
            stack.callback(children[name].end)
        for child in children.values():  # all start at the same time
            child.receive()
        names = {child.process.sentinel: name for name, child in children.items()}
        yield f"http://{find_reachable_address(options.host)}:{port}", names


def apply_disturbance(
    disturbance: str, channels: "PageChannels", start_disturbance: Callable[[str], str], log: Path
) -> None:
    """Start a disturbance, report it to the page and log it.

    The log has the time in ns on the clock of the records.
    """
    from rcmservo.page.messages import Note

    try:
        event = start_disturbance(disturbance)
    except RcmServoError as error:
        channels.status.send(Note(str(error)))
        return
    channels.status.send(Note(event))
    try:
        with log.open("a") as file:
            file.write(json.dumps({"time": time.monotonic_ns(), "what": event}) + "\n")
    except OSError as error:
        channels.status.send(Note(f"{log.name} cannot be written: {error.strerror}"))
