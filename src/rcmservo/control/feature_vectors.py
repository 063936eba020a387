"""Feature vectors that the controller, eq. (31), can act on, and their registry.

A `FeatureVector` measures both markers, gives its derivative, and declares the derivatives that it
needs from an estimator. The paper's vector and the points are part of the compiled tick, by their
`code`. Other vectors are measured in Python once per frame; the controller itself stays compiled.
"""

from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple, final

import numpy as np

from rcmservo.errors import BadInput, require
from rcmservo.geometry.features import (
    FEATURE_SCALE,
    INTERPRETED_CODE,
    MAX_FEATURES,
    POINTS_CODE,
    SRD_CODE,
    compute_features,
    compute_features_jacobian,
    shift_to_rcm,
    wrap_angle,
)
from rcmservo.interfaces import Floats
from rcmservo.numerics.structs import Row, reals, whole

UNIT_INDICES = {"rad": 0, "px": 1}
"""Units of a component, with the index of their entry in FEATURE_SCALE and in the bounds b."""


class MarkerPair(NamedTuple):
    """Both markers as the input of a feature vector.

    Parameters
    ----------
    points : Floats
        Centres (2, 2) of the markers in raw px; NaN for a lost marker. Row 0 is marker 1, the one
        nearer the RCM; the columns are (u, v).
    sizes : Floats
        Apparent radii (2,) of the markers in px; NaN where lost or unknown.
    o_c : Floats
        Imaged RCM (2,) in raw px.
    """

    points: Floats
    sizes: Floats
    o_c: Floats


class FeatureParameters(Row):
    """Parameters of a feature vector for compiled functions."""

    code: int = whole("", "code of the feature vector")
    dimension: int = whole("", "number of its components")
    scale: Floats = reals(MAX_FEATURES, "", "one unit of each component")
    bounds: Floats = reals(MAX_FEATURES, "", "saturation bound of each, in these units")
    angle: Floats = reals(MAX_FEATURES, "", "1 for a component that wraps to (−π, π], else 0")


