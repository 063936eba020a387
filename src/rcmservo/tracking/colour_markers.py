"""Trackers: the two coloured markers in an image, or in the points that a camera delivers."""

from dataclasses import replace
from typing import cast, final

import numpy as np

from rcmservo.errors import BadInput, require
from rcmservo.interfaces import Floats, Frame, Image, Markers
from rcmservo.tracking.appearance import MarkerAppearance
from rcmservo.tracking.ball_fit import Ball, compile_blur_kernels
from rcmservo.tracking.colours import COLOURS
from rcmservo.tracking.local_search import detect_balls, follow_ball
from rcmservo.tracking.marker_identity import OptionalPair, assign_numbers, have_kept_numbers
from rcmservo.tracking.not_found import explain_not_found

MAX_EXTRAPOLATION_FRAMES = 3.0
"""Largest time, in frame periods, over which a motion is extrapolated."""

NO_BALLS: OptionalPair = (None, None)


@final
class ColourMarkers:
    """Tracker of two coloured balls on the shaft.

    The tracker expects each ball to continue its last motion and searches near the expected
    position. It searches the whole image for a lost ball. A ball stays lost while several
    candidates fit.

    Parameters
    ----------
    look : MarkerAppearance, optional
        Colours and radii of the balls; by default a green marker 1 and a blue marker 2 of equal
        size.

    Raises
    ------
    BadInput
        If `look` is no `MarkerAppearance`.

    Notes
    -----
    `find` returns the centre of the whole ball in px, also where the shaft hides up to 40 % of it.
    A ball with a radius below 4 px, one that the border of the image cuts, and one of which less
    than 45 % of the outline is visible count as lost.
    """

    def __init__(self, look: MarkerAppearance | None = None) -> None:
        require(
            isinstance(cast(object, look), MarkerAppearance | None),
            "look",
            look,
            "a MarkerAppearance",
        )
        self.look = look or MarkerAppearance()
        self._colours = COLOURS.index(self.look.colour_1), COLOURS.index(self.look.colour_2)
        self.reset()

    def reset(self) -> None:
        """Forget the markers, so that the next frame starts a new search."""
        self._last = self._second_last = self._last_found = NO_BALLS
        self._times = (0, 0)

    def find(self, frame: Frame) -> Markers:
        """Return the markers of a frame.

        Parameters
        ----------
        frame : Frame
            Frame with an image (height, width, 3), uint8, blue-green-red.

        Returns
        -------
        Markers
            Centres (2, 2) in px, radii (2,) in px, quality (2,) from 0 to 1, and noise covariance
            (2, 3, 3) of u, v and radius in px²; NaN and quality 0 for a marker that is not found.

        Raises
        ------
        BadInput
            If the frame has no such image.
        """
        compile_blur_kernels()
        image = _require_colour_image(frame)
        expected = self._extrapolate(frame.exposure)
        pair = self._follow(image, expected)
        if pair[0] is None or pair[1] is None:
            pair = self._restore_radii(self._search(image, pair))
        self._second_last, self._last = self._last, pair
        self._last_found = pair[0] or self._last_found[0], pair[1] or self._last_found[1]
        self._times = self._times[1], frame.exposure
        return _to_markers(pair)

    def explain_failure(self, frame: Frame) -> str:
        """Return the reason why the markers are not found in a frame; empty if they are.

        This searches the whole image and takes longer than `find`.
        """
        return explain_not_found(_require_colour_image(frame), self.look)

    def _extrapolate(self, exposure: int) -> OptionalPair:
        """Return the expected positions, extrapolated from the last two frames.

        A marker that is missing in the earlier frame moves like the other one.
        """
        previous, last = self._times
        fraction = (exposure - last) / (last - previous) if last > previous else 0.0
        fraction = min(max(fraction, 0.0), MAX_EXTRAPOLATION_FRAMES)
        motions = [
            (fraction * (now.u - before.u), fraction * (now.v - before.v))
            if before and now
            else None
            for before, now in zip(self._second_last, self._last, strict=True)
        ]
        motions = [motions[0] or motions[1], motions[1] or motions[0]]
        first, second = (
            ball.shift(*motion) if ball and motion else ball
            for ball, motion in zip(self._last, motions, strict=True)
        )
        return first, second

    def _follow(self, image: Image, expected: OptionalPair) -> OptionalPair:
        """Return the markers near their expected or last positions.

        Of two markers of one colour both or none are returned, because one alone might be the
        other.
        """
        first, second = (
            _follow_marker(image, *marker)
            for marker in zip(self._colours, expected, self._last, strict=True)
        )
        if self.look.same_colour and not have_kept_numbers(expected, (first, second)):
            return None, None
        return first, second

    def _search(self, image: Image, followed: OptionalPair) -> OptionalPair:
        """Return the followed markers, and the missing ones from a search of the whole image."""
        pairs = list(zip(self._colours, followed, strict=True))
        missing = {colour for colour, ball in pairs if ball is None}
        detected = {colour: detect_balls(image, colour) for colour in missing}
        first, second = ([ball] if ball else detected[colour] for colour, ball in pairs)
        return assign_numbers(self.look, first, second, followed, self._last_found)

    def _restore_radii(self, pair: OptionalPair) -> OptionalPair:
        """Return the markers with trusted radii.

        A marker that only the full search finds may be blurred; it keeps its previous radius.
        """
        first, second = (
            replace(ball, radius=earlier.radius)
            if ball and earlier and np.isnan(ball.covariance).any()
            else ball
            for ball, earlier in zip(pair, self._last_found, strict=True)
        )
        return first, second


