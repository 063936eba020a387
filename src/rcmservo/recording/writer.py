"""Recorder of a run: an MCAP file of ROS 2 messages.

The topics of arm and state have the names of CRTK, the common interface of surgical robots.

    rcmservo/about        std_msgs/String             settings, seed and versions, as JSON
    rcmservo/stage        std_msgs/String             servo and target of a new stage, as JSON
    rcmservo/memory       rcmservo_msgs/Memory        state of a user-defined estimator
    rcmservo/tick         rcmservo_msgs/Tick          observation, estimate and decision of a tick
    rcmservo/truth        rcmservo_msgs/Truth         simulation only: values hidden from the servo
    measured_js           sensor_msgs/JointState      measured joints (rad and m, SI)
    servo_jv              sensor_msgs/JointState      commanded joint rates (SI)
    operating_state       crtk_msgs/OperatingState    at each change: phase, cause, remedy
    image_raw/compressed  sensor_msgs/CompressedImage frames, if requested

Log times are ns since the start of the record; stamps are times on the plant's clock. Messages are
written in small groups (chunks), so that a killed process loses little. A recorder that can no
longer write does not stop the run: it reports the failure, and the file stays readable.
"""

import json
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Protocol, Self

import numpy as np

from rcmservo.errors import RcmServoError, UnusableFile
from rcmservo.interfaces import Floats, Frame, Target
from rcmservo.loop.tick import Tick
from rcmservo.recording import ros2_messages as ros2
from rcmservo.recording.mcap_recovery import MAX_RECORD_BYTES
from rcmservo.recording.ros2_bag import write_metadata
from rcmservo.recording.stage import NO_ORIGIN, UNRECORDED_ORIGIN, format_stage
from rcmservo.servo.servo import Servo, State
from rcmservo.tracking import encode_image

CHUNK_BYTES = 8 * 1024
"""Size in bytes from which on a chunk is written: about seven ticks."""

MAX_QUEUED_MESSAGES = 1000
"""Largest number of messages that wait for the disk during a run."""

MAX_QUEUED_FRAMES = 60
"""Largest number of frames among these messages."""


class RawFile(Protocol):
    """Unbuffered file."""

    def write(self, data: memoryview, /) -> int | None: ...

    def close(self) -> None: ...