class FeatureVector(ABC):
    """Base class of the feature vectors y (n,) that the controller drives to those of the target.

    With the error Δy = y − y_d (n,) and the Jacobian J = ∂y/∂p₁ (n, 3) per mm, the controller, eq.
    (31), moves marker 1 with v = −k J⁺ ∂V/∂y (3,) mm/s. J is the vector's own derivative by the
    markers' coordinates, times that of the coordinates by p₁, which the estimator supplies.

    The potential V = Σ Vᵢ, eq. (32), is quadratic up to the bound bᵢ of component i:

        Vᵢ = ½ Δyᵢ²             if |Δyᵢ| < bᵢ
        Vᵢ = bᵢ |Δyᵢ| − ½ bᵢ²   otherwise

    A subclass declares its name, components and units, and implements `measure` and `jacobian`.
    Both are pure functions. `add_feature_vector` registers an instance under its ``name``; then
    ``SaturatedController(features=name)`` acts on it.

    Attributes
    ----------
    name : str
        Value of ``controller.features`` that selects the vector; no default.
    components : tuple of str
        Name of each of the n components; no default.
    units : tuple of str
        Unit of each component, "rad" or "px"; no default. A component in rad wraps to (−π, π].
    needs_markers_jacobian : bool
        True (the default) if the estimator must estimate ∂m/∂p₁ (4, 3) px/mm.
    needs_sizes : bool
        True if the estimator must also estimate ∂R/∂p₁ (2, 3) px/mm, and the target must have
        radii; False by default. `jacobian` then has six columns instead of four.
    ignores_lost_markers : bool
        True to ignore the components that a lost marker leaves unknown (NaN). False, the default,
        replaces a lost marker by the prediction of the projection fit.
    code : int
        Number of the vector in compiled functions. A user-defined vector leaves the default, 0:
        Python computes it.

    Raises
    ------
    BadInput
        By `add_feature_vector`, if the vector has no or more than 8 components, not one unit (rad
        or px) for each component, or the name of another class. By `Servo.warm_up`, with which
        `run` begins, before the drive is enabled: if a method raises an exception or returns an
        array of another shape, or if `jacobian` is not the derivative of `measure`. The
        derivative is compared with central differences of 0.001 px at made-up markers; an entry
        may deviate by 1e-4 of the largest one, or of 1 if that is larger.

    Notes
    -----
    During motion an exception, an array of another shape or a Jacobian that is not finite puts the
    servo into FAULT with the cause ESTIMATOR_FAILED at the same tick. A result of `measure` that is
    not finite leads to FAULT with NOT_FINITE while the servo moves to the target; with
    `ignores_lost_markers` its components that are not finite are ignored instead.

    A vector has 1 to 8 components; a tool that turns and moves along its axis needs 3 or more. With
    more than three components J⁺ is the least-squares inverse. A vector outside the compiled tick
    costs one Python call per frame.

    The controller has the bounds b of eq. (32) in (rad, px, px). A component in rad has the bound
    b₁, and a component in px has b₂; only the default vector uses b₃, for d. A subclass may
    override `bounds`.

    References
    ----------
    Section II-D of the paper for the default vector y = [s r d], eq. (6). With the markers (u₁, v₁)
    and (u₂, v₂) px measured from the imaged RCM, eq. (7)-(9) are s = atan2(v₂ − v₁, u₂ − u₁) rad,
    r = |(u₁, v₁)| px and d = |(u₂ − u₁, v₂ − v₁)| px.

    Examples
    --------
    Marker 1 and the u coordinate of marker 2, in px::

        class ThreeCoordinates(rs.FeatureVector):
            name = "three"
            components = "u1", "v1", "u2"
            units = "px", "px", "px"

            def measure(self, markers):
                return markers.points.ravel()[:3]

            def jacobian(self, markers):
                return np.eye(4)[:3]

        rs.add_feature_vector(ThreeCoordinates())
        controller = rs.SaturatedController(features="three")
    """

    name: ClassVar[str]
    """Value of ``controller.features`` that selects the vector."""
    components: ClassVar[tuple[str, ...]]
    """Name of each component."""
    units: ClassVar[tuple[str, ...]]
    """Unit of each component, rad or px. A component in rad wraps to (−π, π]."""
    needs_markers_jacobian: ClassVar[bool] = True
    """True if the estimator must estimate ∂m/∂p₁ of the markers' coordinates."""
    needs_sizes: ClassVar[bool] = False
    """True if the estimator must also estimate ∂R/∂p₁, and the target must have radii."""
    ignores_lost_markers: ClassVar[bool] = False
    """True if components that a lost marker leaves unknown are ignored.

    Otherwise the prediction of the projection fit replaces the lost marker.
    """
    code: ClassVar[int] = INTERPRETED_CODE
    """Code of the vector in compiled functions, if these implement it."""

    @abstractmethod
    def measure(self, markers: MarkerPair) -> Floats:
        """Return the features of both markers.

        Parameters
        ----------
        markers : MarkerPair
            Markers and imaged RCM.

        Returns
        -------
        Floats
            y (n,) in the declared units.
        """

    @abstractmethod
    def jacobian(self, markers: MarkerPair) -> Floats:
        """Return the derivative of the features with respect to the markers' coordinates.

        Parameters
        ----------
        markers : MarkerPair
            Markers and imaged RCM.

        Returns
        -------
        Floats
            ∂y/∂(u₁ v₁ u₂ v₂) (n, 4) in units of y per px; with `needs_sizes` also with respect to
            R₁ R₂, (n, 6).
        """

    def linearise(
        self, markers: MarkerPair, target: MarkerPair, motion: Floats
    ) -> tuple[Floats, Floats]:
        """Return the error to the target and the features' Jacobian.

        Parameters
        ----------
        markers : MarkerPair
            Markers and imaged RCM.
        target : MarkerPair
            Markers of the target, about the same imaged RCM.
        motion : Floats
            Derivative (6, 3) of u₁ v₁ u₂ v₂ R₁ R₂ with respect to p₁ in px/mm.

        Returns
        -------
        tuple of Floats
            Δy (n,) with angles wrapped to (−π, π], and ∂y/∂p₁ (n, 3) per mm.
        """
        error, derivative = self.measure(markers) - self.measure(target), self.jacobian(markers)
        J = derivative @ motion[: derivative.shape[1]]
        error = np.array(
            [wrap_angle(e) if a else e for e, a in zip(error, self.angles, strict=True)]
        )
        if self.ignores_lost_markers:
            is_lost = ~np.isfinite(error)
            error[is_lost], J[is_lost] = 0.0, 0.0
        return error, J

    @property
    def angles(self) -> list[bool]:
        """True for each component that is an angle, which wraps to (−π, π]."""
        return [unit == "rad" for unit in self.units]

    def bounds(self, b: tuple[float, float, float]) -> list[float]:
        """Return the saturation bound of each component from b of eq. (32) in (rad, px, px).

        Parameters
        ----------
        b : tuple of float
            Bounds of the controller in (rad, px, px).

        Returns
        -------
        list of float
            Bound of each component in its unit.
        """
        return [b[UNIT_INDICES[unit]] for unit in self.units]

    def parameters(self, b: tuple[float, float, float]) -> FeatureParameters:
        """Return the vector's parameters for compiled functions, with the bounds b of eq. (32).

        Parameters
        ----------
        b : tuple of float
            Bounds of the controller in (rad, px, px).

        Returns
        -------
        FeatureParameters
            Code, dimension, scale and scaled bounds.
        """
        n = len(self.units)
        scale, bounds, angle = np.zeros((3, MAX_FEATURES))
        scale[:n] = FEATURE_SCALE[[UNIT_INDICES[unit] for unit in self.units]]
        bounds[:n] = self.bounds(b) / scale[:n]
        angle[:n] = self.angles
        return FeatureParameters.of(
            code=self.code, dimension=n, scale=scale, bounds=bounds, angle=angle
        )


