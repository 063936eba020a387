"""A host that talks with an emulated controller in simulated time."""

from galil_measures import IdealMotors

from rcmservo.hardware.galil.emulator.controller import Controller


class Talk:
    """One host that is connected to an emulated controller, in simulated time."""

    def __init__(self, axes: int = 4) -> None:
        self.motors = IdealMotors(axes)
        self.controller = Controller(self.motors, axes)
        self.handle = self.controller.connect()
        assert self.handle is not None

    def __call__(self, sent: bytes) -> bytes:
        """What is answered at once."""
        assert self.handle is not None
        self.controller.hear(self.handle, sent)
        return self.controller.answers(self.handle)

    def after(self, seconds: float) -> bytes:
        """What comes while so many s pass."""
        assert self.handle is not None
        for _ in range(round(seconds * 1024)):
            self.controller.sample()
        return self.controller.answers(self.handle)

    def number(self, expression: str) -> float:
        """What MG tells of an expression."""
        return float(self(f"MG {expression}\r".encode()).split(b"\r")[0])
