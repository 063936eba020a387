"""Host of an emulated controller in simulated time."""

from galil_measures import IdealMotors

from rcmservo.hardware.galil.emulator.controller import GalilController


class EmulatedHost:
    """Host that is connected to an emulated controller. Calling it sends bytes."""

    def __init__(self, axes: int = 4) -> None:
        self.motors = IdealMotors(axes)
        self.controller = GalilController(self.motors, axes)
        self.handle = self.controller.connect()
        assert self.handle is not None

    def __call__(self, sent: bytes) -> bytes:
        """Send bytes and return the immediate reply."""
        assert self.handle is not None
        self.controller.receive(self.handle, sent)
        return self.controller.take_output(self.handle)

    def after(self, seconds: float) -> bytes:
        """Advance the time and return the bytes received meanwhile."""
        assert self.handle is not None
        for _ in range(round(seconds * 1024)):
            self.controller.sample()
        return self.controller.take_output(self.handle)

    def number(self, expression: str) -> float:
        """Return the value of an expression (MG)."""
        return float(self(f"MG {expression}\r".encode()).split(b"\r")[0])
