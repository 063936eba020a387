"""Emulated controller: axes and program per sample, and the command lines of its hosts.

Each command of a host has its own prompt: a colon if it is accepted, a question mark if it is
refused. Sources: command reference, Communications; motorapp/Galil, GalilConnector.cpp.
"""

from collections import deque
from dataclasses import dataclass, field

from rcmservo.hardware.galil.connection import MAX_LINE_LENGTH
from rcmservo.hardware.galil.data_record import AXIS_LETTERS
from rcmservo.hardware.galil.emulator.axis import Axis, StopCode
from rcmservo.hardware.galil.emulator.commands import reports
from rcmservo.hardware.galil.emulator.commands.arguments import split_arguments
from rcmservo.hardware.galil.emulator.commands.threads import interrupt, run_threads
from rcmservo.hardware.galil.emulator.expressions import CommandError, evaluate
from rcmservo.hardware.galil.emulator.interpreter import command_name, execute
from rcmservo.hardware.galil.emulator.motors import Motors
from rcmservo.hardware.galil.emulator.state import HANDLE_COUNT, Caller, ControllerState, Host

SAMPLE_TIME_S = 1.0 / 1024.0
"""Sample time in s: 976 us at TM 1000."""

VELOCITY_FILTER_S = 0.125
"""Time constant of the filter of TV."""

UNDER_VOLTAGE_BITS = 0b10001000
"""Under-voltage of all axes in TA0."""

SILENT_SAMPLES = 3072
"""Samples during which the controller does not answer after BZ."""

TCP, UDP = 2, 1
"""Use of a handle, as in the data record."""

SERIAL = HANDLE_COUNT
"""Number of the serial port among the host connections, after the handles."""


@dataclass
class HostConnection:
    """Input and output of one host.

    Parameters
    ----------
    host : Host
        The host.
    kind : int
        TCP, UDP, or 0 for the serial port.
    text : str
        Characters of the incomplete command.
    line_length : int
        Characters of the present line so far.
    download_ended : bool
        True if the last character ended a download. Line ends after it are ignored.
    pending : deque[str]
        Commands that wait for an earlier one.
    output : bytearray
        Bytes to send.
    echo : bool
        True if received bytes are sent back.
    """

    host: Host
    kind: int
    text: str = ""
    line_length: int = 0
    download_ended: bool = False
    pending: deque[str] = field(default_factory=deque[str])
    output: bytearray = field(default_factory=bytearray)
    echo: bool = False