def create_file(path: Path) -> RawFile:
    """Open a new file; raise ``FileExistsError`` if it exists."""
    return path.open("xb", buffering=0)


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
        about_text = json.dumps(about, default=str)  # a date in the section of an own device
        try:
            self._file = open_file(path)
        except OSError as error:
            raise UnusableFile(path, f"cannot be written: {error.strerror}") from error
        from mcap.writer import Writer

        # the parameter is annotated as a file object, but the writer needs only three methods of it
        self._writer = Writer(_UnbufferedStream(self._file), chunk_size=CHUNK_BYTES)  # pyright: ignore[reportArgumentType]
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._message_counts: Counter[str] = Counter()
        self._servo: Servo | None = None
        self._end_states: list[State | None] = []
        self._last_tick: Tick | None = None
        self._log_time_ns, self._log_offset_ns, self._observed_ns = 0, 0, 0
        self._is_closed = False
        self._attempt(self._start, about_text)

    def _start(self, about_text: str) -> None:
        self._writer.start(profile="ros2")
        self._send("rcmservo/about", ros2.encode_text(about_text))
        self._writer.flush()

    def recorded(self) -> bool:
        """Return True if everything so far has been written."""
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
            self._end_states.append(None if self._last_tick is None else self._last_tick.state)
        self._servo, self._last_tick = servo, None
        self._joint_names = servo.mechanism.joint_names
        origin = NO_ORIGIN if state is None else self._find_origin(state)
        self._send_stage(format_stage(servo, target, origin, mid_run=False))

    def _find_origin(self, state: State) -> int:
        """Return the number of the stage that ended with a state."""
        numbers = (i for i, end_state in enumerate(self._end_states) if end_state is state)
        return next(numbers, UNRECORDED_ORIGIN)

    def _send_stage(self, stage_json: str) -> None:
        self._send("rcmservo/stage", ros2.encode_text(stage_json))
        self._writer.flush()

    def write(self, tick: Tick) -> None:
        """Add a tick.

        A tick with another servo or target than the previous one begins a new stage. If the times
        of a stage restart, the times of the record continue.
        """
        self._attempt(self._write, tick)

    def _write(self, tick: Tick) -> None:
        if self._servo is None:
            raise RcmServoError("the record has no stage: call begin before write")
        observation, state, previous = tick.observation, tick.state, self._last_tick
        if tick.time + self._log_offset_ns < self._log_time_ns:
            since_last_ns = max(observation.now - self._observed_ns, 0)
            self._log_offset_ns = self._log_time_ns + since_last_ns - tick.time
        self._log_time_ns = tick.time + self._log_offset_ns
        self._observed_ns, self._last_tick = observation.now, tick
        if previous is not None and state.target is not None and _has_changed(previous, tick):
            self._end_states.append(previous.state)
            origin = len(self._end_states) - 1
            self._send_stage(format_stage(tick.servo, state.target, origin, mid_run=True))
        if previous is None or previous.state.mode.text != state.mode.text:
            self._send("operating_state", ros2.encode_operating_state(observation.now, state.mode))
        memory = tick.servo.guarded_estimator.recorded_numbers(state.estimation.memory)
        if memory is not None:
            self._send("rcmservo/memory", ros2.encode_memory(observation.now, memory))
        self._send("rcmservo/tick", ros2.encode_tick(tick))
        names, command = self._joint_names, state.command
        positions = ros2.encode_positions(names, observation.q_time, observation.q)
        self._send("measured_js", positions)
        self._send("servo_jv", ros2.encode_rates(names, command.time, command.rates))

    def write_truth(self, p1: Floats, p2: Floats, jacobian_error: float) -> None:
        """Add the simulation's ground truth for the last tick.

        Parameters
        ----------
        p1, p2 : Floats
            Positions (3,) of the markers in mm.
        jacobian_error : float
            Relative error ‖Ĵ − J‖/‖J‖ of the scaled Jacobian.
        """
        self._attempt(self._write_truth, p1, p2, jacobian_error)

    def _write_truth(self, p1: Floats, p2: Floats, jacobian_error: float) -> None:
        self._send("rcmservo/truth", ros2.encode_truth(self._observed_ns, p1, p2, jacobian_error))

    def write_frame(self, frame: Frame) -> None:
        """Add the image of a frame as a JPEG file; its stamp is the exposure."""
        self._attempt(self._write_frame, frame)

    def _write_frame(self, frame: Frame) -> None:
        if frame.image is None:
            return
        message = ros2.encode_picture(frame.exposure, encode_image(frame.image))
        if len(message) > MAX_RECORD_BYTES // 2:
            raise RcmServoError("a frame is too large for a record")
        self._send("image_raw/compressed", message)

    def _send(self, topic: str, message: bytes) -> None:
        if topic not in self._channels:
            schema = self._register_schema(ros2.TOPICS[topic])
            self._channels[topic] = self._writer.register_channel(topic, "cdr", schema)
        time_ns, number = self._log_time_ns, self._message_counts[topic]
        self._writer.add_message(self._channels[topic], time_ns, message, time_ns, number)
        self._message_counts[topic] += 1

    def _register_schema(self, message_type: str) -> int:
        """Return the number of a message type's definition in the file."""
        if message_type not in self._schemas:
            schema = message_type, "ros2msg", ros2.DEFINITIONS[message_type].encode()
            self._schemas[message_type] = self._writer.register_schema(*schema)
        return self._schemas[message_type]

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
        if self._is_closed:
            return
        self._is_closed = True
        self._attempt(self._writer.finish)
        try:
            self._file.close()
        except OSError as error:
            self.failed = self.failed or f"{self.path}: cannot be written: {error.strerror}"
        self._attempt(write_metadata, self.path, self._message_counts, self._log_time_ns)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _has_changed(previous: Tick, tick: Tick) -> bool:
    """Return True if servo or target changed between two ticks of a run."""
    return tick.servo is not previous.servo or tick.state.target != previous.state.target


def warm_up(servo: Servo) -> None:
    """Compile the functions that encode a tick of this servo."""
    ros2.get_codec().warm_up()
    servo.guarded_estimator.predict(servo.guarded_estimator.init(), servo.tool, np.zeros(3))


class ThreadedRecorder:
    """Recorder that writes in its own thread, so that the loop never waits for the disk.

    ``failed`` holds the reason if the record can no longer be written, else an empty string. One
    reason is a disk that falls too far behind.

    Parameters
    ----------
    recorder : Recorder
        Recorder that writes the messages.
    """

    def __init__(self, recorder: Recorder) -> None:
        self.failed = recorder.failed
        self._recorder = recorder
        self._queue: SimpleQueue[tuple[Callable[..., None], tuple[Any, ...]] | None] = SimpleQueue()
        self._frames_queued, self._frames_written = 0, 0
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def recorded(self) -> bool:
        """Return True if everything so far has been written or is queued."""
        return not self.failed

    def begin(self, servo: Servo, target: Target, state: State | None = None) -> None:
        """Begin a run; see `Recorder.begin`."""
        warm_up(servo)
        self._enqueue(self._recorder.begin, servo, target, state)

    def write(self, tick: Tick) -> None:
        """Add a tick; see `Recorder.write`."""
        self._enqueue(self._recorder.write, tick)

    def write_truth(self, p1: Floats, p2: Floats, jacobian_error: float) -> None:
        """Add the ground truth of the last tick; see `Recorder.write_truth`."""
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
        while (call := self._queue.get()) is not None:
            action, arguments = call
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

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class _UnbufferedStream:
    """Output stream of the MCAP writer that passes all bytes to the operating system at once."""

    def __init__(self, file: RawFile) -> None:
        self._file, self._position = file, 0

    def write(self, data: bytes) -> None:
        remaining = memoryview(data)
        while remaining:
            written_bytes = self._file.write(remaining)
            if not written_bytes:
                raise OSError(None, "nothing more can be written")
            self._position += written_bytes
            remaining = remaining[written_bytes:]

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        """Do nothing: there is no buffer."""