@final
class ToolFeatures(FeatureVector):
    """The paper's y = [s r d] of eq. (7)-(9): angle of the imaged tool and two distances.

    Its Jacobian is Ĵ, which every estimator gives.
    """

    name = "srd"
    components = ("s", "r", "d")
    units = ("rad", "px", "px")
    needs_markers_jacobian = False
    code = SRD_CODE

    def measure(self, markers: MarkerPair) -> Floats:
        return compute_features(shift_to_rcm(markers.points, markers.o_c))

    def jacobian(self, markers: MarkerPair) -> Floats:
        return compute_features_jacobian(shift_to_rcm(markers.points, markers.o_c))

    def bounds(self, b: tuple[float, float, float]) -> list[float]:
        return list(b)


@final
class PointFeatures(FeatureVector):
    """The four coordinates u₁ v₁ u₂ v₂ of both markers, raw px."""

    name = "points"
    components = ("u1", "v1", "u2", "v2")
    units = ("px",) * 4
    code = POINTS_CODE

    def measure(self, markers: MarkerPair) -> Floats:
        return markers.points.ravel()

    def jacobian(self, markers: MarkerPair) -> Floats:
        return np.eye(4)


@final
class SizeFeatures(FeatureVector):
    """The four coordinates and both apparent radii, u₁ v₁ u₂ v₂ R₁ R₂ px.

    A pixel of a radius weighs as much as one of a coordinate: in rendered images both scatter by
    0.013 px, and three times the weight doubles the error at the target. A lost marker is ignored,
    since the other marker and its size determine the position. A predicted marker in its place
    would move the tool by the error of the fit: 0.5 to 4 mm in rendered scenes, instead of 0.1 mm.
    """

    name = "size"
    components = ("u1", "v1", "u2", "v2", "R1", "R2")
    units = ("px",) * 6
    needs_sizes = True
    ignores_lost_markers = True

    def measure(self, markers: MarkerPair) -> Floats:
        return np.concatenate([markers.points.ravel(), markers.sizes])

    def jacobian(self, markers: MarkerPair) -> Floats:
        return np.eye(6)


FEATURE_VECTORS: dict[str, FeatureVector] = {
    vector.name: vector for vector in (ToolFeatures(), PointFeatures(), SizeFeatures())
}
"""Registry of the feature vectors by name."""


def add_feature_vector(vector: Any) -> None:
    """Register a user-defined feature vector for ``controller.features``.

    Parameters
    ----------
    vector : FeatureVector
        Instance of the vector. A vector of the same class and name replaces the registered one.

    Raises
    ------
    BadInput
        If it is not a `FeatureVector`, if another class has its name, if it has no or more than 8
        components, or if it does not have one unit, rad or px, for each component.
    """
    check_declaration(vector)
    FEATURE_VECTORS[vector.name] = vector


def check_declaration(vector: Any) -> None:
    """Raise `BadInput` if a vector's name, components or units cannot be registered."""
    if not isinstance(vector, FeatureVector):
        raise BadInput("feature vector", vector, "an object of a class derived from FeatureVector")
    units, field, count = vector.units, f"feature vector {vector.name}: units", len(vector.units)
    has_valid_count = 1 <= count <= MAX_FEATURES and len(vector.components) == count
    require(has_valid_count, field, units, f"one for each of 1 to {MAX_FEATURES} components")
    require(set(units) <= set(UNIT_INDICES), field, units, "rad or px for each component")
    registered = FEATURE_VECTORS.get(vector.name, vector)
    is_free = type(registered).__qualname__ == type(vector).__qualname__
    expected = "a name that no other feature vector has"
    require(is_free, "feature vector", vector.name, expected)
