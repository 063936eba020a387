"""Feature vectors that the law (31) may act on, and their registry.

A `FeatureVector` says what it measures on both markers, the derivative of that, and what it needs
an estimator to estimate. The paper's own and the points are part of the compiled tick, by their
`code`. Another vector is measured in Python, once per frame; the law on it is compiled as well.
"""

from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple, final

import numpy as np

from rcmservo.errors import BadInput
from rcmservo.geometry.features import (
    INTERPRETED,
    MAX_FEATURES,
    POINTS,
    SCALE,
    SRD,
    about,
    features,
    features_jacobian,
    wrapped,
)
from rcmservo.interfaces import Floats
from rcmservo.numerics.structs import Row, reals, whole

UNITS = {"rad": 0, "px": 1}
"""Units of a component, with the index of their scale and of their saturation bound."""


class MarkerPair(NamedTuple):
    """Both markers as a feature vector measures them.

    Parameters
    ----------
    points : Floats
        Centres (2, 2), raw px; NaN where lost.
    sizes : Floats
        Apparent radii (2,) px; NaN where lost or unknown.
    o_c : Floats
        Imaged RCM (2,), raw px.
    """

    points: Floats
    sizes: Floats
    o_c: Floats


class FeatureParameters(Row):
    """A feature vector in compiled functions."""

    code: int = whole("", "code of the feature vector")
    dimension: int = whole("", "number of its components")
    scale: Floats = reals(MAX_FEATURES, "", "one unit of each component")
    bounds: Floats = reals(MAX_FEATURES, "", "saturation of each component, in these units")
    angle: Floats = reals(MAX_FEATURES, "", "1 for a component that wraps to (−π, π], else 0")


class FeatureVector(ABC):
    """Numbers of the image that the law brings to those of the target.

    ``measure`` and ``jacobian`` are pure. An instance is known by its ``name`` once it is given to
    `add_feature_vector`; then ``SaturatedController(features=name)`` acts on it.
    """

    name: ClassVar[str]
    """Its name as a setting."""
    components: ClassVar[tuple[str, ...]]
    """Name of each component; at most `MAX_FEATURES`, and at least 3 for a tool that turns and
    moves along its axis."""
    units: ClassVar[tuple[str, ...]]
    """Unit of each component, rad or px. An angle wraps to (−π, π]."""
    needs_motion: ClassVar[bool] = True
    """Whether the estimator must estimate ∂m/∂p₁ of the markers' coordinates."""
    needs_sizes: ClassVar[bool] = False
    """Whether it must estimate ∂R/∂p₁ of the apparent radii too, and the target have them."""
    leaves_out_lost: ClassVar[bool] = False
    """Whether a component that is not finite is left out, instead of measured where a fit has the
    lost marker."""
    code: ClassVar[int] = INTERPRETED
    """Code in compiled functions, of the vectors that these know."""

    @abstractmethod
    def measure(self, markers: MarkerPair) -> Floats:
        """Return the features (n,)."""

    @abstractmethod
    def jacobian(self, markers: MarkerPair) -> Floats:
        """Return the derivative (n, 4) with respect to u₁ v₁ u₂ v₂; of a vector that needs sizes
        (n, 6), with respect to R₁ R₂ too.
        """

    def linearise(
        self, markers: MarkerPair, target: MarkerPair, motion: Floats
    ) -> tuple[Floats, Floats]:
        """Return the error Δy (n,) to the target, and the features' Jacobian ∂y/∂p₁ (n, 3).

        `motion` (6, 3) px/mm is the derivative of u₁ v₁ u₂ v₂ R₁ R₂ with respect to p₁.
        """
        error, slope = self.measure(markers) - self.measure(target), self.jacobian(markers)
        J = slope @ motion[: slope.shape[1]]
        error = np.array([wrapped(e) if a else e for e, a in zip(error, self.angles, strict=True)])
        if self.leaves_out_lost:
            lost = ~np.isfinite(error)
            error[lost], J[lost] = 0.0, 0.0
        return error, J

    @property
    def angles(self) -> list[bool]:
        """Whether each component is an angle."""
        return [unit == "rad" for unit in self.units]

    def bounds(self, b: tuple[float, float, float]) -> list[float]:
        """Return the saturation of each component, from the controller's (rad, px, px)."""
        return [b[UNITS[unit]] for unit in self.units]

    def parameters(self, b: tuple[float, float, float]) -> FeatureParameters:
        """Return the vector in compiled functions, with the controller's bounds."""
        scale = [float(SCALE[UNITS[unit]]) for unit in self.units]
        scaled = [bound / one for bound, one in zip(self.bounds(b), scale, strict=True)]
        none = [0.0] * (MAX_FEATURES - len(scale))
        return FeatureParameters.of(
            code=self.code,
            dimension=len(scale),
            scale=scale + none,
            bounds=scaled + none,
            angle=[*map(float, self.angles), *none],
        )


