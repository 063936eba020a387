"""What every estimator of the Jacobian offers: settings in one frozen object, memory in another,
and pure steps."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple

from rcmservo.interfaces import Floats
from rcmservo.method.tool import Tool


class Sample(NamedTuple):
    """One new frame as an estimator sees it: measured, never commanded."""

    p1: Floats
    """p₁ (3,) mm: where the robot's joints put marker 1 at the exposure."""
    points: Floats
    """The markers (2, 2) raw px."""
    o_c: Floats
    """The imaged RCM (2,) px as known now."""
    dt: float
    """s since the exposure of the sample before; 0 for the first of a run, and for the first after
    all was forgotten."""


class Estimator(ABC):
    """Learns Ĵ of eq. (14), ẏ = J v, from samples. ``init`` and ``update`` are pure; the memory is
    opaque to others."""

    name: ClassVar[str]
    """What it is called where its settings are options."""
    models: ClassVar[bool] = False
    """Whether it has a model that predicts where the markers are: `predict`."""
    advice: ClassVar[str] = ""
    """What a person may change of it where an exploration ends without a usable estimate."""

    @abstractmethod
    def init(self) -> Any:
        """The empty estimate: Ĵ = 0 or â = 0."""

    @abstractmethod
    def update(self, memory: Any, tool: Tool, sample: Sample) -> Any:
        """The memory after one new frame."""

    @abstractmethod
    def jacobian(self, memory: Any, tool: Tool, sample: Sample) -> Floats:
        """Ĵ (3, 3) at the sample, rad/mm, px/mm, px/mm; zeros while nothing is known."""

    def located(self, memory: Any, tool: Tool, sample: Sample) -> Floats:
        """Where the markers are at the sample, (2, 2) raw px: as they were seen, unless an
        estimator averages their noise out."""
        del memory, tool
        return sample.points

    def predict(self, memory: Any, tool: Tool, p1: Floats) -> Floats | None:
        """The markers' pixels m (4,) from o_c that the estimate expects at p1, or None where it has
        no such model."""
        del memory, tool, p1
        return None

    def remembered(self, memory: Any) -> Floats | None:
        """The numbers (n,) of its memory that a record keeps beside every tick, always as many;
        none unless an estimator says so."""
        del memory
        return None
