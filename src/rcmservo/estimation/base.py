"""Interface of the estimators of the Jacobian Ĵ of eq. (14).

An estimator is a frozen dataclass of settings. Its memory is a separate value, and each step is a
pure function of both. To add an estimator, derive a class from `Estimator` in a file of this
folder, and list it in config/class_registry.py.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from rcmservo.constraints import Checked
from rcmservo.geometry.features import FEATURE_COUNT, MAX_FEATURES
from rcmservo.geometry.tool import Tool, ToolStruct
from rcmservo.interfaces import Floats
from rcmservo.numerics.structs import Row, flag, real, reals, whole


class Sample(NamedTuple):
    """Measurements of one new frame for an estimator. None of these numbers is a command.

    Parameters
    ----------
    p1 : Floats
        Position p₁ (3,) mm of marker 1 by the measured joints at the exposure.
    points : Floats
        Centres (2, 2) of the markers in raw px; NaN for a lost marker. Row 0 is marker 1, the one
        nearer the RCM; the columns are (u, v).
    o_c : Floats
        Imaged RCM (2,) in raw px by eq. (16), the point nearest to the lines of the imaged tool;
        NaN if the estimator determines it.
    dt : float
        Time in s since the exposure of the previous sample, not negative. It is 0 for the first
        sample of a run and for the first one after a reset.
    sizes : Floats
        Apparent radii (2,) of the markers in px; NaN where unknown.
    """

    p1: Floats
    points: Floats
    o_c: Floats
    dt: float
    sizes: Floats = np.full(2, np.nan)


class EstimatorResult(Row):
    """Result of an estimator for one frame, from which the servo computes features and error."""

    points: Floats = reals((2, 2), "px", "markers, raw; filtered if the estimator averages noise")
    has_imaged_rcm: bool = flag("whether the estimator gives o_c, and Ĵ follows from ∂m/∂p₁")
    J_hat: Floats = reals((3, 3), "rad/mm, px/mm, px/mm", "Ĵ of eq. (14), if it gives no o_c")
    markers_jacobian: Floats = reals((4, 3), "px/mm", "∂m/∂p₁ of both markers, if needed")
    o_c: Floats = reals(2, "px", "imaged RCM, raw, if it gives o_c")
    o_c_covariance: Floats = reals((2, 2), "px²", "of o_c")
    has_failed: bool = flag("whether a user's estimator or feature vector failed at this tick")


class KernelSample(NamedTuple):
    """Measurements of one new frame for the kernel of a compiled estimator.

    Parameters
    ----------
    p1 : Floats
        Position p₁ (3,) mm of marker 1 by the measured joints at the exposure.
    points : Floats
        Centres (2, 2) of the markers in raw px.
    o_c : Floats
        Imaged RCM (2,) in raw px.
    dt : float
        Time in s since the exposure of the previous sample; 0 for the first.
    shaft : ToolStruct
        Tool with both markers.
    needs_markers_jacobian : bool
        True if the caller needs ∂m/∂p₁ of both markers.
    fit_changed : bool
        True if the projection fit has changed since the previous frame.
    """

    p1: Floats
    points: Floats
    o_c: Floats
    dt: float
    shaft: ToolStruct
    needs_markers_jacobian: bool
    fit_changed: bool


class EstimatorKernel(Protocol):
    """Compiled form of an estimator: a named tuple of settings with compiled class functions."""

    estimates_rcm: ClassVar[bool]
    """True if it estimates the imaged RCM itself, without the lines of eq. (16)."""
    update: ClassVar[Callable[..., Any]]
    """Function of (kernel, memory, `KernelSample`, projection fit, result of the frame).

    It writes the result and returns the memory after the frame.
    """
    reset: ClassVar[Callable[..., Any]]
    """Function of (kernel, memory) that returns the memory before the first frame."""


class Estimator(Checked, ABC, section="estimator"):
    """Base class of the estimators of the Jacobian Ĵ (3, 3) of eq. (14), ẏ = Ĵ v with v = ṗ₁.

    Ĵ maps the velocity v (3,) mm/s of marker 1 to the rate ẏ (3,) rad/s, px/s, px/s of the
    features [s r d].

    A user-defined estimator derives from this class, implements `init`, `update` and `jacobian`,
    and overrides the optional methods that its model supports. Every method is pure: it changes
    neither its arguments nor the estimator. Only the estimator interprets its memory. A built-in
    estimator is listed in config/class_registry.py; a user-defined one needs no list.

    The features of a sample, eq. (7)-(9), with the markers (u₁, v₁) and (u₂, v₂) px measured from
    the imaged RCM ``sample.o_c``, are

        s = atan2(v₂ − v₁, u₂ − u₁),    r = |(u₁, v₁)|,    d = |(u₂ − u₁, v₂ − v₁)|

    Public functions compute them: ``m = rs.shift_to_rcm(sample.points, sample.o_c)`` (4,) px,
    ``rs.compute_features(m)`` (3,) and ``rs.compute_features_jacobian(m)``, ∂y/∂m (3, 4). With the
    derivative ∂m/∂p₁ (4, 3) px/mm of both markers, eq. (15) is

        Ĵ = ∂y/∂m ∂m/∂p₁

    The class is a frozen dataclass, whose fields are the settings. The argument `tool` of the
    methods is a `RigidTool` or a `ScaledTool`. Its method ``second_marker(p1)`` returns the
    position p₂ (3,) mm of marker 2.

    Attributes
    ----------
    name : str
        Name of a built-in estimator in files and on the command line; it has no default. In a
        user-defined one it is optional, and is the prefix of its options on the command line.
    predicts_markers : bool
        True if `predict` returns predicted markers; False by default.
    estimates_rcm : bool
        True if `imaged_rcm` replaces eq. (16), which the help of `ImagedRcm` states; False by
        default. The class must then also implement `imaged_rcm` and `markers_jacobian`, from which
        the servo computes Ĵ, eq. (15).
    tolerates_lost_marker : bool
        True if `update` accepts NaN for one marker; False by default. It has an effect only if
        `estimates_rcm` is True.
    advice : str
        Advice to the operator if exploration ends without a usable estimate; empty by default.

    Raises
    ------
    BadInput
        At construction, if a setting is outside its limits. The limits are annotations of the
        fields, as in the example. The module `rcmservo.constraints` has them: `positive`,
        `not_negative`, `finite`, `between`, `above`, `inside`, `at_least` and `at_most` for a
        number, `three_positive`, `each` and `array` for several, `one_of`, `matching` and
        `not_empty` for a text, and `Limit` for any other condition.
    UnusableEstimator
        By `Servo.warm_up`, with which `run` begins, before the drive is enabled. It calls a
        user-defined estimator with 30 made-up samples and refuses it if a method raises an
        exception, or returns an array of another shape or a number that is not finite (allowed are
        those of `predict`, `recorded_numbers` and the covariance of o_c). It also refuses an
        estimator that is not pure: `update` is called twice for each sample, and both Ĵ must be
        equal to the last bit. The class is in `rcmservo.servo.user_estimator`.

    Notes
    -----
    ``rs.testing.check_estimator`` checks more than `Servo.warm_up`, in a test of the user.

    A user-defined estimator may leave all attributes at their defaults. On the command line all its
    settings must have a default.

    The optional methods return by default: `filtered_markers` the measured ``sample.points``;
    `imaged_rcm`, `predict` and `recorded_numbers` None. `markers_jacobian` and `sizes_jacobian`
    raise ``NotImplementedError``. `markers_jacobian` is needed with `estimates_rcm` and for the
    feature vectors 'points' and 'size', `sizes_jacobian` for 'size'. With `estimates_rcm` the servo
    takes y and ∂y/∂m along the line through the imaged RCM nearest to both markers, as the help of
    `State` describes for its property ``y``.

    The servo calls `update` once for each accepted new frame, never for a repeated frame.

    During a run, an exception, an array of another shape or a number that is not finite from a
    user-defined estimator puts the servo into FAULT with the cause ESTIMATOR_FAILED at the same
    tick; `step` and `run` raise nothing. A Ĵ that is not finite without such a failure leads to
    FAULT with ESTIMATE_NOT_FINITE: that of a built-in estimator, or one that the servo computes by
    eq. (15). Both causes discard the estimate. As in `Servo.warm_up`, `predict`,
    `recorded_numbers` and the covariance of o_c may be NaN. `recorded_numbers` must return an array
    of the same length at every call.

    References
    ----------
    Sections III-B and III-C of the paper.

    Examples
    --------
    Head of a class with one setting; examples/02_own_estimator.py is a complete one::

        from dataclasses import dataclass
        from typing import Annotated

        import rcmservo as rs
        from rcmservo.constraints import between

        @dataclass(frozen=True)
        class Rls(rs.Estimator):
            forgetting: Annotated[float, between(0.5, 1.0, "a factor")] = 0.98
    """

    name: ClassVar[str]
    """Value of the setting ``estimator`` that selects the class."""
    predicts_markers: ClassVar[bool] = False
    """True if `predict` returns predicted markers."""
    estimates_rcm: ClassVar[bool] = False
    """True if `imaged_rcm` replaces eq. (16), which also requires `markers_jacobian`."""
    tolerates_lost_marker: ClassVar[bool] = False
    """True if `update` accepts NaN for one marker, and the estimator supplies that marker itself.

    It is used only with an estimator that determines the imaged RCM.
    """
    advice: ClassVar[str] = ""
    """Advice to the user if exploration ends without a usable estimate."""

    @abstractmethod
    def init(self) -> Any:
        """Return the memory before the first frame.

        Returns
        -------
        object
            Memory with which Ĵ is zero: Ĵ = 0, or â = 0 for an estimator of the parameters â of a
            projection, such as the nine of eq. (17).
        """

    @abstractmethod
    def update(self, memory: Any, tool: Tool, sample: Sample) -> Any:
        """Return the memory after one new frame.

        Parameters
        ----------
        memory : object
            Memory after the previous frame. It must not be changed.
        tool : Tool
            Tool with both markers.
        sample : Sample
            Measurements of the frame.

        Returns
        -------
        object
            Memory after the frame.
        """

    @abstractmethod
    def jacobian(self, memory: Any, tool: Tool, sample: Sample) -> Floats:
        """Return Ĵ of eq. (14) at a sample.

        Parameters
        ----------
        memory : object
            Memory after the frame of the sample.
        tool : Tool
            Tool with both markers.
        sample : Sample
            Measurements of the frame.

        Returns
        -------
        Floats
            Ĵ (3, 3) in (rad/mm, px/mm, px/mm) by rows; zeros before the estimator has data.
        """

    def filtered_markers(self, memory: Any, tool: Tool, sample: Sample) -> Floats:
        """Return the markers at a sample: measured, or filtered if the estimator does so.

        By default they are the measured ``sample.points``.

        Parameters
        ----------
        memory : object
            Memory after the frame of the sample.
        tool : Tool
            Tool with both markers.
        sample : Sample
            Measurements of the frame.

        Returns
        -------
        Floats
            Centres (2, 2) of the markers in raw px.
        """
        del memory, tool
        return sample.points

    def imaged_rcm(self, memory: Any) -> tuple[Floats, Floats] | None:
        """Return the imaged RCM by the estimator's own model; None by default.

        Parameters
        ----------
        memory : object
            Memory after the newest frame.

        Returns
        -------
        tuple of Floats, or None
            o_c (2,) in raw px and its covariance (2, 2) in px²; None if eq. (16) determines o_c.
        """
        del memory
        return None

    def markers_jacobian(self, memory: Any, tool: Tool, sample: Sample) -> Floats:
        """Return ∂m/∂p₁ of both markers at a sample, the second factor of eq. (15).

        By default it raises ``NotImplementedError``. The servo calls it if the estimator determines
        the imaged RCM, or if the controller acts on the markers' coordinates.

        Parameters
        ----------
        memory : object
            Memory after the frame of the sample.
        tool : Tool
            Tool with both markers.
        sample : Sample
            Measurements of the frame.

        Returns
        -------
        Floats
            Derivative (4, 3) of (u₁, v₁, u₂, v₂) with respect to p₁ in px/mm.

        Raises
        ------
        NotImplementedError
            If the estimator has no such model.
        """
        raise NotImplementedError(type(self).__name__)

    @property
    def has_markers_jacobian(self) -> bool:
        """True if the class implements `markers_jacobian`."""
        return type(self).markers_jacobian is not Estimator.markers_jacobian

    def sizes_jacobian(self, memory: Any, tool: Tool, sample: Sample) -> Floats:
        """Return ∂R/∂p₁ of both markers' apparent radii at a sample.

        By default it raises ``NotImplementedError``. The servo calls it if the controller acts on
        the apparent radii.

        Parameters
        ----------
        memory : object
            Memory after the frame of the sample.
        tool : Tool
            Tool with both markers.
        sample : Sample
            Measurements of the frame.

        Returns
        -------
        Floats
            Derivative (2, 3) of (R₁, R₂) with respect to p₁ in px/mm.

        Raises
        ------
        NotImplementedError
            If the estimator has no such model.
        """
        raise NotImplementedError(type(self).__name__)

    @property
    def has_sizes_jacobian(self) -> bool:
        """True if the class implements `sizes_jacobian`."""
        return type(self).sizes_jacobian is not Estimator.sizes_jacobian

    def predict(self, memory: Any, tool: Tool, p1: Floats) -> Floats | None:
        """Return the markers predicted for a tool position; None by default.

        Parameters
        ----------
        memory : object
            Memory after the newest frame.
        tool : Tool
            Tool with both markers.
        p1 : Floats
            p₁ (3,) mm.

        Returns
        -------
        Floats or None
            m (4,) in px from o_c; None if the estimator has no model of the markers.
        """
        del memory, tool, p1
        return None

    def recorded_numbers(self, memory: Any) -> Floats | None:
        """Return the part of the memory that is recorded with every tick; None by default.

        Parameters
        ----------
        memory : object
            Memory after the newest frame.

        Returns
        -------
        Floats or None
            Numbers (n,), with the same n at every tick; None to record nothing.
        """
        del memory
        return None


class Estimate(Row):
    """Estimate after the newest frame, in numbers; NaN where not known yet."""

    exposure: int = whole("ns", "exposure of the newest frame in the estimate, -1 before the first")
    points: Floats = reals((2, 2), "px", "markers in the newest accepted frame, raw")
    p1: Floats = reals(3, "mm", "position of marker 1 at that exposure")
    line_count: int = whole("", "number of lines of the tool in eq. (16)")
    o_c: Floats = reals(2, "px", "imaged RCM, raw")
    o_c_covariance: Floats = reals((2, 2), "px²", "of o_c; NaN for the printed eq. (16)")
    rcm_condition: float = real("", "condition of eq. (16), 0 if the projection fit gives o_c")
    rcm_uncertainty: float = real("", "of o_c by eq. (16), as a ratio of its limit; known up to 1")
    J_hat: Floats = reals((FEATURE_COUNT, 3), "rad/mm, px/mm, px/mm", "Ĵ of eq. (14)")
    condition: float = real("", "condition of the scaled Ĵ")
    controlled_jacobian: Floats = reals(
        (MAX_FEATURES, 3), "", "∂/∂p₁ of the law's features, per mm"
    )
    controlled_error: Floats = reals(MAX_FEATURES, "", "error of these features at the exposure")
    y: Floats = reals(FEATURE_COUNT, "rad, px, px", "features [s r d], eq. (7)")
    delta: Floats = reals(FEATURE_COUNT, "rad, px, px", "Δy at the exposure")
    predicted_delta: Floats = reals(
        FEATURE_COUNT, "rad, px, px", "Δy predicted for the present joints"
    )
