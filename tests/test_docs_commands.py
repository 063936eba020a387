"""Commands, options and TOML keys of the README and of every page in docs exist."""

import re
import tomllib
from collections.abc import Collection, Iterator
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from conftest import ROOT
from rcmservo.cli.argument_parsing import option_introspection
from rcmservo.cli.cli import COMMANDS, load_options_class
from rcmservo.cli.studies.tune import TuneOptions, read_tuning
from rcmservo.config.class_registry import MECHANISMS, TOOLS
from rcmservo.config.rig_file import RigDescription, load_rig_file
from rcmservo.hardware.device_kinds import ARM_KINDS, CAMERA_KINDS
from rcmservo.safety.gate import Gate
from rcmservo.safety.thresholds import Thresholds
from rcmservo.sim import Appearance, Drive, SceneSettings
from rcmservo.sim.rig_file import CameraSection, read_rig_settings
from rcmservo.study.plan.file import StudyFile, make_plan, read_study_file
from rcmservo.tracking import MarkerAppearance

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
IDS = [path.stem for path in PAGES]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.M | re.S)
SPAN = re.compile(r"(`+)(.+?)\1", re.S)
OPTION = re.compile(r"(?<![\w-])--[a-z][\w.*-]*")
END = re.compile(r"\s(?:\||&&|;|#)\s|;\s|$")
"""End of a command on its line."""
SECTIONS: dict[str, list[type[Any]]] = {
    "mechanism": list(MECHANISMS.values()),
    "tool": list(TOOLS.values()),
    "markers": [MarkerAppearance],
    "gate": [Gate],
    "thresholds": [Thresholds],
    "arm": list(ARM_KINDS.values()),
    "camera": [CameraSection, *CAMERA_KINDS.values()],
    "drive": [Drive],
    "appearance": [Appearance],
    "scene": [SceneSettings],
    "tracker": [],
}
"""Classes of every section of a rig file."""
SCRIPT = re.compile(r"(?:benchmarks|docs|examples)/[\w/]+\.py")
"""Program of the repository that is not a command of rcmservo."""
KEY = re.compile(rf"({'|'.join(SECTIONS)})\.(\w+)(?:\[\d\])?")
"""Setting of a rig file as sentences name it."""


@cache
def list_options(command: str) -> frozenset[str]:
    """Return all options of a command."""
    names = {one.name for one in option_introspection.list_options(load_options_class(command, []))}
    names |= {"--help", "--help-all", "--version"}
    return frozenset(names | {f"--no-{one[2:]}" for one in names})


def is_option(option: str, command: str | None) -> bool:
    """Return True if a command has an option, or, without a command, if any command has it.

    `--gate.*` stands for options that begin with `--gate.`.
    """
    known = [one for name in ([command] if command else COMMANDS) for one in list_options(name)]
    if option.endswith("*"):
        return any(one.startswith(option[:-1]) for one in known)
    return option in known


def list_code_pieces(text: str) -> Iterator[str]:
    """Yield the lines of the code blocks of a page, continued ones joined, and its code spans."""
    for language, block in FENCE.findall(text):
        if language in ("sh", ""):
            yield from block.replace("\\\n", " ").splitlines()
    for _, span in SPAN.findall(FENCE.sub("", text)):
        yield " ".join(span.split())


def list_script_options(path: Path) -> set[str]:
    """Return the options of a script: those in its source, and the fields of its settings."""
    source = path.read_text()
    names = re.findall(r"^    (\w+): ", source, re.M)
    return {*OPTION.findall(source), *(f"--{name.replace('_', '-')}" for name in names)}


def list_other_options(text: str) -> set[str]:
    """Return the options of other programs on a page.

    The programs are the repository's scripts that the page names, and commands other than rcmservo.
    """
    scripts = {ROOT / name for name in SCRIPT.findall(text)}
    found = {one for path in scripts if path.exists() for one in list_script_options(path)}
    commands = [
        one for one in list_code_pieces(text) if not one.startswith("--") and "rcmservo" not in one
    ]
    return found | {option for one in commands for option in OPTION.findall(one)}


