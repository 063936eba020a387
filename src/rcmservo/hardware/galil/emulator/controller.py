"""Emulated controller: axes and program per sample, and the command lines of its hosts.

Each command of a host has its own prompt: a colon if it is accepted, a question mark if it is
refused. Sources: command reference, Communications; motorapp/Galil, GalilConnector.cpp.
"""

from rcmservo.hardware.galil.connection import MAX_LINE_LENGTH, UNSOLICITED_BIT
from rcmservo.hardware.galil.data_record import AXIS_LETTERS
from rcmservo.hardware.galil.emulator.axis import StopCode
from rcmservo.hardware.galil.emulator.commands import reports
from rcmservo.hardware.galil.emulator.commands.arguments import split_arguments
from rcmservo.hardware.galil.emulator.commands.threads import interrupt, run_threads
from rcmservo.hardware.galil.emulator.expressions import evaluate
from rcmservo.hardware.galil.emulator.interpreter import command_name, execute
from rcmservo.hardware.galil.emulator.motors import Motors
from rcmservo.hardware.galil.emulator.program import Program
from rcmservo.hardware.galil.emulator.state import HANDLE_COUNT, Caller, ControllerState, Host
from rcmservo.hardware.galil.error_codes import CommandError, ErrorCode

SAMPLE_TIME_S = 1.0 / 1024.0
"""Sample time in s: 976 us at TM 1000."""

VELOCITY_FILTER_S = 0.125
"""Time constant of the filter of TV."""

UNDER_VOLTAGE_BITS = 0b10001000
"""Under-voltage of all axes in TA0."""

SILENT_SAMPLES = 3072
"""Samples during which the controller does not answer after BZ."""

MIN_RECORD_PERIOD, MAX_RECORD_PERIOD = 2, 30000
"""Range of the period of DR in samples."""

TCP, UDP = 2, 1
"""Use of a handle, as in the data record."""

SERIAL = HANDLE_COUNT
"""Number of the serial port among the host connections, after the handles."""

END_OF_LISTING = b"\x1a"


