"""Recorder of a run: an MCAP file of ROS 2 messages, under CRTK's topic names where CRTK has them.

    rcmservo/about        std_msgs/String             settings, seed and versions, as JSON
    rcmservo/stage        std_msgs/String             servo and target of a new stage, as JSON
    rcmservo/memory       rcmservo_msgs/Memory        state of a user-defined estimator
    rcmservo/tick         rcmservo_msgs/Tick          observation, estimate and decision of a tick
    rcmservo/truth        rcmservo_msgs/Truth         simulation only: hidden from the servo
    measured_js           sensor_msgs/JointState      measured joints (rad and m, SI)
    servo_jv              sensor_msgs/JointState      commanded joint rates (SI)
    operating_state       crtk_msgs/OperatingState    at each change: phase, cause, recovery
    image_raw/compressed  sensor_msgs/CompressedImage frames, if requested

Log times are ns since the start of the record; stamps are times on the plant's clock. Chunks are
small, so that a killed process loses little. A recorder that can no longer write does not stop the
run: it reports the failure, and the file stays readable.
"""

import json
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue
from types import TracebackType
from typing import Any, Protocol

import numpy as np

from rcmservo.errors import RcmServoError, UnusableFile
from rcmservo.interfaces import Floats, Frame, Target
from rcmservo.loop.tick import Tick
from rcmservo.recording import estimator_memory
from rcmservo.recording import ros2_messages as ros2
from rcmservo.recording.mcap_recovery import MAX_RECORD_BYTES
from rcmservo.recording.ros2_bag import write_metadata
from rcmservo.recording.stage import NO_ORIGIN, UNRECORDED_ORIGIN, stage_text
from rcmservo.servo.servo import Servo, State
from rcmservo.tracking import encode_image

CHUNK_BYTES = 8 * 1024
"""Size from which on a chunk is written: seven ticks."""

MAX_QUEUED_MESSAGES = 1000
MAX_QUEUED_FRAMES = 60
"""Largest numbers of messages, and of frames among them, that wait for the disk during a run."""


class RawFile(Protocol):
    """Unbuffered file."""

    def write(self, data: memoryview, /) -> int | None: ...

    def close(self) -> None: ...


def create_file(path: Path) -> RawFile:
    """Open a new file; raise ``FileExistsError`` if it exists."""
    return path.open("xb", buffering=0)


class _UnbufferedStream:
    """Stream of the MCAP writer that passes all bytes to the system at once."""

    def __init__(self, file: RawFile) -> None:
        self._file, self._position = file, 0

    def write(self, data: bytes) -> None:
        remaining = memoryview(data)
        while remaining:
            count = self._file.write(remaining)
            if not count:
                raise OSError(None, "nothing more can be written")
            self._position += count
            remaining = remaining[count:]

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        """Do nothing: there is no buffer."""


