"""`rcmservo markers`: which coloured balls a picture shows, and which two the tracker takes."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from rcmservo.cli.lab.marker_report import draw_candidates, markers_report, print_markers
from rcmservo.cli.terminal import console
from rcmservo.config.rig_file import Lab, load_lab, told_with
from rcmservo.config.rig_file_edit import told_in, write_markers
from rcmservo.errors import UnusableFile, require
from rcmservo.interfaces import Image
from rcmservo.tracking import COLOURS, MarkerAppearance, read_image
from rcmservo.tracking.candidates import (
    Candidate,
    TrackedPair,
    detect_candidates,
    measure_appearance,
    propose_pair,
    track_pair,
)

RADIUS_KEYS = {"radius_1", "radius_2"}
IMAGE_SUFFIXES = ".png", ".jpg", ".jpeg"


@dataclass(frozen=True)
class MarkersOptions:
    """Find the coloured balls of a picture that could be markers, show which two the tracker takes,
    and write them into a rig file. Nothing moves.

    Parameters
    ----------
    frame : Path
        A picture of the tool: a PNG or JPEG file.
    choose : str
        The markers' colours, such as green,blue: first that of the marker nearer the RCM.
    rig : Path or None
        The lab's TOML file. With --choose the markers are written into its section [markers];
        without it the tracker looks for those that the file has.
    picture : Path or None
        Write the picture with what was found drawn in it to this PNG or JPEG file.
    json : bool
        Print one JSON object on stdout and nothing else.
    """

    frame: Annotated[Path, tyro.conf.Positional]
    choose: Annotated[str, tyro.conf.arg(metavar="COLOUR,COLOUR")] = ""
    rig: Path | None = None
    picture: Path | None = None
    json: bool = False


def markers(options: MarkersOptions) -> int:
    """Tell what there is; the exit code is 0, and 1 where the tracker takes no two."""
    colours = _parse_colours(options.choose) if options.choose else None
    out = options.picture
    right = "a file whose name ends in .png or .jpg"
    require(out is None or out.suffix.lower() in IMAGE_SUFFIXES, "--picture", out, right)
    right = "a new file: nothing is overwritten"
    require(out is None or not out.exists(), "--picture", out, right)
    lab = load_lab(options.rig)
    image = read_image(options.frame)
    found = detect_candidates(image)
    pair = _track(image, found, lab, colours, options)
    numbered = bool(colours or options.rig)
    words = _describe_pair(pair, numbered)
    if out:
        from rcmservo.figures.overlay import write_image

        write_image(out, draw_candidates(image, found, pair, words, numbered))
    written = bool(options.rig and colours and pair)
    if options.rig and colours and pair:
        _write_appearance(options.rig, pair.appearance)
    if options.json:
        print(json.dumps(asdict(markers_report(found, pair, written))))
    else:
        print_markers(console(), found, words)
        if written:
            console().print(f"written into [markers] of {options.rig}", soft_wrap=True)
    return 0 if pair and not pair.reason else 1


def _parse_colours(text: str) -> tuple[str, str]:
    parts = [part.strip() for part in text.split(",")]
    good = len(parts) == 2 and all(part in COLOURS for part in parts)
    require(good, "--choose", text, f"two of {', '.join(COLOURS)}, such as green,blue")
    return parts[0], parts[1]


def _track(
    image: Image,
    found: list[Candidate],
    lab: Lab,
    colours: tuple[str, str] | None,
    options: MarkersOptions,
) -> TrackedPair | None:
    """What the tracker takes: for the colours that were chosen, or the rig file's markers, or else
    the best two balls that it can tell from others.
    """
    if colours is None:
        look = lab.markers
        return track_pair(image, look) if options.rig else propose_pair(image, found, look.radius_1)
    pair = track_pair(image, _chosen_appearance(image, lab, colours, options))
    if pair.reason and options.rig:
        raise UnusableFile(options.frame, f"{pair.reason}; nothing was written")
    return pair


def _chosen_appearance(
    image: Image, lab: Lab, colours: tuple[str, str], options: MarkersOptions
) -> MarkerAppearance:
    """The chosen colours with the rig file's radii, or where it has none, as the picture shows
    them. Which of two balls of one colour is nearer the RCM no picture tells.
    """
    radii = lab.markers.radius_1, lab.markers.radius_2
    if options.rig and told_in(options.rig) & RADIUS_KEYS:
        with told_with(options.rig):
            return MarkerAppearance(*colours, *radii)
    right = (
        "two colours; of two balls of one colour write radius_1 (of the one nearer the RCM) and "
        "radius_2, which must differ, into [markers] of a --rig before"
    )
    require(colours[0] != colours[1], "--choose", options.choose, right)
    return measure_appearance(image, colours, radii[0]) or MarkerAppearance(*colours, *radii)


def _write_appearance(path: Path, look: MarkerAppearance) -> None:
    """Write the markers into a rig file; radii that it has stay as they are."""
    kept = RADIUS_KEYS if told_in(path) & RADIUS_KEYS else set[str]()
    write_markers(path, {key: value for key, value in asdict(look).items() if key not in kept})


def _describe_pair(pair: TrackedPair | None, numbered: bool) -> str:
    """In a sentence what the tracker takes."""
    if pair is None:
        return "the picture shows no two balls that the tracker could tell from others"
    look = pair.appearance
    if pair.reason:
        return f"the tracker looks for {look.colour_1} and {look.colour_2}: {pair.reason}"
    sizes = ("larger ", "smaller ") if look.ratio > 1.0 else ("smaller ", "larger ")
    first, second = (
        f"the {size if look.same_colour else ''}{colour} ball"
        for size, colour in zip(sizes, (look.colour_1, look.colour_2), strict=True)
    )
    if numbered:
        return f"the tracker takes {first} as marker 1, nearer the RCM, and {second} as marker 2"
    return f"the tracker could take {first} and {second}; which is nearer the RCM is yours to say"