class GalilController:
    """Emulated controller. `sample` advances the time.

    Parameters
    ----------
    motors : Motors
        Motors and encoders that the controller drives.
    axes : int
        Number of axes.
    """

    def __init__(self, motors: Motors, axes: int = 4) -> None:
        self.motors = motors
        self.connections: dict[int, Host] = {}
        self.stuck: int | None = None
        """Axis that does not move whatever its motor does; None for no fault."""
        self.unpowered = False
        """True for an under-voltage of the amplifiers."""
        self._axis_count, self._encoders = axes, [0.0] * axes
        self.reset()

    def reset(self) -> None:
        """Restore the state after power-on and drop all connections."""
        self.state = ControllerState(self._axis_count)
        self.connections.clear()
        self._origins = list(self._encoders)
        self._silent_until, self._record_period, self._record_handle = 0, 0, 0

    # Time

    def sample(self) -> None:
        """Advance by one sample."""
        state = self.state
        state.samples += 1
        self._move()
        run_threads(state, self._execute)
        for host in list(self.connections.values()):  # a pending RS may drop them all
            self._serve(host)
        self._send_messages()
        if self._record_period and state.samples % self._record_period == 0:
            receiver = self.connections.get(self._record_handle)
            if receiver is not None:
                receiver.output += reports.encode_data_record(state)

    def _move(self) -> None:
        """Advance axes and motors, and start the interrupts of errors and limits."""
        axes = self.state.axes
        for axis, switches in zip(axes, self.motors.switches(), strict=True):
            axis.forward_tripped, axis.reverse_tripped = switches
        self._apply_under_voltage()
        off_before = [axis.motor_off for axis in axes]
        at_limit_before = [axis.is_stopping_at_limit for axis in axes]
        speeds = [axis.step(SAMPLE_TIME_S, self.motors.lag) for axis in axes]
        if self.stuck is not None:
            speeds[self.stuck] = 0.0
        on = [not axis.motor_off for axis in axes]
        self._encoders = list(self.motors.step(speeds, on, SAMPLE_TIME_S))
        for axis, count, origin in zip(axes, self._encoders, self._origins, strict=True):
            previous, axis.position = axis.position, count - origin
            velocity = (axis.position - previous) / SAMPLE_TIME_S
            axis.velocity += (velocity - axis.velocity) * SAMPLE_TIME_S / VELOCITY_FILTER_S
            axis.check_following_error()
        off_now = [axis.motor_off for axis in axes]
        at_limit_now = [axis.is_stopping_at_limit for axis in axes]
        if _any_rises(off_before, off_now):
            interrupt(self.state, "POSERR")
        if _any_rises(at_limit_before, at_limit_now):
            interrupt(self.state, "LIMSWI")

    def _apply_under_voltage(self) -> None:
        """Set the amplifiers' error bits, and switch the motors off on under-voltage."""
        errors = self.state.amplifier
        errors[0] &= ~UNDER_VOLTAGE_BITS
        if self.unpowered:
            errors[0] |= UNDER_VOLTAGE_BITS
            for axis in self.state.axes:
                if not axis.motor_off:
                    axis.switch_off(StopCode.AMPLIFIER)

    def _execute(self, state: ControllerState, text: str, caller: Caller) -> str | None:
        """Execute a command of a host or thread, including those that need more than the state."""
        name, arguments = command_name(text), text[2:]
        match name:
            case "DP":
                before = [axis.position for axis in state.axes]
                reply = execute(state, text, caller)
                for i, (axis, previous) in enumerate(zip(state.axes, before, strict=True)):
                    self._origins[i] -= axis.position - previous
                return reply
            case "DR":
                self._stream_records(arguments)
            case "CF":
                self._route_messages(arguments, caller)
            case "EO":
                self._set_echo(arguments, caller)
            case "BZ":
                if "=" in arguments:
                    self._silent_until = state.samples + SILENT_SAMPLES
            case _:
                return execute(state, text, caller)
        return None

    def _stream_records(self, arguments: str) -> None:
        """DR: send data records to a UDP handle at a period in samples; 0 ends it."""
        parts = split_arguments(arguments)
        period = int(evaluate(parts[0], self.state))
        if period == 0:
            self._record_period = 0
            return
        if not MIN_RECORD_PERIOD <= period <= MAX_RECORD_PERIOD:
            raise CommandError(ErrorCode.NUMBER_OUT_OF_RANGE)
        handle = int(evaluate(parts[1], self.state)) if len(parts) > 1 else -1
        receiver = self.connections.get(handle)
        if receiver is None or receiver.kind != UDP:
            raise CommandError(ErrorCode.HANDLE_MUST_BE_UDP)
        self._record_period, self._record_handle = period // 2 * 2, handle

    def _route_messages(self, arguments: str, caller: Caller) -> None:
        """CF: set the destination of unsolicited messages."""
        destination = arguments.strip()
        if destination == "I" and isinstance(caller, Host):
            destination = "S" if caller.handle == SERIAL else AXIS_LETTERS[caller.handle]
        if len(destination) != 1 or destination not in AXIS_LETTERS + "ST":
            raise CommandError(ErrorCode.NUMBER_OUT_OF_RANGE)
        self.state.message_destination = destination

    def _set_echo(self, arguments: str, caller: Caller) -> None:
        """EO: switch the echo of the serial port. Only its own host can."""
        if not isinstance(caller, Host) or caller.handle != SERIAL:
            raise CommandError(ErrorCode.UNRECOGNIZED_COMMAND)
        caller.echo = evaluate(arguments, self.state) != 0.0

    def _send_messages(self) -> None:
        for destination, text in self.state.messages:
            handle = SERIAL if destination == "S" else AXIS_LETTERS.find(destination)
            receiver = self.connections.get(handle)
            if receiver is not None:
                message = f"{text}\r\n".encode("latin-1")
                marked = bytes(byte | UNSOLICITED_BIT for byte in message)
                receiver.output += marked if self.state.mark_unsolicited else message
        self.state.messages.clear()

    # Hosts

    def connect_serial(self) -> None:
        """Connect a host to the serial port, with echo until EO 0."""
        self.connections[SERIAL] = Host(handle=SERIAL, echo=True)

    def connect(self, kind: int = TCP) -> int | None:
        """Connect a host and return its handle, or None if all handles are in use."""
        handle = next((i for i in range(HANDLE_COUNT) if i not in self.connections), None)
        if handle is not None:
            self.connections[handle] = Host(handle=handle, kind=kind)
            self.state.handles[handle] = kind
        return handle

    def disconnect(self, handle: int) -> None:
        """Release the handle of a host."""
        if self.connections.pop(handle, None) is not None and handle != SERIAL:
            self.state.handles[handle] = 0

    def receive(self, handle: int, data: bytes) -> None:
        """Receive bytes from a host and execute its commands as far as possible."""
        host = self.connections[handle]
        if host.echo:
            host.output += data
        for character in data.decode("latin-1"):
            if host.download is not None:
                self._receive_download(host, host.download, character)
            elif character not in "\r\n" or not host.download_ended:
                host.download_ended = False
                self._receive_command(host, character)
        if handle in self.connections:
            self._serve(host)

    def take_output(self, handle: int) -> bytes:
        """Return the bytes for a host and remove them from its output."""
        host = self.connections[handle]
        output = bytes(host.output)
        host.output.clear()
        return output

    def _receive_command(self, host: Host, character: str) -> None:
        ends_command = character == ";" and host.text.count('"') % 2 == 0
        if character == "\r" or ends_command:
            host.pending.append(host.text)
            host.text = ""
            host.line_length = 0 if character == "\r" else host.line_length + 1
            self._serve(host)
        elif character != "\n" and host.line_length < MAX_LINE_LENGTH:
            host.text += character
            host.line_length += 1

    def _receive_download(self, host: Host, program: Program, character: str) -> None:
        """Add a character to the program that a host downloads. A backslash ends the download."""
        if character == "\\":
            self.state.program = program
            host.download, host.download_ended = None, True
            host.text, host.line_length = "", 0
            host.output += b"::"
        elif character == "\r":
            try:
                program.add(host.text)
            except CommandError as error:
                self.state.error = error.code.value
                host.download = None
                host.output += b"?"
            host.text = ""
        elif character != "\n":
            host.text += character

    def _serve(self, host: Host) -> None:
        """Execute a host's pending commands up to one that waits."""
        while self.state.samples >= self._silent_until:
            was_waiting = host.resume_condition is not None
            if not host.can_continue():
                return
            host.output += b":" * was_waiting
            if not host.pending:
                return
            self._reply(host, host.pending.popleft().strip())

    def _reply(self, host: Host, text: str) -> None:
        """Execute one command and add its reply to the output."""
        try:
            match command_name(text):
                case "RS":
                    self.reset()
                case "QR":
                    host.output += reports.encode_data_record(self.state) + b":"
                case "UL":
                    listing = "".join(f"{line}\r\n" for line in self.state.program.lines)
                    host.output += listing.encode("latin-1") + END_OF_LISTING + b":"
                case _:
                    data = self._execute(self.state, text, host)
                    if host.resume_condition is None and host.download is None:
                        host.output += (f"{data}\r\n:" if data else ":").encode("latin-1")
        except CommandError as error:
            self.state.error = error.code.value
            host.output += b"?"


def _any_rises(before: list[bool], now: list[bool]) -> bool:
    """Return True if a value has changed from False to True."""
    return any(new and not old for old, new in zip(before, now, strict=True))
