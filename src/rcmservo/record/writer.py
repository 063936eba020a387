"""Writing a run while it happens: an MCAP file of ROS 2 messages, under CRTK's topic names where
CRTK has one.

    rcmservo/about        std_msgs/String             settings, seed and versions, as JSON
    rcmservo/stage        std_msgs/String             a stage begins: its servo and target, as JSON
    rcmservo/memory       rcmservo_msgs/Memory        what a user's own estimator remembers
    rcmservo/tick         rcmservo_msgs/Tick          all that the servo saw, knew and decided
    rcmservo/truth        rcmservo_msgs/Truth         simulation only: what the servo must not know
    measured_js           sensor_msgs/JointState      the joints as measured (rad and m, SI)
    servo_jv              sensor_msgs/JointState      the joints as commanded (SI)
    operating_state       crtk_msgs/OperatingState    whenever it changes: phase, cause, way out
    image_raw/compressed  sensor_msgs/CompressedImage the frames, if wanted

Messages are logged at the time since the start, ns; their stamps are moments on the plant's clock.
Chunks are small, so that a process that is killed loses little. A record that cannot be written any
more never stops what is recorded: it says so, and what it has written stays readable.
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
from rcmservo.record import memory
from rcmservo.record import ros2_messages as ros2
from rcmservo.record.mcap_recovery import MAX_RECORD
from rcmservo.record.ros2_bag import write_metadata
from rcmservo.record.stage import ELSEWHERE, NOTHING, text_of
from rcmservo.servo.servo import Servo, State
from rcmservo.tracking import encode_image

CHUNK = 8 * 1024
"""Bytes from which on a chunk is written: seven ticks."""

WAITING = 1000
FRAMES_WAITING = 60
"""Messages, and frames among them, that may wait for the disk while the loop goes on."""


class RawFile(Protocol):
    """An unbuffered file."""

    def write(self, data: memoryview, /) -> int | None: ...

    def close(self) -> None: ...


def created(path: Path) -> RawFile:
    """A new file; one that is there already is not touched."""
    return path.open("xb", buffering=0)


class _Disk:
    """What the MCAP writer writes to: everything is the system's at once, and a short write is an
    error."""

    def __init__(self, file: RawFile) -> None:
        self._file, self._place = file, 0

    def write(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            count = self._file.write(rest)
            if not count:
                raise OSError(None, "nothing more can be written")
            self._place += count
            rest = rest[count:]

    def tell(self) -> int:
        return self._place

    def flush(self) -> None:
        """Nothing waits."""


class Recorder:
    """Writes a run to a new file; use it as a context, so that the file is ended however the run
    ends.

    ``failed`` says why the record can no longer be written, empty while it can; the rest of what is
    asked for is then left out without an error. ``open_file`` opens the file.
    """

    def __init__(
        self, path: Path, about: dict[str, Any], open_file: Callable[[Path], RawFile] = created
    ) -> None:
        self.path, self.failed = path, ""
        text = json.dumps(about)
        try:
            self._file = open_file(path)
        except OSError as error:
            raise UnusableFile(path, f"cannot be written: {error.strerror}") from error
        from mcap.writer import Writer

        # its parameter is annotated as a file object, of which it uses write, tell and flush
        self._writer = Writer(_Disk(self._file), chunk_size=CHUNK)  # pyright: ignore[reportArgumentType]
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._counts: Counter[str] = Counter()
        self._servo: Servo | None = None
        self._ends: list[State | None] = []
        self._last: Tick | None = None
        self._time, self._now, self._shift = 0, 0, 0
        self._closed = False
        self._try(self._start, text)

    def _start(self, about: str) -> None:
        self._writer.start(profile="ros2")
        self._send("rcmservo/about", ros2.encode_text(about))
        self._writer.flush()

    def recorded(self) -> bool:
        """Whether everything so far was written."""
        return not self.failed

    def begin(self, servo: Servo, target: Target, state: State | None = None) -> None:
        """A run begins, with what it is given: a servo, a target, and the state that it goes on
        from, if any."""
        warm(servo)
        self._try(self._begin, servo, target, state)

    def _begin(self, servo: Servo, target: Target, state: State | None) -> None:
        if self._servo is not None:
            self._ends.append(None if self._last is None else self._last.state)
        self._servo, self._last = servo, None
        self._joints = servo.mechanism.joint_names
        origin = NOTHING if state is None else self._origin(state)
        self._stage(text_of(servo, target, origin, mid_run=False))

    def _change(self, before: Tick, target: Target, tick: Tick) -> None:
        """A stage begins in mid-run: another servo or target from this tick on."""
        self._ends.append(before.state)
        self._stage(text_of(tick.servo, target, len(self._ends) - 1, mid_run=True))

    def _stage(self, text: str) -> None:
        self._send("rcmservo/stage", ros2.encode_text(text))
        self._writer.flush()

    def _origin(self, state: State) -> int:
        return next((i for i, end in enumerate(self._ends) if end is state), ELSEWHERE)

    def write(self, tick: Tick) -> None:
        """Add one tick of the loop. Another servo or target than at the tick before begins a stage
        in mid-run. Where ticks' times begin anew in a stage, the record's go on."""
        self._try(self._write, tick)

    def _write(self, tick: Tick) -> None:
        if self._servo is None:
            raise RcmServoError("a record's first stage must begin before its first tick")
        seen, state = tick.seen, tick.state
        if tick.time + self._shift < self._time:
            self._shift = self._time + max(seen.now - self._now, 0) - tick.time
        before, target = self._last, state.target
        self._time, self._now, self._last = tick.time + self._shift, seen.now, tick
        if before is not None and target is not None and _changed(before, tick):
            self._change(before, target, tick)
        if before is None or before.state.mode.words != state.mode.words:
            self._send("operating_state", ros2.encode_operating_state(seen.now, state.mode))
        kept = memory.numbers_of(tick)
        if kept is not None:
            self._send(memory.TOPIC, ros2.encode_memory(seen.now, kept))
        self._send("rcmservo/tick", ros2.encode_tick(tick))
        self._send("measured_js", ros2.encode_positions(self._joints, seen.q_time, seen.q))
        command = state.command
        self._send("servo_jv", ros2.encode_rates(self._joints, command.time, command.rates))

    def write_truth(self, p1: Floats, p2: Floats, jacobian_error: float) -> None:
        """Add what a simulation knows at the tick just written: the markers (3,) mm, the scaled
        relative error of Ĵ."""
        self._try(self._write_truth, p1, p2, jacobian_error)

    def _write_truth(self, p1: Floats, p2: Floats, jacobian_error: float) -> None:
        self._send("rcmservo/truth", ros2.encode_truth(self._now, p1, p2, jacobian_error))

    def write_frame(self, frame: Frame) -> None:
        """Add a picture, as a JPEG file. Its stamp is the exposure."""
        self._try(self._write_frame, frame)

    def _write_frame(self, frame: Frame) -> None:
        if frame.image is None:
            return
        data = ros2.encode_picture(frame.exposure, encode_image(frame.image))
        if len(data) > MAX_RECORD // 2:
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

    def _try(self, act: Callable[..., None], *given: Any) -> None:
        """Do it, unless the record has failed; if it fails now, say so and go on."""
        if self.failed:
            return
        try:
            act(*given)
        except OSError as error:
            self.failed = f"{self.path}: cannot be written: {error.strerror}"
        except RcmServoError as error:
            self.give_up(str(error))

    def give_up(self, why: str) -> None:
        """Write what waits, and nothing more: the record has failed."""
        self._try(self._writer.flush)
        self.failed = self.failed or why

    def close(self) -> None:
        """End the file, and make its folder a ROS 2 bag. Closed is closed: once more does
        nothing."""
        if self._closed:
            return
        self._closed = True
        self._try(self._writer.finish)
        try:
            self._file.close()
        except OSError as error:
            self.failed = self.failed or f"{self.path}: cannot be written: {error.strerror}"
        self._try(write_metadata, self.path, self._counts, self._time)

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _changed(before: Tick, tick: Tick) -> bool:
    """Whether a person changed settings or target between two ticks of a run."""
    return tick.servo is not before.servo or tick.state.target is not before.state.target


def warm(servo: Servo) -> None:
    """Compile what writing a tick calls."""
    ros2.codec().warm_up()
    servo.learner.predict(servo.learner.init(), servo.tool, np.zeros(3))


class ThreadedRecorder:
    """A recorder that writes in a thread of its own: it takes what it is given at once, and never
    waits for the disk.

    Where the disk falls too far behind, the record has failed, as it has where it cannot be
    written.
    """

    def __init__(self, recorder: Recorder) -> None:
        self.failed = recorder.failed
        self._recorder = recorder
        self._queue: SimpleQueue[tuple[Callable[..., None], tuple[Any, ...]] | None] = SimpleQueue()
        self._frames_given, self._frames_done = 0, 0
        self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._thread.start()

    def recorded(self) -> bool:
        """Whether everything so far was written or waits its turn."""
        return not self.failed

    def begin(self, servo: Servo, target: Target, state: State | None = None) -> None:
        """A run begins; see Recorder."""
        warm(servo)
        self._give(self._recorder.begin, servo, target, state)

    def write(self, tick: Tick) -> None:
        """Add one tick of the loop."""
        self._give(self._recorder.write, tick)

    def write_truth(self, p1: Floats, p2: Floats, jacobian_error: float) -> None:
        """Add what a simulation knows at the tick just written."""
        self._give(self._recorder.write_truth, p1, p2, jacobian_error)

    def write_frame(self, frame: Frame) -> None:
        """Add a picture, which must not change any more."""
        if self._frames_given - self._frames_done >= FRAMES_WAITING:
            self._behind()
        elif not self.failed:
            self._frames_given += 1
            self._give(self._write_frame, frame)

    def _write_frame(self, frame: Frame) -> None:
        self._recorder.write_frame(frame)
        self._frames_done += 1

    def _give(self, act: Callable[..., None], *given: Any) -> None:
        if self.failed:
            return
        if self._queue.qsize() >= WAITING:
            self._behind()
        else:
            self._queue.put((act, given))

    def _behind(self) -> None:
        self.failed = self.failed or f"{self._recorder.path}: the disk is too slow for the record"

    def _work(self) -> None:
        while (job := self._queue.get()) is not None:
            act, given = job
            try:
                act(*given)
            except Exception as error:  # whatever it is, the loop goes on and a person is told
                self._recorder.give_up(f"{self._recorder.path}: {error!r}")
            self.failed = self.failed or self._recorder.failed

    def close(self) -> None:
        """Wait until all is written, and end the file."""
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
