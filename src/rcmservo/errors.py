"""What can go wrong because of what a person gave us: one base class, subclasses that carry the data."""


class RcmServoError(Exception):
    """Any error that rcmservo raises on purpose; its message is one sentence for a person."""


class BadInput(RcmServoError, ValueError):
    """A value that cannot be used: which field, what it was, and what would be right."""

    def __init__(self, field: str, value: object, right: str) -> None:
        super().__init__(f"{field} must be {right}, got {value!r}")
        self.field, self.value, self.right = field, value, right


class UnusableFile(RcmServoError):
    """A file or folder that cannot be read or written: which one, and why."""

    def __init__(self, path: object, why: str) -> None:
        super().__init__(f"{path}: {why}")
        self.path, self.why = path, why


def require(good: bool, field: str, value: object, right: str) -> None:
    """Raise :class:`BadInput` unless `good`. Write the test so that NaN fails it."""
    if not good:
        raise BadInput(field, value, right)