class Controller:
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
        self.connections: dict[int, HostConnection] = {}
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
        for connection in list(self.connections.values()):  # a pending RS may drop them all
            self._serve(connection)
        self._send_messages()
        if self._record_period and state.samples % self._record_period == 0:
            connection = self.connections.get(self._record_handle)
            if connection is not None:
                connection.output += reports.encode_data_record(state)

    def _move(self) -> None:
        """Advance axes and motors, and start the interrupts of errors and limits."""
        axes = self.state.axes
        for axis, switches in zip(axes, self.motors.switches(), strict=True):
            axis.forward_tripped, axis.reverse_tripped = switches
        self._apply_under_voltage()
        before = [(axis.motor_off, _stops_at_limit(axis)) for axis in axes]
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
        after = [(axis.motor_off, _stops_at_limit(axis)) for axis in axes]
        if any(now[0] and not then[0] for then, now in zip(before, after, strict=True)):
            interrupt(self.state, "POSERR")
        if any(now[1] and not then[1] for then, now in zip(before, after, strict=True)):
            interrupt(self.state, "LIMSWI")

    def _apply_under_voltage(self) -> None:
        """Set the amplifiers' error bits, and switch the motors off on under-voltage."""
        errors = self.state.amplifier
        errors[0] &= ~UNDER_VOLTAGE_BITS
        if self.unpowered:
            errors[0] |= UNDER_VOLTAGE_BITS
        for axis in self.state.axes:
            if self.unpowered and not axis.motor_off:
                axis.switch_off(StopCode.AMPLIFIER)

    def _execute(self, state: ControllerState, text: str, caller: Caller) -> str:
        """Execute a command of a host or thread, including those that need more than the state."""
        name, rest = command_name(text), text[2:]
        match name:
            case "DP":
                before = [axis.position for axis in state.axes]
                reply = execute(state, text, caller)
                for i, (axis, previous) in enumerate(zip(state.axes, before, strict=True)):
                    self._origins[i] -= axis.position - previous
                return reply
            case "DR":
                return self._stream_records(rest)
            case "CF":
                return self._route_messages(rest, caller)
            case "EO":
                return self._set_echo(rest, caller)
            case "BZ":
                if "=" in rest:
                    self._silent_until = state.samples + SILENT_SAMPLES
                return ""
            case _:
                return execute(state, text, caller)

    def _stream_records(self, rest: str) -> str:
        """DR: send data records to a UDP handle at a period in samples; 0 ends it."""
        parts = split_arguments(rest)
        period = int(evaluate(parts[0], self.state))
        if period == 0:
            self._record_period = 0
            return ""
        if period < 2 or period > 30000:
            raise CommandError(6)
        handle = int(evaluate(parts[1], self.state)) if len(parts) > 1 else -1
        connection = self.connections.get(handle)
        if connection is None or connection.kind != UDP:
            raise CommandError(133)
        self._record_period, self._record_handle = period // 2 * 2, handle
        return ""

    def _route_messages(self, rest: str, caller: Caller) -> str:
        """CF: set the destination of unsolicited messages."""
        destination = rest.strip()
        if destination == "I" and isinstance(caller, Host):
            destination = "S" if caller.handle == SERIAL else AXIS_LETTERS[caller.handle]
        if len(destination) != 1 or destination not in AXIS_LETTERS + "ST":
            raise CommandError(6)
        self.state.message_destination = destination
        return ""

    def _set_echo(self, rest: str, caller: Caller) -> str:
        """EO: switch the echo of the serial port. Only its own host can."""
        if not isinstance(caller, Host) or caller.handle != SERIAL:
            raise CommandError(1)
        self.connections[SERIAL].echo = evaluate(rest, self.state) != 0.0
        return ""

    def _send_messages(self) -> None:
        for destination, text in self.state.messages:
            handle = SERIAL if destination == "S" else AXIS_LETTERS.find(destination)
            connection = self.connections.get(handle)
            if connection is not None:
                sent = f"{text}\r\n".encode("latin-1")
                marked = bytes(byte | 0x80 for byte in sent)
                connection.output += marked if self.state.mark_unsolicited else sent
        self.state.messages.clear()

    # Hosts

    def connect_serial(self) -> None:
        """Connect a host to the serial port, with echo until EO 0."""
        self.connections[SERIAL] = HostConnection(Host(handle=SERIAL), kind=0, echo=True)

    def connect(self, kind: int = TCP) -> int | None:
        """Connect a host and return its handle, or None if all handles are in use."""
        free = next((i for i in range(HANDLE_COUNT) if i not in self.connections), None)
        if free is not None:
            self.connections[free] = HostConnection(Host(handle=free), kind)
            self.state.handles[free] = kind
        return free

    def disconnect(self, handle: int) -> None:
        """Release the handle of a host."""
        if self.connections.pop(handle, None) is not None and handle != SERIAL:
            self.state.handles[handle] = 0

    def receive(self, handle: int, data: bytes) -> None:
        """Receive bytes from a host and execute its commands as far as possible."""
        connection = self.connections[handle]
        if connection.echo:
            connection.output += data
        for character in data.decode("latin-1"):
            if connection.host.download is not None:
                self._receive_download(connection, character)
            elif character not in "\r\n" or not connection.download_ended:
                connection.download_ended = False
                self._receive_command(connection, character)
        if handle in self.connections:
            self._serve(connection)

    def take_output(self, handle: int) -> bytes:
        """Return the bytes for a host and remove them from its output."""
        connection = self.connections[handle]
        output = bytes(connection.output)
        connection.output.clear()
        return output

    def _receive_command(self, connection: HostConnection, character: str) -> None:
        ends_command = character == ";" and connection.text.count('"') % 2 == 0
        if character == "\r" or ends_command:
            connection.pending.append(connection.text)
            connection.text = ""
            connection.line_length = 0 if character == "\r" else connection.line_length + 1
            self._serve(connection)
        elif character != "\n" and connection.line_length < MAX_LINE_LENGTH:
            connection.text += character
            connection.line_length += 1

    def _receive_download(self, connection: HostConnection, character: str) -> None:
        program = connection.host.download
        assert program is not None
        if character == "\\":
            self.state.program = program
            connection.host.download = None
            connection.text, connection.line_length = "", 0
            connection.download_ended = True
            connection.output += b"::"
        elif character == "\r":
            self._add_program_line(connection, connection.text)
            connection.text = ""
        elif character != "\n":
            connection.text += character

    def _add_program_line(self, connection: HostConnection, line: str) -> None:
        assert connection.host.download is not None
        try:
            connection.host.download.add(line)
        except CommandError as error:
            self.state.error = error.code
            connection.host.download = None
            connection.output += b"?"

    def _serve(self, connection: HostConnection) -> None:
        """Execute a host's pending commands up to one that waits."""
        host = connection.host
        while self.state.samples >= self._silent_until:
            waited = host.wait is not None
            if not host.can_continue():
                return
            connection.output += b":" * waited
            if not connection.pending:
                return
            self._reply(connection, connection.pending.popleft().strip())

    def _reply(self, connection: HostConnection, text: str) -> None:
        """Execute one command and add its reply to the output."""
        name = command_name(text)
        try:
            if name == "RS":
                self.reset()
            elif name == "QR":
                connection.output += reports.encode_data_record(self.state) + b":"
            elif name == "UL":
                listing = "".join(f"{line}\r\n" for line in self.state.program.lines)
                connection.output += listing.encode("latin-1") + b"\x1a:"
            else:
                data = self._execute(self.state, text, connection.host)
                if connection.host.wait is None and connection.host.download is None:
                    connection.output += (f"{data}\r\n:" if data else ":").encode("latin-1")
        except CommandError as error:
            self.state.error = error.code
            connection.output += b"?"


def _stops_at_limit(axis: Axis) -> bool:
    return axis.stopping and axis.stop_code in (StopCode.FORWARD, StopCode.REVERSE)