class Recorder:
    """Recorder of a run into a new file, as a context manager that closes the file.

    ``failed`` holds the reason if the record can no longer be written, else an empty string. After
    a failure all calls do nothing.

    Parameters
    ----------
    path : Path
        New file.
    about : dict
        Settings, seed and versions of the run, for JSON.
    open_file : callable, optional
        Function that opens the file.

    Raises
    ------
    UnusableFile
        If the file exists or cannot be created.
    """

    def __init__(
        self, path: Path, about: dict[str, Any], open_file: Callable[[Path], RawFile] = create_file
    ) -> None:
        self.path, self.failed = path, ""
        text = json.dumps(about)
        try:
            self._file = open_file(path)
        except OSError as error:
            raise UnusableFile(path, f"cannot be written: {error.strerror}") from error
        from mcap.writer import Writer

        # the parameter is annotated as a file object; the writer needs only the methods above
        self._writer = Writer(_UnbufferedStream(self._file), chunk_size=CHUNK_BYTES)  # pyright: ignore[reportArgumentType]
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._counts: Counter[str] = Counter()
        self._servo: Servo | None = None
        self._ends: list[State | None] = []
        self._last: Tick | None = None
        self._time, self._now, self._shift = 0, 0, 0
        self._closed = False
        self._attempt(self._start, text)

    def _start(self, about: str) -> None:
        self._writer.start(profile="ros2")
        self._send("rcmservo/about", ros2.encode_text(about))
        self._writer.flush()

    def recorded(self) -> bool:
        """Report whether everything so far has been written."""
        return not self.failed

    def begin(self, servo: Servo, target: Target, state: State | None = None) -> None:
        """Begin a run.

        Parameters
        ----------
        servo : Servo
            Servo of the run.
        target : Target
            Target of the run.
        state : State, optional
            State that the run continues from.
        """
        warm_up(servo)
        self._attempt(self._begin, servo, target, state)

    def _begin(self, servo: Servo, target: Target, state: State | None) -> None:
        if self._servo is not None:
            self._ends.append(None if self._last is None else self._last.state)
        self._servo, self._last = servo, None
        self._joints = servo.mechanism.joint_names
        origin = NO_ORIGIN if state is None else self._origin(state)
        self._send_stage(stage_text(servo, target, origin, mid_run=False))

    def _begin_changed_stage(self, previous: Tick, target: Target, tick: Tick) -> None:
        """Begin a stage during a run: from this tick on servo or target differ."""
        self._ends.append(previous.state)
        self._send_stage(stage_text(tick.servo, target, len(self._ends) - 1, mid_run=True))

    def _send_stage(self, text: str) -> None:
        self._send("rcmservo/stage", ros2.encode_text(text))
        self._writer.flush()

    def _origin(self, state: State) -> int:
        return next((i for i, end in enumerate(self._ends) if end is state), UNRECORDED_ORIGIN)

    def write(self, tick: Tick) -> None:
        """Add a tick.

        A tick with another servo or target than the previous one begins a new stage. If the times
        of a stage restart, the times of the record continue.
        """
        self._attempt(self._write, tick)

    def _write(self, tick: Tick) -> None:
        if self._servo is None:
            raise RcmServoError("the record has no stage: call begin before write")
        observation, state = tick.observation, tick.state
        if tick.time + self._shift < self._time:
            self._shift = self._time + max(observation.now - self._now, 0) - tick.time
        previous, target = self._last, state.target
        self._time, self._now, self._last = tick.time + self._shift, observation.now, tick
        if previous is not None and target is not None and _has_changed(previous, tick):
            self._begin_changed_stage(previous, target, tick)
        if previous is None or previous.state.mode.text != state.mode.text:
            self._send("operating_state", ros2.encode_operating_state(observation.now, state.mode))
        numbers = estimator_memory.recorded_memory(tick)
        if numbers is not None:
            self._send(estimator_memory.TOPIC, ros2.encode_memory(observation.now, numbers))
        self._send("rcmservo/tick", ros2.encode_tick(tick))
        positions = ros2.encode_positions(self._joints, observation.q_time, observation.q)
        self._send("measured_js", positions)
        command = state.command
        self._send("servo_jv", ros2.encode_rates(self._joints, command.time, command.rates))

    def write_truth(self, p1: Floats, p2: Floats, jacobian_error: float) -> None:
        """Add the ground truth of the last tick.

        `p1` and `p2` are the markers (3,) in mm; `jacobian_error` is the scaled relative error of
        Ĵ.
        """
        self._attempt(self._write_truth, p1, p2, jacobian_error)

    def _write_truth(self, p1: Floats, p2: Floats, jacobian_error: float) -> None:
        self._send("rcmservo/truth", ros2.encode_truth(self._now, p1, p2, jacobian_error))

    def write_frame(self, frame: Frame) -> None:
        """Add the image of a frame as a JPEG file; its stamp is the exposure."""
        self._attempt(self._write_frame, frame)

    def _write_frame(self, frame: Frame) -> None:
        if frame.image is None:
            return
        data = ros2.encode_picture(frame.exposure, encode_image(frame.image))
        if len(data) > MAX_RECORD_BYTES // 2:
            raise RcmServoError("a frame is too large for a record")
        self._send("image_raw/compressed", data)

    def _send(self, topic: str, data: bytes) -> None:
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(
                topic, "cdr", self._schema(ros2.TOPICS[topic])
            )
        number = self._counts[topic]
        self._writer.add_message(self._channels[topic], self._time, data, self._time, number)
        self._counts[topic] = number + 1

    def _schema(self, name: str) -> int:
        if name not in self._schemas:
            definition = ros2.DEFINITIONS[name].encode()
            self._schemas[name] = self._writer.register_schema(name, "ros2msg", definition)
        return self._schemas[name]

    def _attempt(self, action: Callable[..., None], *arguments: Any) -> None:
        """Run an action unless the record has failed; store a failure as the reason."""
        if self.failed:
            return
        try:
            action(*arguments)
        except OSError as error:
            self.failed = f"{self.path}: cannot be written: {error.strerror}"
        except RcmServoError as error:
            self.give_up(str(error))

    def give_up(self, reason: str) -> None:
        """Write the buffered messages and mark the record as failed."""
        self._attempt(self._writer.flush)
        self.failed = self.failed or reason

    def close(self) -> None:
        """Close the file and make its folder a ROS 2 bag. Further calls do nothing."""
        if self._closed:
            return
        self._closed = True
        self._attempt(self._writer.finish)
        try:
            self._file.close()
        except OSError as error:
            self.failed = self.failed or f"{self.path}: cannot be written: {error.strerror}"
        self._attempt(write_metadata, self.path, self._counts, self._time)

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _has_changed(previous: Tick, tick: Tick) -> bool:
    """Report whether servo or target changed between two ticks of a run."""
    return tick.servo is not previous.servo or tick.state.target is not previous.state.target


