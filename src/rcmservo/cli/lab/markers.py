"""`rcmservo markers`: detect the coloured balls of an image, and the two that the tracker uses.

The markers are two coloured balls on the tool; marker 1 is the one nearer to the RCM, the remote
centre of motion.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from rcmservo.cli.lab.marker_report import draw_candidates, make_report, print_markers
from rcmservo.cli.terminal import open_console
from rcmservo.config.rig_file import RigDescription, load_rig_file, name_origin_in_errors
from rcmservo.config.rig_file_edit import find_marker_keys, write_markers
from rcmservo.errors import UnusableFile, require
from rcmservo.hardware.device_kinds import make_tracker
from rcmservo.interfaces import Image
from rcmservo.tracking import COLOURS, MarkerAppearance, read_image
from rcmservo.tracking.candidates import (
    NO_BALL_MESSAGE,
    Candidate,
    TrackedPair,
    detect_candidates,
    measure_appearance,
    propose_pair,
    track_pair,
)

RADIUS_KEYS = {"radius_1", "radius_2"}
"""Keys of the markers' radii in a rig file."""
IMAGE_SUFFIXES = ".png", ".jpg", ".jpeg"
"""File suffixes of images that can be written."""


@dataclass(frozen=True)
class MarkersOptions:
    """Detect the coloured balls of an image, show the two that the tracker uses, and save them.

    The command can write the markers to a rig file. Nothing moves.

    Parameters
    ----------
    frame : Path
        Image of the tool: a PNG or JPEG file.
    choose : str
        Colours of the markers, such as green,blue: first that of the marker nearer to the RCM.
    rig : Path or None
        TOML file of the lab. With --choose the markers are written to its section [markers];
        without it the tracker searches for those of the file, or that of its section [tracker].
    picture : Path or None
        New PNG or JPEG file for the image with the detected balls.
    json : bool
        Print one JSON object on stdout and nothing else.
    """

    frame: Annotated[Path, tyro.conf.Positional]
    choose: Annotated[str, tyro.conf.arg(metavar="COLOUR,COLOUR")] = ""
    rig: Path | None = None
    picture: Path | None = None
    json: bool = False


def markers(options: MarkersOptions) -> int:
    """Report the balls of an image; return 1 if the tracker does not detect two markers."""
    colours = _parse_colours(options.choose) if options.choose else None
    picture = options.picture
    if picture is not None:
        expected = "a file whose name ends in .png or .jpg"
        require(picture.suffix.lower() in IMAGE_SUFFIXES, "--picture", picture, expected)
        expected = "a new file, because nothing is overwritten"
        require(not picture.exists(), "--picture", picture, expected)
    lab = load_rig_file(options.rig)
    expected = f"left out: {options.rig} has its own [tracker], which needs no colours"
    require(colours is None or not lab.has_tracker, "--choose", options.choose, expected)
    image = read_image(options.frame)
    candidates = detect_candidates(image)
    if lab.has_tracker:
        pair = track_pair(image, None, make_tracker(lab))
    else:
        pair = _find_pair(image, candidates, lab, colours, options)
    numbered = bool(colours or options.rig)
    has_result = bool(candidates) or lab.has_tracker
    summary = _describe_pair(pair, numbered) if has_result else NO_BALL_MESSAGE
    if picture:
        from rcmservo.figures.overlay import write_image

        write_image(picture, draw_candidates(image, candidates, pair, summary, numbered))
    is_written = False
    if options.rig and colours and pair and pair.appearance:
        _write_appearance(options.rig, pair.appearance)
        is_written = True
    if options.json:
        print(json.dumps(make_report(candidates, pair, is_written)))
    else:
        print_markers(open_console(), candidates, summary)
        if is_written:
            open_console().print(f"written to [markers] of {options.rig}", soft_wrap=True)
    return 0 if pair and not pair.reason else 1


def _parse_colours(text: str) -> tuple[str, str]:
    """Return the two colours of --choose."""
    colours = [colour.strip() for colour in text.split(",")]
    is_valid = len(colours) == 2 and all(colour in COLOURS for colour in colours)
    require(is_valid, "--choose", text, f"two of {', '.join(COLOURS)}, such as green,blue")
    return colours[0], colours[1]


def _find_pair(
    image: Image,
    candidates: list[Candidate],
    lab: RigDescription,
    colours: tuple[str, str] | None,
    options: MarkersOptions,
) -> TrackedPair | None:
    """Return the balls that the tracker uses as markers.

    It searches for the chosen colours, for the markers of the rig file, or else for the best two
    balls that it can distinguish.
    """
    if colours is None and options.rig:
        return track_pair(image, lab.markers)
    if colours is None:
        return propose_pair(image, candidates, lab.markers.radius_1)
    pair = track_pair(image, _make_chosen_appearance(image, lab, colours, options))
    if pair.reason and options.rig:
        raise UnusableFile(options.frame, f"{pair.reason}; nothing was written")
    return pair


def _make_chosen_appearance(
    image: Image, lab: RigDescription, colours: tuple[str, str], options: MarkersOptions
) -> MarkerAppearance:
    """Return the chosen colours with radii from the rig file, or else measured in the image.

    No image shows which of two balls of one colour is nearer to the RCM, so their radii must be
    given.
    """
    radii = lab.markers.radius_1, lab.markers.radius_2
    if options.rig and find_marker_keys(options.rig) & RADIUS_KEYS:
        with name_origin_in_errors(options.rig):
            return MarkerAppearance(*colours, *radii)
    expected = (
        "two different colours; for two balls of one colour first write radius_1 (of the ball "
        "nearer to the RCM) and radius_2, which must differ, to [markers] of a --rig file"
    )
    require(colours[0] != colours[1], "--choose", options.choose, expected)
    return measure_appearance(image, colours, radii[0]) or MarkerAppearance(*colours, *radii)


def _write_appearance(path: Path, appearance: MarkerAppearance) -> None:
    """Write the markers to a rig file; existing radii stay as they are."""
    has_radii = bool(find_marker_keys(path) & RADIUS_KEYS)
    values = asdict(appearance).items()
    write_markers(path, {k: v for k, v in values if not (has_radii and k in RADIUS_KEYS)})


def _describe_pair(pair: TrackedPair | None, numbered: bool) -> str:
    """Return a sentence on the balls that the tracker uses."""
    if pair is None:
        return "the image shows no two balls that the tracker can distinguish"
    appearance = pair.appearance
    if appearance is None and pair.reason:
        return f"the rig file's tracker does not detect both markers: {pair.reason}"
    if appearance is None:
        (u_1, v_1), (u_2, v_2) = pair.points.tolist()
        found = f"marker 1 at ({u_1:.1f}, {v_1:.1f}) px and marker 2 at ({u_2:.1f}, {v_2:.1f}) px"
        return f"the rig file's tracker detects {found}"
    if pair.reason:
        colours = f"{appearance.colour_1} and {appearance.colour_2}"
        return f"the tracker searches for {colours}: {pair.reason}"
    sizes = ("larger ", "smaller ") if appearance.ratio > 1.0 else ("smaller ", "larger ")
    first, second = (
        f"the {size if appearance.same_colour else ''}{colour} ball"
        for size, colour in zip(sizes, (appearance.colour_1, appearance.colour_2), strict=True)
    )
    if numbered:
        return f"the tracker uses {first} as marker 1, nearer to the RCM, and {second} as marker 2"
    return f"the tracker can use {first} and {second}; name the one nearer to the RCM in --choose"