def _require_colour_image(frame: Frame) -> Image:
    """Return the frame's image, or raise ``BadInput`` if it is no colour image."""
    image = frame.image
    expected = (
        "a (height, width, 3) uint8 picture with coloured markers; frames with points need "
        "PointMarkers"
    )
    if image is None:
        raise BadInput("frame.image", None, expected)
    is_valid = image.ndim == 3 and image.shape[2] == 3 and image.dtype == np.uint8
    require(is_valid, "frame.image", (image.shape, str(image.dtype)), expected)
    return image


def _follow_marker(
    image: Image, colour: int, expected: Ball | None, last: Ball | None
) -> Ball | None:
    """Return a marker near its expected position, its last one, or the one of a reversed motion."""
    if expected is None or last is None:
        return None
    motion = expected.u - last.u, expected.v - last.v
    positions = [expected]
    if expected is not last:
        positions += [last, last.shift(-motion[0], -motion[1])]
    attempts = (follow_ball(image, colour, position, motion) for position in positions)
    return next((ball for ball in attempts if ball), None)


def _to_markers(pair: OptionalPair) -> Markers:
    """Return a pair of balls as arrays; NaN and quality 0 for a lost marker."""
    points, radius, quality = np.full((2, 2), np.nan), np.full(2, np.nan), np.zeros(2)
    covariance = np.full((2, 3, 3), np.nan)
    for i, ball in enumerate(pair):
        if ball is not None:
            points[i], radius[i], quality[i] = (ball.u, ball.v), ball.radius, ball.quality
            covariance[i] = ball.covariance
    return Markers(points, radius, quality, covariance)


@final
class PointMarkers:
    """Tracker for a camera that delivers the centres of the markers instead of images.

    The first point of a frame is marker 1, the one nearer the RCM. The tracker has no parameters
    and no state.
    """

    def reset(self) -> None:
        """Do nothing: this tracker has no state."""

    def find(self, frame: Frame) -> Markers:
        """Return the markers of a frame with points.

        Parameters
        ----------
        frame : Frame
            Frame with points (2, 2) in px; NaN marks a lost marker.

        Returns
        -------
        Markers
            The same points, with quality 1; NaN and quality 0 for a lost marker. The radii are NaN.

        Raises
        ------
        BadInput
            If the frame has no such points.
        """
        points: Floats = np.array(frame.points, dtype=np.float64)
        expected = "the two markers' centres, (2, 2) px"
        require(points.shape == (2, 2), "frame.points", frame.points, expected)
        visible = np.isfinite(points).all(axis=1)
        points[~visible] = np.nan
        return Markers(points, np.full(2, np.nan), np.where(visible, 1.0, 0.0))

    def explain_failure(self, frame: Frame) -> str:
        """Return a sentence with the markers that the camera does not deliver, or nothing."""
        lost = [f"marker {i}" for i, q in enumerate(self.find(frame).quality, 1) if not q]
        return f"the camera does not see {' and '.join(lost)}" if lost else ""