def warm_up(servo: Servo) -> None:
    """Compile the functions that write a tick."""
    ros2.codec().warm_up()
    servo.guarded_estimator.predict(servo.guarded_estimator.init(), servo.tool, np.zeros(3))


class ThreadedRecorder:
    """Recorder that writes in its own thread, so that the loop never waits for the disk.

    The record fails if the disk falls too far behind or cannot be written.

    Parameters
    ----------
    recorder : Recorder
        Recorder that the thread uses.
    """

    def __init__(self, recorder: Recorder) -> None:
        self.failed = recorder.failed
        self._recorder = recorder
        self._queue: SimpleQueue[tuple[Callable[..., None], tuple[Any, ...]] | None] = SimpleQueue()
        self._frames_queued, self._frames_written = 0, 0
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def recorded(self) -> bool:
        """Report whether everything so far has been written or is queued."""
        return not self.failed

    def begin(self, servo: Servo, target: Target, state: State | None = None) -> None:
        """Begin a run; see `Recorder.begin`."""
        warm_up(servo)
        self._enqueue(self._recorder.begin, servo, target, state)

    def write(self, tick: Tick) -> None:
        """Add a tick; see `Recorder.write`."""
        self._enqueue(self._recorder.write, tick)

    def write_truth(self, p1: Floats, p2: Floats, jacobian_error: float) -> None:
        """Add the ground truth of the last tick."""
        self._enqueue(self._recorder.write_truth, p1, p2, jacobian_error)

    def write_frame(self, frame: Frame) -> None:
        """Add the image of a frame, which must not change afterwards."""
        if self._frames_queued - self._frames_written >= MAX_QUEUED_FRAMES:
            self._report_overflow()
        elif not self.failed:
            self._frames_queued += 1
            self._enqueue(self._write_frame, frame)

    def _write_frame(self, frame: Frame) -> None:
        self._recorder.write_frame(frame)
        self._frames_written += 1

    def _enqueue(self, action: Callable[..., None], *arguments: Any) -> None:
        if self.failed:
            return
        if self._queue.qsize() >= MAX_QUEUED_MESSAGES:
            self._report_overflow()
        else:
            self._queue.put((action, arguments))

    def _report_overflow(self) -> None:
        self.failed = self.failed or f"{self._recorder.path}: the disk is too slow for the record"

    def _run(self) -> None:
        while (job := self._queue.get()) is not None:
            action, arguments = job
            try:
                action(*arguments)
            except Exception as error:  # the run continues, and the operator sees the failure
                self._recorder.give_up(f"{self._recorder.path}: {error!r}")
            self.failed = self.failed or self._recorder.failed

    def close(self) -> None:
        """Write all queued messages and close the file."""
        self._queue.put(None)
        self._thread.join()
        if self.failed:
            self._recorder.give_up(self.failed)
        self._recorder.close()
        self.failed = self.failed or self._recorder.failed

    def __enter__(self) -> "ThreadedRecorder":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