def find_unknown_options(piece: str, others: Collection[str] = ()) -> list[str]:
    """Return the commands and options of a piece of code that do not exist.

    Other programs give an empty list. An option without a command may be one of `others`.
    """
    words = piece.removeprefix("$ ").split()
    while words and re.fullmatch(r"[A-Z_]+=\S*|nice|exec", words[0]):
        words.pop(0)
    if not words:
        return []
    if words[0].rpartition("/")[2] == "rcmservo":
        words.pop(0)
        if words and not words[0].startswith("-") and words[0] not in COMMANDS:
            return [] if re.fullmatch(r"[A-Z]+|…|\.\.\.", words[0]) else [words[0]]
    elif words[0] not in COMMANDS and not words[0].startswith("--"):
        return []
    command = words[0] if words and words[0] in COMMANDS else None
    rest = " ".join(words)
    end = END.search(rest)
    assert end is not None
    found = [one.rstrip(".") for one in OPTION.findall(rest[: end.start()])]
    known = () if command else others
    return [one for one in found if one not in known and not is_option(one, command)]


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_every_command_and_option_of_a_page_exists(page: Path) -> None:
    text = page.read_text()
    others = list_other_options(text)
    unknown_options = {
        piece: found
        for piece in list_code_pieces(text)
        if (found := find_unknown_options(piece, others))
    }
    assert unknown_options == {}


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_every_script_that_a_page_runs_exists_and_has_the_options_that_it_is_given(
    page: Path,
) -> None:
    for piece in list_code_pieces(page.read_text()):
        script = SCRIPT.search(piece)
        if script is not None:
            assert (ROOT / script[0]).exists(), piece
            assert set(OPTION.findall(piece)) <= list_script_options(ROOT / script[0]), piece


@pytest.mark.parametrize(
    ("piece", "found"),
    [
        ("--estimator.gamma 0.01", ["--estimator.gamma"]),
        ("--flow.gamma 0.01", []),
        ("rcmservo run --seeds 3", ["--seeds"]),
        (".venv/bin/rcmservo run --seed 3 | tee --append log", []),
        ("rcmservo runs", ["runs"]),
        ("live --fault help", ["--fault"]),
        ("emulate galil --fault help", []),
        ("--gate.*", ["--gate.*"]),
        ("--controller.*", []),
        ("run --no-video", []),
        ("python benchmarks/soak.py --minutes 3", []),
    ],
)
def test_unknown_options_are_found(piece: str, found: list[str]) -> None:
    assert find_unknown_options(piece) == found


def test_blocks_and_spans_of_a_page_are_all_read() -> None:
    text = (
        "`a\n b` and ``c `d` ``\n```sh\nrcmservo run \\\n  --seed 1\n```\n```toml\nx = `1`\n```\n"
    )
    assert list(list_code_pieces(text)) == ["rcmservo run    --seed 1", "a b", "c `d`"]


BLOCKS = [
    pytest.param(block, id=f"{path.stem}-{number}")
    for path in PAGES
    for number, (language, block) in enumerate(FENCE.findall(path.read_text()))
    if language == "toml"
]


@pytest.mark.parametrize("block", BLOCKS)
def test_every_file_of_a_page_can_be_read_with_all_of_its_keys(block: str, tmp_path: Path) -> None:
    path = tmp_path / "file.toml"
    path.write_text(block)
    tables = tomllib.loads(block)
    if "search" in tables:
        assert read_tuning(TuneOptions(path)).axes
    elif tables.keys() & {f.name for f in fields(StudyFile)} - {"arm"}:  # also a rig's section
        assert make_plan(read_study_file(path), {}).cells
    else:
        read_sections(load_rig_file(path))


def read_sections(lab: RigDescription) -> None:
    """Read all sections of a rig file, except those of user-defined devices."""
    for name, kinds in (("arm", ARM_KINDS), ("camera", CAMERA_KINDS)):
        if ":" not in lab.devices.get(name, {}).get("kind", ":"):
            lab.decode_device_settings(name, kinds)
    read_rig_settings(lab)


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_every_setting_of_a_rig_file_that_a_page_names_exists(page: Path) -> None:
    named = [found for one in list_code_pieces(page.read_text()) if (found := KEY.fullmatch(one))]
    assert [one[0] for one in named if not is_key(one[1], one[2])] == []


def is_key(section: str, key: str) -> bool:
    """Return True if a section of a rig file has a key."""
    if key == "kind" or (section == "mechanism" and key in ("lower", "upper")):
        return True
    return any(key in {f.name for f in fields(kind)} for kind in SECTIONS[section])


def test_the_pages_hold_commands_and_files() -> None:
    assert len(PAGES) > 8 and len(BLOCKS) >= 5
    assert (
        sum("rcmservo " in one for path in PAGES for one in list_code_pieces(path.read_text())) > 30
    )
