"""What every estimator of the Jacobian offers: settings in one frozen object, memory in another,
and pure steps.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np

from rcmservo.constraints import Checked
from rcmservo.geometry.features import FEATURES, MAX_FEATURES
from rcmservo.geometry.tool import Shaft, Tool
from rcmservo.interfaces import Floats
from rcmservo.numerics.structs import Row, flag, real, reals, whole


class Sample(NamedTuple):
    """One new frame as an estimator sees it: measured, never commanded.

    Parameters
    ----------
    p1 : Floats
        p₁ (3,) mm: where the robot's joints put marker 1 at the exposure.
    points : Floats
        The markers (2, 2) raw px.
    o_c : Floats
        The imaged RCM (2,) px as known now; NaN where the estimator is to tell it.
    dt : float
        s since the exposure of the sample before; 0 for the first of a run, and for the first after
        all was forgotten.
    sizes : Floats
        The markers' apparent radii (2,) px, NaN where not known.
    """

    p1: Floats
    points: Floats
    o_c: Floats
    dt: float
    sizes: Floats = np.full(2, np.nan)


class Estimated(Row):
    """Result of an estimator for one frame, from which the servo takes features and error."""

    points: Floats = reals((2, 2), "px", "markers, raw; without their noise where it is averaged")
    J_hat: Floats = reals((3, 3), "rad/mm, px/mm, px/mm", "Ĵ of eq. (14), where not placed")
    motion: Floats = reals((4, 3), "px/mm", "∂m/∂p₁ of both markers, where asked for or placed")
    placed: bool = flag("whether the estimator gives the imaged RCM, and Ĵ follows from motion")
    failed: bool = flag("whether a user's estimator or feature vector failed at this tick")
    o_c: Floats = reals(2, "px", "imaged RCM, raw, where placed")
    o_c_covariance: Floats = reals((2, 2), "px²", "of o_c")


class KernelSample(NamedTuple):
    """One new frame as an estimator's kernel sees it.

    Parameters
    ----------
    p1 : Floats
        Marker 1 (3,) mm by the joints at the exposure.
    points : Floats
        Markers (2, 2), raw px.
    o_c : Floats
        Imaged RCM (2,), raw px.
    dt : float
        Time since the exposure of the sample before, s; 0 for the first.
    shaft : Shaft
        Tool.
    needs_motion : bool
        Whether ∂m/∂p₁ is asked for.
    fit_changed : bool
        Whether the fit of the projection is another one than at the last frame.
    """

    p1: Floats
    points: Floats
    o_c: Floats
    dt: float
    shaft: Shaft
    needs_motion: bool
    fit_changed: bool


class EstimatorKernel(Protocol):
    """Compiled form of an estimator: a named tuple of its settings, whose class names compiled
    functions.
    """

    places_rcm: ClassVar[bool]
    """Whether it estimates the imaged RCM itself, without the lines of eq. (16)."""
    update: ClassVar[Callable[..., Any]]
    """Function of (kernel, memory, `KernelSample`, fit of the projection, `Estimated`): it writes
    the result, and returns the memory after one new frame."""
    empty: ClassVar[Callable[..., Any]]
    """Function of (kernel, memory): the memory before the first frame."""


@runtime_checkable
class CompiledEstimator(Protocol):
    """An estimator that is part of the compiled tick."""

    @property
    def kernel(self) -> Any:
        """Its `EstimatorKernel`."""
        ...


class Estimator(Checked, ABC, section="estimator"):
    """Learns Ĵ of eq. (14), ẏ = J v, from samples. ``init`` and ``update`` are pure; the memory is
    opaque to others.
    """

    name: ClassVar[str]
    """What it is called where its settings are options."""
    models: ClassVar[bool] = False
    """Whether it has a model that predicts where the markers are: `predict`."""
    places_rcm: ClassVar[bool] = False
    """Whether it tells the imaged RCM itself, with `imaged_rcm` and `motion`. Otherwise eq. (16)
    does."""
    spares_marker: ClassVar[bool] = False
    """Whether it goes on where the points of one marker are NaN, and places that marker itself;
    asked only of one that tells the imaged RCM."""
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
        estimator averages their noise out.
        """
        del memory, tool
        return sample.points

    def imaged_rcm(self, memory: Any) -> tuple[Floats, Floats] | None:
        """o_c (2,) raw px and its covariance (2, 2) px², or None where eq. (16) is to tell it."""
        del memory
        return None

    def motion(self, memory: Any, tool: Tool, sample: Sample) -> Floats:
        """∂m/∂p₁ (4, 3) px/mm of both markers at the sample. Asked of an estimator that tells the
        imaged RCM itself, and of any where the law acts on the markers' coordinates.
        """
        raise NotImplementedError(type(self).__name__)

    @property
    def tells_motion(self) -> bool:
        """Whether it has a `motion` of its own."""
        return type(self).motion is not Estimator.motion

    def size_motion(self, memory: Any, tool: Tool, sample: Sample) -> Floats:
        """∂R/∂p₁ (2, 3) px/mm of both markers' apparent radii at the sample. Asked where the law
        acts on these too.
        """
        raise NotImplementedError(type(self).__name__)

    @property
    def tells_size_motion(self) -> bool:
        """Whether it has a `size_motion` of its own."""
        return type(self).size_motion is not Estimator.size_motion

    def predict(self, memory: Any, tool: Tool, p1: Floats) -> Floats | None:
        """The markers' pixels m (4,) from o_c that the estimate expects at p1, or None where it has
        no such model.
        """
        del memory, tool, p1
        return None

    def remembered(self, memory: Any) -> Floats | None:
        """The numbers (n,) of its memory that a record keeps beside every tick, always as many;
        none unless an estimator says so.
        """
        del memory
        return None


class Estimate(Row):
    """What frames have taught, in numbers; NaN where not known yet."""

    exposure: int = whole("ns", "of the newest frame learnt from, -1 before the first")
    points: Floats = reals((2, 2), "px", "the markers in the newest frame believed")
    p1: Floats = reals(3, "mm", "marker 1 in space at that exposure")
    line_count: int = whole("", "lines of the tool kept for eq. (16)")
    o_c: Floats = reals(2, "px", "the imaged RCM")
    o_c_covariance: Floats = reals((2, 2), "px²", "of o_c, where a fit of the projection tells it")
    rcm_condition: float = real("", "condition of eq. (16), 0 where o_c is of such a fit")
    J_hat: Floats = reals((FEATURES, 3), "rad/mm, px/mm, px/mm", "Ĵ of eq. (14)")
    condition: float = real("", "condition of the scaled Ĵ")
    law_jacobian: Floats = reals((MAX_FEATURES, 3), "", "∂/∂p₁ of the features of the law, per mm")
    law_error: Floats = reals(MAX_FEATURES, "", "their error at the exposure")
    y: Floats = reals(FEATURES, "rad, px, px", "the features, eq. (6)")
    delta: Floats = reals(FEATURES, "rad, px, px", "Δy at the exposure")
    ahead: Floats = reals(FEATURES, "rad, px, px", "Δy as predicted for now")