@final
class ToolFeatures(FeatureVector):
    """The paper's y = [s r d] of (6)-(9): angle of the imaged tool and two distances.

    Its Jacobian Ĵ is what every estimator estimates.
    """

    name = "srd"
    components = ("s", "r", "d")
    units = ("rad", "px", "px")
    needs_motion = False
    code = SRD

    def measure(self, markers: MarkerPair) -> Floats:
        return features(about(markers.points, markers.o_c))

    def jacobian(self, markers: MarkerPair) -> Floats:
        return features_jacobian(about(markers.points, markers.o_c))

    def bounds(self, b: tuple[float, float, float]) -> list[float]:
        return list(b)


@final
class PointFeatures(FeatureVector):
    """The four coordinates of both markers, raw px."""

    name = "points"
    components = ("u1", "v1", "u2", "v2")
    units = ("px",) * 4
    code = POINTS

    def measure(self, markers: MarkerPair) -> Floats:
        return markers.points.ravel()

    def jacobian(self, markers: MarkerPair) -> Floats:
        return np.eye(4)


@final
class SizeFeatures(FeatureVector):
    """The four coordinates and both apparent radii, u₁ v₁ u₂ v₂ R₁ R₂ px.

    A px of a radius counts as one of a coordinate: in rendered pictures both scatter by 0.013 px,
    and with three times the weight the error at the target was twice as large. A lost marker is
    left out, as the other and its size determine the position. Put where a fit has it, it pulls the
    tool to where the fit is wrong: by 0.5 to 4 mm in rendered scenes, instead of 0.1.
    """

    name = "size"
    components = ("u1", "v1", "u2", "v2", "R1", "R2")
    units = ("px",) * 6
    needs_sizes = True
    leaves_out_lost = True

    def measure(self, markers: MarkerPair) -> Floats:
        return np.concatenate([markers.points.ravel(), markers.sizes])

    def jacobian(self, markers: MarkerPair) -> Floats:
        return np.eye(6)


FEATURE_VECTORS: dict[str, FeatureVector] = {
    vector.name: vector for vector in (ToolFeatures(), PointFeatures(), SizeFeatures())
}
"""Feature vectors by name."""


def add_feature_vector(vector: Any) -> None:
    """Add a user's feature vector to those that ``controller.features`` may name.

    Raises
    ------
    BadInput
        If it is no `FeatureVector`, its name is taken by another class, or its components and units
        do not fit.
    """
    if not isinstance(vector, FeatureVector):
        raise BadInput("feature vector", vector, "an object of a class derived from FeatureVector")
    where, count = f"feature vector {vector.name}", len(vector.units)
    if not 1 <= count <= MAX_FEATURES or len(vector.components) != count:
        right = f"one for each of 1 to {MAX_FEATURES} components"
        raise BadInput(f"{where}: units", vector.units, right)
    if not set(vector.units) <= set(UNITS):
        raise BadInput(f"{where}: units", vector.units, "rad or px for each component")
    known = FEATURE_VECTORS.get(vector.name, vector)
    if type(known).__qualname__ != type(vector).__qualname__:
        raise BadInput("feature vector", vector.name, "a name that no other feature vector has")
    FEATURE_VECTORS[vector.name] = vector
